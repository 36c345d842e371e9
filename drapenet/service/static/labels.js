// What the page calls the keys of files, by the labels of its form.

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
export function labelsOf(form) {
  const found = { ...CALLED };
  for (const field of form.querySelectorAll('[name]:not([type=radio])')) {
    const key = field.name.replace(/^known\./, '');
    if (/[._]/.test(key)) found[key] ??= called(field);
    for (const part of key.split('.')) if (part.includes('_')) found[part] ??= called(field).replace(/ (warp|bias|weft)$/, '');
  }
  for (const [key, name] of Object.entries(PARTS)) if (/[._]/.test(key)) found[key] ??= found[name];
  return found;
}
