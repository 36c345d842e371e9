// Sentences of the service as the page says them: fields by their labels, pictures by their numbers. Terminal, Python and
// HTTP interface name fields by the keys of files.

import { form, isDescribed } from './fields.js';

// Fields that stand for other keys of files, and the words for keys of no field.
export const PARTS = { intrinsics: 'fx', weight_g: 'density_g_m2', plate_px: 'plate_x', 'plate_px.x': 'plate_x', 'plate_px.y': 'plate_y', 'plate_px.diameter': 'plate_diameter' };
const CALLED = { plate_px: 'the circle of the plate', error_percent: 'error %' };

// By the name that the page gives a field for sentences, the one that is read aloud, or the words before it.
function called(field) {
  const words = [...field.closest('label')?.childNodes ?? []].filter((part) => part.nodeType === Node.TEXT_NODE || part.id);
  const label = field.dataset.called ?? field.getAttribute('aria-label') ?? words.map((part) => part.textContent.trim()).join(' ').trim();
  return label.replace(/, (mm|percent)$| \[[^\]]*\]/g, ''); // the unit
}

// What the page calls each key that is no usual word: a field's, or a part of it, such as that of a value along warp and weft.
function labels() {
  const found = { ...CALLED };
  for (const field of form.querySelectorAll('[name]:not([type=radio])')) {
    const key = field.name.replace(/^known\./, '');
    if (/[._]/.test(key)) found[key] ??= called(field);
    for (const part of key.split('.')) if (part.includes('_')) found[part] ??= called(field).replace(/ (warp|bias|weft)$/, '');
  }
  for (const [key, name] of Object.entries(PARTS)) if (/[._]/.test(key)) found[key] ??= found[name];
  return found;
}

// Sentences whose remedy the page has in another form than files.
const SAID = [[/the scale is not known: .*/, 'the scale is not known: lay the printed mat under the stand, or drag the dashed circle to the edge of the plate’s top, and state how far above it the camera was']];

// What is said of a file, and of what files state, keeps its keys.
function withLabels(sentence) {
  const said = sentence.replace(/; (known has values|outline is) such as .*/, '').replace(/^(outline|known) (has )?/, '').replaceAll(/, such as \{[^}]*\}/g, '').replace(/^(tension|strips)\.(\d+)(?= has )/, (all, list, k) => `strip ${Number(k) + 1}`);
  if (/\.yaml\b/.test(said) || isDescribed()) return sentence;
  const other = SAID.find(([from]) => from.test(said));
  if (other) return said.replace(...other);
  const found = labels();
  const keys = Object.keys(found).sort((one, other) => other.length - one.length).join('|').replaceAll('.', '\\.');
  return said.replaceAll(new RegExp(`(?<![\\w.])(?:outline\\.|known\\.)?(${keys})(?!\\w|\\.\\w)=?`, 'g'), (all, key) => `“${found[key]}”${all.endsWith('=') ? ' = ' : ''}`);
}

// Without the names that pictures have at the service, which nobody gave them.
export const plainly = (sentence) => withLabels(sentence.replaceAll(/, outline_\d\.[a-z]+,/g, ',').replaceAll(/\boutline_(\d)\.[a-z]+/g, 'picture $1')
  .replaceAll(/\boutline\.(jpe?g|png|hei[cf]|webp|avif|tiff?)\b/g, 'the picture').replaceAll('outline.mat', 'the mat'));
