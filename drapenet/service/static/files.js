// The files and pictures of the form: which are chosen, how they are read, and what is sent of them.

import { at, element, unfold } from './common.js';
import { clear } from './faults.js';
import {
  chosen, density, drapes, form, isBeside, isBesideDrapes, isCertainlyPhotograph, isDescribed, isDrape, isOverMat, isScan, isTable,
  limits, suffix, usesSetup,
} from './fields.js';
import { look, preview } from './outline.js';
import { areLarge, isFull, reduced, together } from './pictures.js';
import { askOpen, choose, hasPhotograph, questions } from './questions.js';
import { testerName } from './support.js';
import { plainly } from './words.js';

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
  for (const field of form.querySelectorAll('[data-placed], [data-estimated]')) { // in or with another photograph
    field.value = '';
    delete field.dataset.placed;
    delete field.dataset.estimated;
  }
  at('override').hidden = !isDescribed() || isBesideDrapes();
}

// Files and those fields that are within a part of the form. The plate that is placed in a
// photograph replaces what its files state. A picture is not reduced if fields are typed in its pixels.
export async function described(...parts) {
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

export function put(files) {
  const transfer = new DataTransfer();
  for (const file of files) transfer.items.add(file);
  at('files').files = transfer.files;
  check();
  return chooseByFiles();
}

// `delay`, ms: how long further changes are waited for. A picture that cannot be read yet is shown as it is.
export function lookAgain(delay) {
  at('seen-more').hidden = !isOverMat() || !drapes().length;
  at('another').disabled = isFull(drapes());
  at('another').closest('label').classList.toggle('disabled', at('another').disabled);
  listPictures();
  askOpen();
  if (hasPhotograph() || !questions().length) look(hasPhotograph() ? () => asked() : null, delay);
  else preview(drapes().at(-1), delay);
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
export async function show(pictures, added) {
  const rest = chosen().filter((file) => !['.zip', ...limits.photographs.split(',')].includes(suffix(file.name)) || isBeside(file));
  at('seen').hidden = false;
  choose('above');
  await put([...rest, ...await together(pictures, added)]);
  lookAgain(0);
}

at('files').addEventListener('change', async () => {
  check();
  await chooseByFiles();
  lookAgain(0);
});
at('override').addEventListener('change', chooseByFiles);
at('seen').addEventListener('read', ({ detail: found }) => { // of another mat than the form states
  const [, shows] = /shows the mat (\w+), not the mat/.exec(found?.refusal ?? '') ?? [];
  at('no-mat').hidden = !isOverMat() || !found?.refusal || Boolean(shows) || /must be|try again/.test(found.refusal);
  if (!isOverMat() || !shows) return;
  form.elements.mat.value = shows;
  at('seen-refusal').textContent = '';
  at('mat-said').textContent = `The picture shows the ${shows.toUpperCase()} mat, which is chosen now.`;
  form.elements.mat.dispatchEvent(new Event('change', { bubbles: true }));
});
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
