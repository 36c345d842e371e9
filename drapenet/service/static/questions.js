// The questions: which fields others make necessary, which are still open, and what the answers say.

import { at, capital, element, tester as inWords, unfold } from './common.js';
import { chosen, density, drapes, form, isCertainlyPhotograph, isDrape, isOtherSize, isOverMat, isPhotograph, isRectangle, isScan, isWeighed, kind, suffix, usesSetup } from './fields.js';
import { fileFault, testerFault, unitFault } from './faults.js';
import { areaOf, setTester, testerName } from './support.js';

// Whether the service is asked how it reads a photograph: it has what it needs for that.
export function hasPhotograph() {
  const files = chosen();
  if (!isDrape() || isScan()) return false;
  if (!usesSetup()) return files.some((file) => isCertainlyPhotograph(file) || suffix(file.name) === '.zip');
  return kind() === 'above' && files.some((file) => isPhotograph(file) || suffix(file.name) === '.zip')
    && (!form.elements.mat.value || form.elements.plate_height_mm.value !== '') && !fileFault() && !testerFault();
}

export function choose(value) {
  form.elements.kind.value = value;
  for (const set of form.querySelectorAll('[data-kind]')) set.hidden = set.dataset.kind !== value;
  showFields();
}

const QUESTIONS = [['tester', 'what it lies on'], ['plate_height_mm', 'how high its top is'], ['density_g_m2', 'how heavy it is']];

// Names the questions that are still open, once there is a picture; the weight is not needed to read it.
export function askOpen() {
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
export function questions() {
  if (!drapes().length || !usesSetup() || kind() !== 'above') return [];
  return [Boolean(testerFault()), isOverMat() && !form.elements.plate_height_mm.value.trim(), !density()]
    .flatMap((isOpen, k) => (isOpen ? [k + 1] : []));
}

// The fields that others make necessary.
export function showFields() {
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
export function showAnswers() {
  const name = testerName();
  const one = name.includes('_support180') ? 'disc300_support180' : name.startsWith('disc') ? 'disc254_support127' : name && 'square300_cylinder100';
  for (const card of form.elements.support) card.checked = card.value === one;
  at('support-said').textContent = areaOf(name) ? `${capital(inWords(name)).replace(' on ', ' on a top of ')}.` : '';
  at('of-tins')?.toggleAttribute('hidden', one !== 'disc254_support127');
  at('other-unit').textContent = unitFault();
  at('other-unit').hidden = !unitFault();
  at('weight-said').textContent = !isWeighed() ? '' : at('density').value.trim() === '' ? 'Of the whole specimen.' : density() ? `${Number(Number(density()).toPrecision(3))} g/m², for its area.`
    : areaOf(name) ? '' : 'Its area follows from what it lies on.';
  const isAnswered = [areaOf(name), !form.elements.mat.value || form.elements.plate_height_mm.value.trim(), density()];
  isAnswered.forEach((answer, k) => at(`asked-${k + 1}`).classList.toggle('done', Boolean(answer)));
}

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
at('other-unit').addEventListener('click', () => {
  form.elements.weighed.value = isWeighed() ? 'area' : 'specimen';
  at('density').dispatchEvent(new Event('change', { bubbles: true }));
});
at('to-camera').addEventListener('click', () => {
  unfold(form.elements.camera_height_mm);
  form.elements.camera_height_mm.focus();
});
at('no-mat').addEventListener('click', () => {
  form.elements.mat.value = '';
  form.elements.mat.dispatchEvent(new Event('change', { bubbles: true }));
});
form.elements.mat.addEventListener('change', ({ isTrusted }) => {
  if (isTrusted) at('mat-said').textContent = '';
});
for (const radio of form.querySelectorAll('[name=kind]')) radio.addEventListener('change', () => choose(kind()));
