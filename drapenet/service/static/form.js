// The form: what is checked before it is sent, presets, and errors beside their fields.

import { ask, at, element, keepOwn, plainly, tester as inWords, unfold } from './common.js';
import { look, preview } from './outline.js';
import { areLarge, isFull, reduced, together } from './pictures.js';
import { areaOf, number, setTester, testerName } from './support.js';

const PRESETS = 'drapenet.presets';
const TYPED = 'drapenet.typed'; // what stays for the next specimen
const limits = document.body.dataset;
const form = at('form');
let fabric = null; // of the next capture; null: a new one
let sent = null; // the estimate that this form has sent last
let broken = null; // the new fabric whose only capture failed; sending again replaces it

// ---- errors

const PARTS = { intrinsics: 'fx', weight_g: 'density_g_m2', plate_px: 'plate_x', 'plate_px.x': 'plate_x', 'plate_px.y': 'plate_y', 'plate_px.diameter': 'plate_diameter' };
const WORDS = ['name', 'support', 'weighed', 'notes', 'label', 'face', 'unit', 'tester', 'mat', 'arrow', 'centred', 'angles', 'kind', 'files', 'date', 'operator', 'laboratory', 'camera', 'remarks'];

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
  let field = name === 'files' ? at('shot') : name && form.elements[name] && form.querySelector(`[name="${name}"]`);
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
  unfold(field);
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
const isRectangle = () => at('tester').value === 'rectangle_cylinder';
const isOtherSize = () => at('tester').value.includes('_') && !/\d/.test(at('tester').value);
const kind = () => form.elements.kind.value;
const isTable = () => chosen().some((file) => ['.csv', '.txt'].includes(suffix(file.name)));
const isOverMat = () => usesSetup() && kind() === 'above' && Boolean(form.elements.mat.value) && !isTable();
const isWeighed = () => form.elements.weighed.value === 'specimen'; // in grams

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

// Whether a picture in PNG has depths: it is grey, a photograph is in colour (the byte is that of its kind of colour).
async function hasDepth(file) {
  return suffix(file.name) === '.png' && !/^outline\./i.test(file.name)
    && new Uint8Array(await file.slice(0, 26).arrayBuffer())[25] === 0;
}

async function chooseByFiles() {
  const files = chosen();
  if (!files.length) choose('above'); // the page asks for a picture
  if (!isDrape() || isScan() || !usesSetup()) return;
  if (files.some(isCertainlyPhotograph) || isTable()) choose('above');
  else if (files.some((file) => ['.npy', '.ply'].includes(suffix(file.name))) || (await Promise.all(files.map(hasDepth))).some(Boolean)) {
    choose('depth');
    if (!isDescribed()) unfold(form.elements.fx);
  }
}

function check() {
  clear();
  for (const field of form.querySelectorAll('[data-placed]')) { // in another photograph
    field.value = '';
    delete field.dataset.placed;
  }
  at('override').hidden = !isDescribed() || isBesideDrapes();
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
  if (at('tester').value === '' && !isDescribed() && !isScan()) return ['Choose what it lies on, the specimen and the plate under it.', 'tester'];
  const sizes = isRectangle() ? [at('size'), at('across'), at('plate')] : [at('size'), at('plate')];
  if (isOtherSize() && sizes.some((field) => !(number(field) > 0))) {
    return ['Give the diameter or sides of the specimen and the diameter of the plate in mm.', 'tester'];
  }
  return null;
}

function fault() {
  if (!chosen().length && !values().length) return ['No picture yet: take one from straight above, or open "I have files".', 'files'];
  if (fileFault()) return fileFault();
  const density = at('density').value.trim().replace(',', '.');
  const isFurther = values().some((field) => field.closest('[data-further]')); // which may give it
  if ((density === '' && !isDescribed() && !isFurther) || Number.isNaN(Number(density))) {
    return ['Weigh the specimen: its g/m², such as 210, or its grams.', 'density_g_m2'];
  }
  const wrong = usesSetup() ? testerFault() : null;
  if (wrong || !isOverMat() || !drapes().length || form.elements.plate_height_mm.value.trim()) return wrong;
  return ['Measure how high the top that the cloth lies on is over the mat.', 'plate_height_mm'];
}

// g/m² of what is typed, as text; a specimen's grams count for its area, which the tester states, of the form or of the files.
function density() {
  const area = usesSetup() || !chosen().length ? areaOf(testerName()) : 0;
  if (!isWeighed()) return at('density').value.trim();
  return area && number(at('density')) > 0 ? (number(at('density')) / area).toPrecision(4) : '';
}

// Files and those fields that are within a part of the form. The plate that is placed in a
// photograph replaces what its files state. A picture is not reduced if fields are typed in its pixels.
async function described(...parts) {
  const data = new FormData();
  const smaller = isOverMat() || (usesSetup() && !statesPixels() && areLarge(chosen()));
  for (const file of chosen()) data.append('files', smaller ? await reduced(file) : file, file.name);
  for (const field of parts.flatMap((part) => [...part.querySelectorAll('[name]:not([type=file]):not([type=radio])')])) {
    const left = !('placed' in field.dataset) && (field.closest('[hidden]') || (field.closest('[data-setup]') && !usesSetup())
      || (isTable() && (field.closest('[data-mat]') || field.name === 'mat')) || (!isDrape() && field.closest('[data-capture]')));
    const value = { tester: testerName, density_g_m2: density }[field.name]?.() ?? field.value.trim();
    if (value && !left) data.append(field.name, value);
  }
  return data;
}

const statesPixels = () => ['plate_x', 'plate_y', 'plate_diameter', 'mm_per_px'].map((name) => form.elements[name])
  .some((field) => field.value && !('placed' in field.dataset));

// Whether the files name the fabric, which a zip does by its own name at least.
async function isNamed() {
  const texts = await Promise.all(chosen().filter((file) => suffix(file.name) === '.yaml').map((file) => file.text()));
  return texts.some((text) => /^fabric *:/m.test(text)) || chosen().some((file) => suffix(file.name) === '.zip');
}

// Day and time, such as 2026-11-30 14:05.
function today() {
  const now = new Date();
  return new Date(now - 60000 * now.getTimezoneOffset()).toISOString().slice(0, 16).replace('T', ' ');
}

// An example states its own weight; others have the one that was typed, grams only for their own specimen.
async function content(isExample) {
  const data = await described(form);
  if (fabric) data.append('fabric', fabric);
  else if (!data.has('name') && !await isNamed()) data.append('name', today());
  if (isExample) data.delete('density_g_m2');
  else if (isWeighed() && !data.has('density_g_m2') && at('kept').hidden && at('density').value.trim()) data.append('weight_g', at('density').value.trim());
  data.append('refine', at('refine').checked && isDrape() ? 'yes' : 'no');
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

// ---- pictures

function put(files) {
  const transfer = new DataTransfer();
  for (const file of files) transfer.items.add(file);
  at('files').files = transfer.files;
  check();
  return chooseByFiles();
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

// `delay`, ms: how long further changes are waited for. A picture that cannot be read yet is shown as it is.
function lookAgain(delay) {
  at('seen-more').hidden = !isOverMat() || !drapes().length;
  at('another').disabled = isFull(drapes());
  at('another').closest('label').classList.toggle('disabled', at('another').disabled);
  listPictures();
  askOpen();
  if (hasPhotograph() || !questions().length) look(hasPhotograph() ? () => asked() : null, delay);
  else preview(drapes().at(-1), delay);
}

const QUESTIONS = [['tester', 'what it lies on'], ['plate_height_mm', 'how high its top is'], ['density_g_m2', 'how heavy it is']];

// Names the questions that are still open, once there is a picture; the weight is not needed to read it.
function askOpen() {
  const open = questions().filter((k) => hasPhotograph() || k < QUESTIONS.length).map((k) => {
    const [name, text] = QUESTIONS[k - 1];
    const button = element('button', text, 'plain');
    button.type = 'button';
    button.addEventListener('click', () => {
      form.elements[name].closest('fieldset').scrollIntoView();
      (k === 1 ? form.elements.support[0] : form.elements[name]).focus({ preventScroll: true });
    });
    return button;
  });
  const why = hasPhotograph() ? 'Before the estimate, please say ' : 'The picture is here. To read it, please say ';
  at('still').replaceChildren(...open.flatMap((one, k) => [k ? ' and ' : why, one]), open.length ? '.' : '');
}

// Numbers of those that are not answered, if there is a picture that its files do not describe.
function questions() {
  if (!drapes().length || !usesSetup() || kind() !== 'above') return [];
  return [Boolean(testerFault()), isOverMat() && !form.elements.plate_height_mm.value.trim(), !density()]
    .flatMap((isOpen, k) => (isOpen ? [k + 1] : []));
}

async function asked() {
  const data = await described(...form.querySelectorAll('[data-setup]'));
  if (at('warp').value.trim()) data.append('warp_direction_deg', at('warp').value.trim());
  return data;
}

function listPictures() {
  const several = drapes().length > 1 ? drapes() : [];
  at('pictures').replaceChildren(...several.map((file) => {
    const name = plainly(file.name).replace(/\.\w+$/, '');
    const item = element('li', `${name} `);
    const button = element('button', '×', 'quiet small');
    button.type = 'button';
    button.setAttribute('aria-label', `leave out ${name}`);
    button.addEventListener('click', () => show(several.filter((one) => one !== file), []));
    item.append(button);
    return item;
  }));
}

// The pictures of a drape, with those of plate and mat and the description that are chosen already.
async function show(pictures, added) {
  const rest = chosen().filter((file) => !['.zip', ...limits.photographs.split(',')].includes(suffix(file.name)) || isBeside(file));
  at('seen').hidden = false;
  choose('above');
  await put([...rest, ...await together(pictures, added)]);
  lookAgain(0);
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

// ---- presets: the fields of the tester and the camera, in this browser, as well as what was typed last

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
function remember() {
  localStorage.setItem(TYPED, JSON.stringify({ ...filled([...setup(), ...lasting()]), kind: kind(), weighed: form.elements.weighed.value, preset: at('preset').value }));
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
  showAnswers();
  const fromArrow = kind() === 'above' && Boolean(form.elements.mat.value); // where the warp counts from
  at('warp-mat').hidden = !fromArrow;
  at('warp-picture').hidden = fromArrow;
  at('warp-name').textContent = fromArrow ? "Warp from the mat's arrow" : 'Warp in the picture';
}

// What the answers to the three questions say.
function showAnswers() {
  const name = testerName();
  const one = name.includes('_support180') ? 'disc300_support180' : name.startsWith('disc') ? 'disc254_support127' : name && 'square300_cylinder100';
  for (const card of form.elements.support) card.checked = card.value === one;
  at('support-said').textContent = areaOf(name) ? `${inWords(name).replace(' on ', ' on a top of ').replace(/^./, (letter) => letter.toUpperCase())}.` : '';
  at('weight-said').textContent = !isWeighed() ? '' : at('density').value.trim() === '' ? 'Of the whole specimen.' : density() ? `${Number(density()).toPrecision(3)} g/m², for its area.`
    : areaOf(name) ? '' : 'Its area follows from what it lies on.';
  const isAnswered = [areaOf(name), !form.elements.mat.value || form.elements.plate_height_mm.value.trim(), density()];
  isAnswered.forEach((answer, k) => at(`asked-${k + 1}`).classList.toggle('done', Boolean(answer)));
}

// ---- events

at('files').addEventListener('change', async () => {
  check();
  await chooseByFiles();
  lookAgain(0);
});
for (const field of [at('tester'), form.elements.mat]) field.addEventListener('change', showFields);
for (const kind of ['input', 'change']) form.addEventListener(kind, showAnswers);
form.addEventListener('change', askOpen);
for (const card of form.elements.support) {
  card.addEventListener('change', () => {
    setTester(card.value);
    showFields();
    if (isOtherSize()) at('sizes').open = true;
  });
}
at('override').addEventListener('change', chooseByFiles);
at('to-camera').addEventListener('click', () => {
  unfold(form.elements.camera_height_mm);
  form.elements.camera_height_mm.focus();
});
at('no-mat').addEventListener('click', () => {
  form.elements.mat.value = '';
  form.elements.mat.dispatchEvent(new Event('change', { bubbles: true }));
});
at('seen').addEventListener('read', ({ detail: found }) => { // of another mat than the form states
  const [, shows] = /shows the mat (\w+), not the mat/.exec(found?.refusal ?? '') ?? [];
  at('no-mat').hidden = !isOverMat() || !found?.refusal || Boolean(shows);
  if (!isOverMat() || !shows) return;
  form.elements.mat.value = shows;
  at('mat-said').textContent = `The picture shows the ${shows.toUpperCase()} mat, which is chosen now.`;
  form.elements.mat.dispatchEvent(new Event('change', { bubbles: true }));
});
form.elements.mat.addEventListener('change', ({ isTrusted }) => {
  if (isTrusted) at('mat-said').textContent = '';
});
at('add-strip').addEventListener('click', addStrip);
at('preset').addEventListener('change', applyPreset);
for (const part of [...form.querySelectorAll('[data-setup]'), at('camera'), at('override'), at('warp')]) part.addEventListener('change', () => lookAgain());
for (const input of [at('shot'), at('gallery')]) {
  input.addEventListener('change', ({ target }) => {
    show([], [...target.files]);
    target.value = ''; // the next picture may have the same name
  });
}
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
    document.body.classList.add('over');
  });
}
document.addEventListener('dragleave', (event) => event.relatedTarget ?? document.body.classList.remove('over'));
document.addEventListener('drop', (event) => {
  event.preventDefault();
  document.body.classList.remove('over');
  at('files').files = event.dataTransfer.files;
  at('from-files').open ||= !chosen().every(isPhotograph); // which shows what is chosen
  at('files').dispatchEvent(new Event('change', { bubbles: true }));
});
form.addEventListener('submit', (event) => {
  event.preventDefault();
  send();
});
for (const button of document.querySelectorAll('[data-example]')) {
  button.addEventListener('click', () => tryExample(button.dataset.example));
}
recall();
