// Values of tests: rows of strips under weights, and those of a bench, as fields of the form.

import { at } from './common.js';
import { form, isWeighed } from './fields.js';
import { number } from './support.js';

const GRAVITY = 9.80665; // m/s², of a gram's weight
const BENCH = 40; // the number of its first strip, beyond those of the table

// A further row for a strip under a weight.
function addStrip() {
  const last = at('tension').tBodies[0].rows;
  const made = last[0].cloneNode(true);
  for (const field of made.querySelectorAll('[name]')) {
    field.name = field.name.replace('.0.', `.${last.length}.`);
    field.value = '';
  }
  at('tension').tBodies[0].append(made);
  at('add-strip').hidden = last.length >= Number(at('tension').dataset.most);
}

const given = (field) => (field.value.trim() ? number(field) : Number(field.placeholder));

// Add what the bench states to what is sent: strips by their load in newtons, and of values alone
// the tester of a drape coefficient.
export function addBench(data, isAlone) {
  for (const field of form.querySelectorAll('[data-pulled]')) delete field.dataset.entry;
  const filled = [...form.querySelectorAll('#tension select')].filter((field) => field.value).length;
  [...form.querySelectorAll('[data-pulled]')].filter((field) => field.value.trim()).forEach((field, k) => {
    field.dataset.entry = `tension.${filled + k}.extension_mm`; // as the service counts them
    const strip = { direction: field.dataset.pulled, width_mm: given(at('bench-width')), gauge_mm: given(at('bench-gauge')),
      load_g: (1000 * given(at('bench-load'))) / GRAVITY, extension_mm: number(field) };
    for (const [key, value] of Object.entries(strip)) data.append(`tension.${BENCH + k}.${key}`, value);
  });
  if (isAlone && at('bench-tester').value && data.has('known.drape_coefficient_percent')) data.append('tester', at('bench-tester').value);
}

at('bench').addEventListener('toggle', () => {
  if (!isWeighed()) at('bench-weight').value = at('density').value;
});
at('add-strip').addEventListener('click', addStrip);
for (const [from, to] of [['bench-weight', 'density'], ['density', 'bench-weight']]) { // one value in two places
  at(from).addEventListener('input', () => {
    at(to).value = at(from).value;
    if (from === 'bench-weight') form.elements.weighed.value = 'area';
  });
}
