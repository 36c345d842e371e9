// Faults of the form before it is sent, and errors beside their fields.

import { at, element, unfold } from './common.js';
import {
  chosen, descriptions, drapes, form, isDescribed, isOtherSize, isOverMat, isRectangle, isScan, isWeighed, limits, suffix, usesSetup, values,
} from './fields.js';
import { PARTS } from './labels.js';
import { areaOf, number, testerName } from './support.js';
import { plainly } from './words.js';

const WORDS = ['name', 'support', 'weighed', 'notes', 'label', 'face', 'unit', 'tester', 'mat', 'arrow', 'centred', 'angles', 'kind', 'files', 'date', 'operator', 'laboratory', 'camera', 'remarks'];

// The field that a sentence of the service names first; words of sentences only where they have a value.
export function fieldOf(sentence) {
  const [, entry, key] = sentence.match(/^(\w+\.\d+) has (\w+) /) ?? []; // of a list
  if (form.elements[`${entry}.${key}`]) return `${entry}.${key}`;
  const names = [...new Set([...form.elements].map((field) => field.name).filter(Boolean)), ...Object.keys(PARTS)];
  const found = names.map((name) => {
    const after = WORDS.includes(name) ? '(?==| is missing|: (?:false|mm|clockwise))' : '(?![\\w.]*[a-z_])';
    return [name, sentence.search(new RegExp(`(?<![\\w])${name.replaceAll('.', '\\.')}${after}`))];
  }).filter(([, place]) => place >= 0).sort(([, a], [, b]) => a - b);
  return found.length ? PARTS[found[0][0]] ?? found[0][0] : null;
}

export function complain(said, name, focus = true) {
  const sentence = plainly(said);
  let field = name === 'files' ? at('shot') : name && form.elements[name] && form.querySelector(`[data-entry="${name}"], [name="${name}"]`);
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
  if (hidden?.hidden) form.querySelector(`[name=kind][value=${hidden.dataset.kind}]`).click();
  unfold(field);
  field.setAttribute('aria-invalid', 'true');
  field.setAttribute('aria-describedby', [error.id, field.getAttribute('aria-describedby')].filter(Boolean).join(' '));
  if (focus) field.focus();
}

// Take back what is said of a field.
export function absolve(field) {
  at(`error-${field.dataset.entry ?? field.name}`)?.remove();
  field.removeAttribute('aria-invalid');
  const rest = (field.getAttribute('aria-describedby') ?? '').split(' ').filter((id) => id && !id.startsWith('error-'));
  if (rest.length) field.setAttribute('aria-describedby', rest.join(' '));
  else field.removeAttribute('aria-describedby');
}

export function clear() {
  at('error').textContent = '';
  for (const error of form.querySelectorAll('[id^="error-"]')) error.remove();
  for (const field of form.querySelectorAll('[aria-invalid]')) absolve(field);
}

// Sentence and field of the first fault, or null: of the files, of the tester, and of all.
export function fileFault() {
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

export function testerFault() {
  if (at('tester').value === '' && !isDescribed() && !isScan()) return ['Choose what it lies on, the specimen and the plate under it.', 'tester'];
  const sizes = isRectangle() ? [at('size'), at('across'), at('plate')] : [at('size'), at('plate')];
  if (isOtherSize() && sizes.some((field) => !(number(field) > 0))) {
    return ['Give the diameter or sides of the specimen and the diameter of the plate in mm.', 'tester'];
  }
  return null;
}

// Asks for the other unit of the weight where that which is chosen makes it no usual cloth's, but the other does.
export function unitFault() {
  const [typed, area] = [number(at('density')), areaOf(testerName())];
  const isUsual = (value) => value >= Number(limits.light) && value <= Number(limits.heavy);
  const [as, other] = isWeighed() ? [typed / area, typed] : [typed, typed / area];
  if (!(typed > 0 && area && !isUsual(as) && isUsual(other))) return '';
  return isWeighed() ? `No cloth is so heavy. Is it ${typed} g/m²? Choose g/m²`
    : `Few cloths are so light. Does the specimen weigh ${typed} grams, ${Number(other.toPrecision(3))} g/m²? Choose grams`;
}

export function fault() {
  if (!chosen().length && !values().length) return ['No picture yet: take one from straight above, or open "I have files", or state values.', 'files'];
  if (fileFault()) return fileFault();
  if (!chosen().length && form.elements['known.drape_coefficient_percent'].value.trim() && !at('bench-tester').value) return ['Choose the specimen and plate of the drape coefficient.', null];
  const density = at('density').value.trim().replace(',', '.');
  const isFurther = values().some((field) => field.closest('[data-further]')); // which may give it
  if ((density === '' && !isDescribed() && !isFurther) || Number.isNaN(Number(density))) {
    return ['Weigh the specimen: its g/m², such as 210, or its grams.', 'density_g_m2'];
  }
  if (isWeighed() && unitFault()) return [unitFault(), 'density_g_m2'];
  const wrong = usesSetup() ? testerFault() : null;
  if (wrong || !isOverMat() || !drapes().length || form.elements.plate_height_mm.value.trim()) return wrong;
  return ['Measure how high the top that the cloth lies on is over the mat.', 'plate_height_mm'];
}

