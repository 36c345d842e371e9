// The form: what is checked before it is sent, presets, and errors beside their fields.

import { ask, at, element } from './common.js';
import { look } from './outline.js';
import { isFull, reduced, together } from './pictures.js';

const PRESETS = 'drapenet.presets';
const TYPED = 'drapenet.typed'; // what stays for the next specimen
const limits = document.body.dataset;
const form = at('form');
let fabric = null; // of the next capture; null: a new one
let sent = null; // the estimate that this form has sent last
let broken = null; // the new fabric whose only capture failed; sending again replaces it

// ---- errors

const PARTS = { intrinsics: 'fx', plate_px: 'plate_x', 'plate_px.x': 'plate_x', 'plate_px.y': 'plate_y', 'plate_px.diameter': 'plate_diameter' };
const WORDS = ['name', 'notes', 'label', 'face', 'unit', 'tester', 'mat', 'arrow', 'centred', 'angles', 'kind', 'files', 'date', 'operator', 'laboratory', 'camera', 'remarks'];

// The field that a sentence of the service names first; words of sentences only where they have a value.
export function fieldOf(sentence) {
  const [, entry, key] = sentence.match(/^(\w+\.\d+)=.* has (\w+) /) ?? []; // of a list
  if (form.elements[`${entry}.${key}`]) return `${entry}.${key}`;
  const names = [...new Set([...form.elements].map((field) => field.name).filter(Boolean)), ...Object.keys(PARTS)];
  const found = names.map((name) => {
    const after = WORDS.includes(name) ? '(?==| is missing|: (?:false|mm|clockwise))' : '(?![\\w.]*[a-z_])';
    return [name, sentence.search(new RegExp(`(?<![\\w])${name.replaceAll('.', '\\.')}${after}`))];
  }).filter(([, place]) => place >= 0).sort(([, a], [, b]) => a - b);
  return found.length ? PARTS[found[0][0]] ?? found[0][0] : null;
}

export function complain(sentence, name, focus = true) {
  let field = name && form.elements[name] && [...form.querySelectorAll(`[name="${name}"]`)][0];
  if (field?.closest('label[hidden]')) field = form.elements.mat; // on which it depends what is shown
  if (!field) {
    at('error').textContent = sentence;
    return;
  }
  const place = form.querySelector(`[data-error="${name}"]`) ?? field.closest('label, table');
  const error = element('p', sentence, 'error wide');
  error.id = `error-${name}`;
  error.setAttribute('role', 'alert');
  place.after(error);
  const hidden = field.closest('[data-kind]');
  if (hidden?.hidden) choose(hidden.dataset.kind);
  const fold = field.closest('details');
  if (fold) fold.open = true;
  field.setAttribute('aria-invalid', 'true');
  field.setAttribute('aria-describedby', [error.id, field.getAttribute('aria-describedby')].filter(Boolean).join(' '));
  if (focus) field.focus();
}

function clear() {
  at('error').textContent = '';
  for (const error of form.querySelectorAll('[id^="error-"]')) error.remove();
  for (const field of form.querySelectorAll('[aria-invalid]')) {
    field.removeAttribute('aria-invalid');
    const rest = (field.getAttribute('aria-describedby') ?? '').split(' ').filter((id) => id && !id.startsWith('error-'));
    if (rest.length) field.setAttribute('aria-describedby', rest.join(' '));
    else field.removeAttribute('aria-describedby');
  }
}

// If this form has sent an estimate that has ended: its values are not those of the next fabric, or
// the field of its error is marked.
export function ended(id, { state, error: sentence }) {
  if (id !== sent?.id) return;
  if (state === 'done') for (const field of values()) field.value = '';
  if (!sentence) return;
  broken = sent.added ? null : sent.fabric;
  sent = null;
  const scale = form.elements.mm_per_px.value ? 'mm_per_px' : 'plate_diameter';
  const name = fieldOf(sentence) ?? (/check the scale/.test(sentence) && usesSetup() ? scale : null);
  if (name) complain(sentence, name, false);
}

// ---- what is sent

const suffix = (name) => name.slice(name.lastIndexOf('.')).toLowerCase().replace('.yml', '.yaml');
const chosen = () => [...at('files').files];
const isDescribed = () => chosen().some((file) => ['.zip', '.yaml'].includes(suffix(file.name)) || file.name === 'density.txt');
const descriptions = limits.described.split(',').map((name) => name.replace(/\.\w+$/, ''));
const describes = (file) => descriptions.find((name) => new RegExp(`^${name}\\.ya?ml$`, 'i').test(file.name));
const isBesideDrapes = () => chosen().some((file) => ![undefined, 'capture'].includes(describes(file)));
const values = () => [...form.querySelectorAll('[data-values] input, [data-values] select')].filter((field) => field.value.trim());
const isDrape = () => chosen().length > 0 && !isBesideDrapes();
const isScan = () => chosen().length === 1 && !/^view_\d/.test(chosen()[0].name)
  && ['.npz', '.obj', '.ply', '.stl', '.glb'].includes(suffix(chosen()[0].name));
const isPhotograph = (file) => limits.photographs.split(',').includes(suffix(file.name));
const isCertainlyPhotograph = (file) => (isPhotograph(file) && suffix(file.name) !== '.png') || /^outline\./i.test(file.name);
const isBeside = (file) => /(?<![a-z])(plate|empty|mat)(?![a-z])/i.test(file.name); // what shows no drape, as the service has it
const drapes = () => chosen().filter((file) => isPhotograph(file) && !isBeside(file));
const usesSetup = () => isDrape() && (!isDescribed() || at('override').querySelector('input').checked);
const number = (field) => Number(field.value.trim().replace(',', '.'));
const isRectangle = () => at('tester').value === 'rectangle_cylinder';
const isOtherSize = () => at('tester').value.includes('_') && !/\d/.test(at('tester').value);
const kind = () => form.elements.kind.value;
const isOverMat = () => usesSetup() && kind() === 'above' && Boolean(form.elements.mat.value);

// Whether the service is asked how it reads a photograph: it has what it needs for that.
function hasPhotograph() {
  const files = chosen();
  if (!isDrape() || isScan()) return false;
  if (!usesSetup()) return files.some((file) => isCertainlyPhotograph(file) || suffix(file.name) === '.zip');
  return kind() === 'above' && files.some((file) => isPhotograph(file) || suffix(file.name) === '.zip')
    && (!form.elements.mat.value || form.elements.plate_height_mm.value !== '') && !fileFault() && !testerFault();
}

function choose(value) {
  form.elements.kind.value = value;
  for (const set of form.querySelectorAll('[data-kind]')) set.hidden = set.dataset.kind !== value;
  showFields();
}

function check() {
  clear();
  for (const field of form.querySelectorAll('[data-placed]')) { // in another photograph
    field.value = '';
    delete field.dataset.placed;
  }
  const files = chosen();
  at('override').hidden = !isDescribed() || isBesideDrapes();
  if (files.length && !isDescribed()) {
    if (files.some(isCertainlyPhotograph) || ['.csv', '.txt'].includes(suffix(files[0].name))) choose('above');
    if (!hasPhotograph()) at('camera').open = true;
  }
}

// Sentence and field of the first fault, or null: of the files, of the tester, and of all.
function fileFault() {
  const files = chosen();
  const hidden = files.find((file) => descriptions.some((name) => new RegExp(`^${name}\\.ya?ml\\.txt$`, 'i').test(file.name)));
  if (hidden) return [`${hidden.name}: rename it to ${hidden.name.split('.')[0]}.yaml (Windows shows suffixes under View, File name extensions).`, 'files'];
  const wrong = files.find((file) => !limits.kinds.split(',').includes(suffix(file.name)));
  if (wrong) return [`${wrong.name}: files of this kind are not taken.`, 'files'];
  const bytes = files.reduce((sum, file) => sum + file.size, 0);
  if (bytes > Number(limits.bytes) || files.length > Number(limits.files)) {
    return [`${files.length} files with ${(bytes / 1e6).toFixed(0)} MB; at most ${limits.files} files with `
      + `${(limits.bytes / 1e6).toFixed(0)} MB.`, 'files'];
  }
  return null;
}

function testerFault() {
  if (at('tester').value === '' && !isDescribed() && !isScan()) return ['Choose the tester: the specimen and the plate under it.', 'tester'];
  const sizes = isRectangle() ? [at('size'), at('across'), at('plate')] : [at('size'), at('plate')];
  if (isOtherSize() && sizes.some((field) => !(number(field) > 0))) {
    return ['Give the diameter or sides of the specimen and the diameter of the plate in mm.', 'tester'];
  }
  return null;
}

function fault() {
  if (!chosen().length && !values().length) return ['No files yet: drop the views of a drape, or its photograph, here, or choose them; or give values from other tests or strips under weights.', 'files'];
  if (fileFault()) return fileFault();
  const density = at('density').value.trim().replace(',', '.');
  const isFurther = values().some((field) => field.closest('[data-further]')); // which may give it
  if ((density === '' && !isDescribed() && !isFurther) || Number.isNaN(Number(density))) {
    return ['Weigh the specimen and give its density in g/m², such as 210.', 'density_g_m2'];
  }
  return usesSetup() ? testerFault() : null;
}

// The name of the chosen tester, such as disc254_support127; empty where capture.yaml states it.
function tester() {
  const [specimen, holder] = at('tester').value.split('_');
  const sides = isRectangle() ? `${number(at('size'))}x${number(at('across'))}` : number(at('size'));
  return isOtherSize() ? `${specimen}${sides}_${holder}${number(at('plate'))}` : at('tester').value;
}

// Files and those fields that are within a part of the form. The plate that is placed in a
// photograph replaces what its files state. Over a mat, no field is in pixels of a file.
async function described(part) {
  const data = new FormData();
  for (const file of chosen()) data.append('files', isOverMat() ? await reduced(file) : file, file.name);
  for (const field of part.querySelectorAll('[name]:not([type=file]):not([type=radio])')) {
    const left = !('placed' in field.dataset) && (field.closest('[hidden]')
      || (at('setup').contains(field) && !usesSetup()) || (!isDrape() && field.closest('[data-capture]')));
    const value = field.name === 'tester' ? tester() : field.value.trim();
    if (value && !left) data.append(field.name, value);
  }
  return data;
}

async function content() {
  const data = await described(form);
  if (fabric) data.append('fabric', fabric);
  data.append('refine', at('refine').checked && isDrape() ? 'yes' : 'no');
  return data;
}

async function send() {
  clear();
  const wrong = fault();
  if (wrong) {
    complain(...wrong);
    return;
  }
  at('submit').disabled = true;
  try {
    const begun = await ask('/estimates', { method: 'POST', body: await content() });
    at('kept').hidden = !at('density').value;
    sent = { ...begun, added: Boolean(fabric) };
    if (broken) ask(`/fabrics/${broken}`, { method: 'DELETE' }).catch(() => {});
    broken = null;
    form.elements.label.value = '';
    location.hash = begun.id;
  } catch (error) {
    complain(error.lost ? 'The service cannot be reached. Your files are still chosen: press Estimate again.' : error.message,
      [413, 415].includes(error.status) ? 'files' : fieldOf(error.message));
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
    await send();
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
  if (capture && !at('density').value) at('density').value = capture.density_g_m2;
  if (capture && !at('tester').value && at('tester').querySelector(`[value="${capture.rig}"]`)) at('tester').value = capture.rig;
  at('files').focus();
  form.scrollIntoView();
}

// ---- pictures

function put(files) {
  const transfer = new DataTransfer();
  for (const file of files) transfer.items.add(file);
  at('files').files = transfer.files;
  check();
}

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

// `delay`, ms: how long further changes are waited for.
function lookAgain(delay) {
  at('seen-more').hidden = !isOverMat() || !drapes().length;
  at('another').disabled = isFull(drapes());
  at('another').closest('label').classList.toggle('disabled', at('another').disabled);
  listPictures();
  look(hasPhotograph() ? () => asked() : null, delay);
}

async function asked() {
  const data = await described(at('setup'));
  if (at('warp').value.trim()) data.append('warp_direction_deg', at('warp').value.trim());
  return data;
}

function listPictures() {
  const several = drapes().length > 1 ? drapes() : [];
  at('pictures').replaceChildren(...several.map((file) => {
    const item = element('li', `${file.name.replace(/\.\w+$/, '')} `);
    const button = element('button', '×', 'quiet small');
    button.type = 'button';
    button.setAttribute('aria-label', `leave out ${file.name}`);
    button.addEventListener('click', () => show(several.filter((one) => one !== file), []));
    item.append(button);
    return item;
  }));
}

// The pictures of a drape, with those of plate and mat and the description that are chosen already.
async function show(pictures, added) {
  const rest = chosen().filter((file) => !['.zip', ...limits.photographs.split(',')].includes(suffix(file.name)) || isBeside(file));
  at('seen').hidden = false;
  put([...rest, ...await together(pictures, added)]);
  lookAgain(0);
}

// The fields of the next specimen, of which only those of the tester and the density stay.
function nextSpecimen() {
  addTo(null);
  for (const name of ['name', 'notes', 'label']) form.elements[name].value = '';
  put([]);
  look(null);
  form.scrollIntoView();
  at('files').focus({ preventScroll: true });
}

// ---- presets: the fields of the tester and the camera, in this browser, as well as what was typed last

const setup = () => [...at('setup').querySelectorAll('input:not([type=radio]), select')];
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

function fill(fields, values) {
  for (const field of fields) field.value = values[field.name || field.id] ?? '';
  choose(values.kind ?? 'depth');
}

// A phone may give up a page while its camera is open.
function remember() {
  localStorage.setItem(TYPED, JSON.stringify({ ...filled([...setup(), ...lasting()]), kind: kind(), preset: at('preset').value }));
}

function recall() {
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

// The fields that others make necessary.
function showFields() {
  for (const label of form.querySelectorAll('.sizes')) label.hidden = !isOtherSize();
  for (const part of form.querySelectorAll('[data-rectangle]')) part.hidden = !isRectangle();
  for (const part of form.querySelectorAll('[data-mat]')) part.hidden = !form.elements.mat.value;
  for (const part of form.querySelectorAll('[data-no-mat]')) part.hidden = Boolean(form.elements.mat.value);
  const fromArrow = kind() === 'above' && Boolean(form.elements.mat.value); // where the warp counts from
  at('warp-mat').hidden = !fromArrow;
  at('warp-picture').hidden = fromArrow;
  at('warp-name').textContent = fromArrow ? "Warp from the mat's arrow" : 'Warp in the picture';
}

// ---- events

at('files').addEventListener('change', check);
for (const field of [at('tester'), form.elements.mat]) field.addEventListener('change', showFields);
at('add-strip').addEventListener('click', addStrip);
at('preset').addEventListener('change', applyPreset);
for (const part of [at('camera'), at('warp')]) part.addEventListener('change', () => lookAgain());
at('files').addEventListener('change', () => lookAgain(0));
at('shot').addEventListener('change', ({ target }) => {
  show([], [...target.files]);
  target.value = ''; // the next picture may have the same name
});
at('another').addEventListener('change', ({ target }) => {
  show(drapes(), [...target.files]);
  target.value = '';
});
at('next-specimen').addEventListener('click', nextSpecimen);
form.addEventListener('change', remember);
at('density').addEventListener('input', () => { at('kept').hidden = true; });
at('preset-save').addEventListener('click', savePreset);
at('preset-remove').addEventListener('click', removePreset);
at('into-none').addEventListener('click', () => addTo(null));
for (const radio of form.querySelectorAll('[name=kind]')) radio.addEventListener('change', () => choose(kind()));
for (const what of ['dragover', 'dragenter']) {
  document.addEventListener(what, (event) => {
    event.preventDefault();
    at('drop').classList.add('over');
  });
}
document.addEventListener('dragleave', (event) => event.relatedTarget ?? at('drop').classList.remove('over'));
document.addEventListener('drop', (event) => {
  event.preventDefault();
  at('drop').classList.remove('over');
  at('files').files = event.dataTransfer.files;
  check();
  lookAgain(0);
});
form.addEventListener('submit', (event) => {
  event.preventDefault();
  send();
});
for (const button of document.querySelectorAll('[data-example]')) {
  button.addEventListener('click', () => tryExample(button.dataset.example));
}
recall();
