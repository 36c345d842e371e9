// What the specimen lies on: the tester that the form states, by name and by area.

import { at } from './common.js';

const LAST = { disc: 'support', square: 'cylinder', rectangle: 'cylinder' };
const NAME = /^(disc|square|rectangle)([\d.]+)(?:x([\d.]+))?_[a-z]+([\d.]+)(?:_rim([\d.]+))?$/;

export const number = (field) => Number(field.value.trim().replace(',', '.'));

// The name of the tester, such as disc254_support127_rim3; empty where the form states none.
export function testerName() {
  const stated = at('tester').value;
  const [specimen, holder] = stated.split('_');
  const sides = specimen === 'rectangle' ? `${number(at('size'))}x${number(at('across'))}` : number(at('size'));
  const rim = number(at('rim')) ? `_rim${number(at('rim'))}` : '';
  return stated && `${/\d/.test(stated) ? stated : `${specimen}${sides}_${holder}${number(at('plate'))}`}${rim}`;
}

// State a tester by its name, in the fields of another size unless the form lists it.
export function setTester(name) {
  const [, specimen, size, across = '', plate, rim = ''] = NAME.exec(name) ?? [];
  if (!specimen) return;
  const isListed = at('tester').querySelector(`[value="${name}"]`);
  at('tester').value = isListed ? name : `${specimen}_${LAST[specimen]}`;
  for (const [id, value] of Object.entries(isListed ? { rim } : { size, across, plate, rim })) at(id).value = value;
}

// Diameter of the top, mm, as text; undefined where it is not known.
export const topOf = (name) => NAME.exec(name)?.[4];

// Area of a specimen, m²; 0 where its sizes are not known.
export function areaOf(name) {
  const [, specimen, size, across = size] = NAME.exec(name) ?? [];
  return specimen ? (specimen === 'disc' ? Math.PI / 4 : 1) * size * across * 1e-6 : 0;
}
