// The form: what is sent, and for which fabric.

import { ask, at, keepOwn } from './common.js';
import { absolve, clear, complain, fault, fieldOf } from './faults.js';
import { chosen, form, isWeighed, suffix, usesSetup, values } from './fields.js';
import { described, lookAgain, put } from './files.js';
import { look } from './outline.js';
import { recall } from './presets.js';
import { showFields } from './questions.js';
import { setTester } from './support.js';
import { addBench } from './values.js';

let fabric = null; // of the next capture; null: a new one
let sent = null; // the estimate that this form has sent last
let broken = null; // the new fabric whose only capture failed; sending again replaces it

// If this form has sent an estimate that has ended: its values leave with its pictures, or the field of
// its error is marked.
export function ended(id, { state, error: sentence }) {
  if (id !== sent?.id) return;
  if (state === 'done') for (const field of values()) field.dataset.estimated = '';
  if (!sentence) return;
  broken = sent.added ? null : sent.fabric;
  sent = null;
  const scale = form.elements.mm_per_px.value ? 'mm_per_px' : 'plate_diameter';
  const name = fieldOf(sentence) ?? (/check the scale/.test(sentence) && usesSetup() ? scale : null);
  if (name) complain(sentence, name, false);
}

// Whether the files name the fabric, which a zip does by its own name at least.
async function isNamed() {
  const texts = await Promise.all(chosen().filter((file) => suffix(file.name) === '.yaml').map((file) => file.text()));
  return texts.some((text) => /^fabric *:/m.test(text)) || chosen().some((file) => suffix(file.name) === '.zip');
}

// Day and time, such as 2026-11-30 14:05:36.
function today() {
  const now = new Date();
  return new Date(now - 60000 * now.getTimezoneOffset()).toISOString().slice(0, 19).replace('T', ' ');
}

// An example states its own weight; others have the one that was typed, grams only for their own specimen.
async function content(isExample) {
  const data = await described(form);
  if (fabric) data.append('fabric', fabric);
  else if (!data.has('name') && !await isNamed()) data.append('name', today());
  addBench(data, !chosen().length);
  if (isExample) data.delete('density_g_m2');
  else if (isWeighed() && !data.has('density_g_m2') && at('kept').hidden && at('density').value.trim()) data.append('weight_g', at('density').value.trim());
  return data;
}

async function send(isExample = false) {
  clear();
  const wrong = fault();
  if (wrong) {
    complain(...wrong);
    return;
  }
  at('submit').disabled = true;
  try {
    const begun = await ask('/estimates', { method: 'POST', body: await content(isExample) });
    at('kept').hidden = !at('density').value;
    sent = { ...begun, added: Boolean(fabric) };
    keepOwn(begun.id);
    if (broken) ask(`/fabrics/${broken}`, { method: 'DELETE' }).catch(() => {});
    broken = null;
    form.elements.label.value = '';
    location.hash = begun.id;
  } catch (error) {
    complain(error.lost ? 'The service cannot be reached. Your files are still chosen: press Estimate again.' : error.message,
      [408, 413, 415].includes(error.status) ? 'files' : fieldOf(error.message));
  } finally {
    at('submit').disabled = false;
  }
}

async function tryExample(name) {
  clear();
  try {
    const answer = await fetch(`/examples/${name}.zip`);
    put([new File([await answer.blob()], `${name}.zip`)]);
    look(null);
    await send(true);
  } catch {
    complain('The service cannot be reached; try again.');
  }
}

// What is sent next is of this fabric, with its density and tester; null: of a new one.
export function addTo(identity, name = '', capture = null) {
  fabric = identity;
  at('into').hidden = !identity;
  at('into-name').textContent = name;
  for (const label of form.querySelectorAll('[data-new]')) label.hidden = Boolean(identity);
  if (!identity) return;
  put([]); // not the same files again
  look(null);
  if (capture && !at('density').value) {
    at('density').value = capture.density_g_m2;
    form.elements.weighed.value = 'area';
  }
  if (capture && !at('tester').value) setTester(capture.rig);
  showFields();
  at('shot').focus();
  form.scrollIntoView();
}

// The fields of the next specimen, of which only those of the tester and the density stay.
function nextSpecimen() {
  addTo(null);
  for (const name of ['name', 'notes', 'label']) form.elements[name].value = '';
  form.elements['known.cloth'].value = '';
  put([]);
  lookAgain(0);
  form.scrollIntoView();
  at('shot').focus({ preventScroll: true });
}

at('next-specimen').addEventListener('click', nextSpecimen);
at('into-none').addEventListener('click', () => addTo(null));
at('density').addEventListener('input', () => { at('kept').hidden = true; });
form.addEventListener('input', ({ target }) => {
  delete target.dataset.estimated;
  if (target.ariaInvalid) absolve(target);
});
form.addEventListener('submit', (event) => {
  event.preventDefault();
  send();
});
for (const button of document.querySelectorAll('[data-example]')) {
  button.addEventListener('click', () => tryExample(button.dataset.example));
}
recall();
