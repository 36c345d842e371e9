// The result at a glance: three numbers, a scale from chiffon to canvas, and what they mean.

import { at, capital, element, texts } from './common.js';

const GRAVITY = 9.81; // m/s²
// Fabrics by bending length, mm, which for a KES B is (B/ρg)^⅓, and where they are published.
const MARKS = [
  ['chiffon', 6, 'the limp end of the fabrics that the network has learned (manual: training, Which fabrics)'],
  ['suiting', 10.6, 'twill of 75 % wool, 179 g/m², KES B 2.14 and 2.00 µN·m: Petrak et al., Sustainability 2025, 17, 1388'],
  ['poplin', 21.2, 'cotton broadcloth, 124 g/m², KES B 11.6 µN·m: Matsudaira et al., Journal of Textile Engineering 61(6), 2015, 69-73'],
  ['denim', 40, 'denim of 475 g/m² (manual: training, Which fabrics)'],
  ['canvas', 62, 'the stiff end of the fabrics that the network has learned (manual: training, Which fabrics)'],
];
const NEAR = 6; // percent of the scale, within which a fabric is like one of the marks
const [LEAST, MOST] = [MARKS[0][1], MARKS.at(-1)[1]];
const placeAt = (length) => 100 * Math.log(length / LEAST) / Math.log(MOST / LEAST); // percent of the scale

// Mean log α in µN·m, and its standard deviation, of three directions whose errors go together.
function mean(moduli, correlations) {
  const ends = Object.values(moduli).map(({ alpha_uN_m: { interval_68: interval, median } }) => [...interval, median].map(Math.log));
  const spread = ends.map(([low, high]) => (high - low) / 2);
  const variance = spread.reduce((sum, one, i) => sum + spread.reduce((inner, other, j) => inner + one * other * correlations.matrix[i][j], 0), 0);
  return [ends.reduce((sum, [, , middle]) => sum + middle, 0) / 3, Math.sqrt(variance) / 3];
}

// Place of a mean log α, µN·m, on the scale: cloth of this density, g/m², and this α has the bending length of a mark.
const placeOf = (value, density) => placeAt(Math.cbrt(1e6 * Math.exp(value) / (GRAVITY * density)));

const within = (place) => Math.min(Math.max(place, 0), 100);

// Words for a place: the mark at it, or those on either side.
function near(place) {
  const all = MARKS.map(([name, length]) => [name, placeAt(length)]);
  const [closest, at0] = all.reduce((best, one) => (Math.abs(one[1] - place) < Math.abs(best[1] - place) ? one : best));
  if (Math.abs(at0 - place) <= NEAR) return `like ${closest}`;
  if (place < 0 || place > 100) return `${place < 0 ? 'limper' : 'stiffer'} than ${closest}`;
  const after = all.findIndex(([, other]) => other > place);
  return `between ${all[after - 1][0]} and ${all[after][0]}`;
}

function part(kind, name, left, text = '', title = '') {
  const made = element(kind, text, name);
  made.style.left = `${left.toFixed(1)}%`;
  if (title) made.title = title;
  return made;
}

export function showHeadline({ moduli, laboratory, capture, correlations, assumed, next_measurements: next }) {
  const alphas = Object.entries(moduli).map(([direction, { alpha_uN_m: alpha }]) => [direction, texts(alpha)]);
  at('alphas').replaceChildren(...alphas.map(([direction, { median, near: interval }]) => {
    const one = element('div');
    one.append(element('dt', direction), element('dd', median, 'n'), element('dd', interval));
    return one;
  }));
  const density = capture.density_g_m2;
  const [middle, deviation] = mean(moduli, correlations);
  const [place, low, high] = [0, -deviation, deviation].map((more) => placeOf(middle + more, density));
  const bar = part('span', 'range', within(low));
  bar.style.width = `${(within(high) - within(low)).toFixed(1)}%`;
  at('scale').replaceChildren(bar, part('span', 'dot', within(place)),
    ...MARKS.map(([name, length, source]) => part('abbr', '', placeAt(length), name, source)));
  at('scale').setAttribute('aria-label', `stiffness at this weight, from ${MARKS[0][0]} to ${MARKS.at(-1)[0]}: ${near(place)}`);
  const over = Object.entries(laboratory).filter(([direction]) => direction !== 'bias')
    .map(([direction, { bending_length_mm: { median } }]) => `${(median / 5).toFixed(1)} cm along the ${direction}${/^w/.test(direction) ? '' : ' direction'}`);
  at('meaning').textContent = `At ${Number(density.toPrecision(3))} g/m² it hangs ${near(place)}. A strip pushed over the edge of a table sinks to 41.5° once it sticks out by ${over.join(', ')}.${(assumed ?? []).filter(({ code }) => code === 'bending_usual').map(({ text }) => ` ${capital(text)}.`).join('')}`;
  at('next').textContent = next?.length ? `To know it better: ${next[0].measurement} (${next[0].minutes} min).` : '';
  at('numbers').hidden = false;
}
