// Presets: the fields of the tester and the camera, in this browser, as well as what was typed last.

import { at } from './common.js';
import { form, kind } from './fields.js';
import { choose } from './questions.js';

const PRESETS = 'drapenet.presets';
const TYPED = 'drapenet.typed'; // what stays for the next specimen

const setup = () => [...form.querySelectorAll('[data-setup] :is(input:not([type=radio]), select)')];
const lasting = () => [at('density'), ...['operator', 'laboratory', 'camera'].map((name) => form.elements[name])];
const stored = (key) => {
  try {
    return JSON.parse(localStorage.getItem(key)) ?? {};
  } catch {
    return {};
  }
};
const presets = () => stored(PRESETS);
const filled = (fields) => Object.fromEntries(fields.filter((field) => field.value && !('placed' in field.dataset))
  .map((field) => [field.name || field.id, field.value]));

// Without any values, as the page begins.
function fill(fields, values) {
  const begins = (field) => (Object.keys(values).length ? '' : [...field.options ?? []].find((one) => one.defaultSelected)?.value ?? '');
  for (const field of fields) field.value = values[field.name || field.id] ?? begins(field);
  form.elements.weighed.value = values.weighed ?? form.elements.weighed.value;
  choose(values.kind ?? 'above');
}

// A phone may give up a page while its camera is open.
export function remember() {
  localStorage.setItem(TYPED, JSON.stringify({ ...filled([...setup(), ...lasting()]), kind: kind(), weighed: form.elements.weighed.value, preset: at('preset').value }));
}

export function recall() {
  const typed = stored(TYPED);
  listPresets(typed.preset ?? '');
  at('preset-name').value = at('preset').value;
  fill([...setup(), ...lasting()], typed);
  at('kept').hidden = !at('density').value;
}

function listPresets(selected) {
  at('preset').replaceChildren(new Option('none', ''), ...Object.keys(presets()).sort().map((name) => new Option(name, name)));
  at('preset').value = selected in presets() ? selected : '';
}

function applyPreset() {
  fill(setup(), presets()[at('preset').value] ?? {});
  at('preset-name').value = at('preset').value;
}

function savePreset() {
  const name = at('preset-name').value.trim();
  if (!name) {
    at('preset-name').focus();
    return;
  }
  localStorage.setItem(PRESETS, JSON.stringify({ ...presets(), [name]: { ...filled(setup()), kind: kind() } }));
  listPresets(name);
  remember();
}

function removePreset() {
  const { [at('preset').value]: gone, ...rest } = presets();
  localStorage.setItem(PRESETS, JSON.stringify(rest));
  listPresets('');
  applyPreset();
  remember();
}

at('preset').addEventListener('change', applyPreset);
form.addEventListener('change', remember);
at('preset-save').addEventListener('click', savePreset);
at('preset-remove').addEventListener('click', removePreset);
