// What the form states: its files, what they are, and what is typed.

import { at } from './common.js';
import { areaOf, number, testerName } from './support.js';

export const limits = document.body.dataset;
export const form = at('form');
export const suffix = (name) => name.slice(name.lastIndexOf('.')).toLowerCase().replace('.yml', '.yaml');
export const chosen = () => [...at('files').files];
export const isDescribed = () => chosen().some((file) => ['.zip', '.yaml'].includes(suffix(file.name)) || file.name === 'density.txt');
export const descriptions = limits.described.split(',').map((name) => name.replace(/\.\w+$/, ''));
const describes = (file) => descriptions.find((name) => new RegExp(`^${name}\\.ya?ml$`, 'i').test(file.name));
export const isBesideDrapes = () => chosen().some((file) => ![undefined, 'capture'].includes(describes(file)));
export const values = () => [...form.querySelectorAll('[data-values] input, [data-values] select')].filter((field) => field.value.trim());
export const isDrape = () => chosen().length > 0 && !isBesideDrapes();
export const isScan = () => chosen().length === 1 && !/^view_\d/.test(chosen()[0].name)
  && ['.npz', '.obj', '.ply', '.stl', '.glb'].includes(suffix(chosen()[0].name));
export const isPhotograph = (file) => limits.photographs.split(',').includes(suffix(file.name));
export const isCertainlyPhotograph = (file) => (isPhotograph(file) && suffix(file.name) !== '.png') || /^outline\./i.test(file.name);
export const isBeside = (file) => /(?<![a-z])(plate|empty|mat)(?![a-z])/i.test(file.name); // what shows no drape, as the service has it
export const drapes = () => chosen().filter((file) => isPhotograph(file) && !isBeside(file));
export const usesSetup = () => isDrape() && (!isDescribed() || at('override').querySelector('input').checked);
export const isRectangle = () => at('tester').value === 'rectangle_cylinder';
export const isOtherSize = () => at('tester').value.includes('_') && !/\d/.test(at('tester').value);
export const kind = () => form.elements.kind.value;
export const isTable = () => chosen().some((file) => ['.csv', '.txt'].includes(suffix(file.name)));
export const isOverMat = () => usesSetup() && kind() === 'above' && Boolean(form.elements.mat.value) && !isTable();
export const isWeighed = () => form.elements.weighed.value === 'specimen'; // in grams

// g/m² of what is typed, as text; a specimen's grams count for its area, which the tester states, of the form or of the files.
export function density() {
  const area = usesSetup() || !chosen().length ? areaOf(testerName()) : 0;
  if (!isWeighed()) return at('density').value.trim();
  return area && number(at('density')) > 0 ? (number(at('density')) / area).toPrecision(4) : '';
}

