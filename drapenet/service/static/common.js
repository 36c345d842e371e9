// What the parts of the page share. What comes from the service is put into the page as text only.

export const at = (id) => document.getElementById(id);

export function element(kind, text = '', name = '') {
  const made = document.createElement(kind);
  made.textContent = text;
  if (name) made.className = name;
  return made;
}

// With a capital first letter.
export const capital = (text) => text.replace(/^./, (letter) => letter.toUpperCase());

export function link(address, text) {
  const made = element('a', text);
  made.href = address;
  return made;
}

// Open all that a part is folded into.
export function unfold(part) {
  for (let fold = part.closest('details'); fold; fold = fold.parentElement.closest('details')) fold.open = true;
}

const OWN = 'drapenet.own';
const MOST_OWN = 500;

// Estimates that this browser has begun, the latest first.
export function own() {
  try {
    return JSON.parse(localStorage.getItem(OWN)) ?? [];
  } catch {
    return [];
  }
}

export function keepOwn(id) {
  localStorage.setItem(OWN, JSON.stringify([id, ...own()].slice(0, MOST_OWN)));
}

// Scroll to a section unless its beginning is in the upper half of what is seen.
export function reveal(section) {
  const { top } = at(section).getBoundingClientRect();
  if (top < 0 || top > innerHeight / 2) at(section).scrollIntoView();
}

const LOST = 'The service cannot be reached; try again.';

// An answer; an Error with the service's sentence and status if it refuses.
async function answered(address, options = {}) {
  let answer;
  try {
    answer = await fetch(address, options);
  } catch {
    throw Object.assign(new Error(LOST), { lost: true });
  }
  if (answer.ok) return answer;
  const { error } = await answer.json().catch(() => ({}));
  throw Object.assign(new Error(error ?? `The service answers ${answer.status}.`), { status: answer.status });
}

// Content of an answer in JSON; an Error as above.
export async function ask(address, options = {}) {
  const answer = await answered(address, options);
  return answer.status === 204 ? null : answer.json().catch(() => ({}));
}

// Save an answer under the name that the service gives it; what it refuses is said in a place.
export async function save(address, place) {
  at(place).textContent = '';
  try {
    const answer = await answered(address);
    const made = link(URL.createObjectURL(await answer.blob()), '');
    [, made.download] = /filename="([^"]*)"/.exec(answer.headers.get('content-disposition'));
    made.click();
    setTimeout(() => URL.revokeObjectURL(made.href), 10000);
  } catch (error) {
    at(place).textContent = error.status ? error.message : LOST;
  }
}

// As many digits as the interval's width deserves.
function places([low, high]) {
  const half = (high - low) / 2;
  return half > 0 ? Math.min(Math.max(1 - Math.floor(Math.log10(half)), 0), 6) : 0;
}

// Median and intervals of a quantity as texts.
export function texts(value) {
  const digits = places(value.interval_68);
  const range = (interval) => interval.map((end) => end.toFixed(digits)).join(' to ');
  return { median: value.median.toFixed(digits), near: range(value.interval_68), wide: range(value.interval_90) };
}

// Tables of an estimate: part of the document, quantity, name, unit.
export const QUANTITIES = [
  ['moduli', 'alpha_uN_m', 'α', 'µN·m'],
  ['moduli', 'beta_nN_m2', 'β', 'nN·m²'],
  ['moduli', 'drape_stiffness_uN_m', 'stiffness in a drape', 'µN·m'],
  ['laboratory', 'bending_length_mm', 'bending length', 'mm'],
  ['laboratory', 'flexural_rigidity_uN_m', 'rigidity G', 'µN·m'],
  ['laboratory', 'kes_b_gf_cm2_per_cm', 'KES B', 'gf·cm²/cm'],
  ['laboratory', 'kes_2hb_gf_cm_per_cm', 'KES 2HB', 'gf·cm/cm'],
];

export const percent = (value) => (value == null ? '' : `${value.toFixed(1)} %`);

// The tester's name, such as disc300_support180, in words; several with commas.
export function tester(rig) {
  return rig.split(', ').map((name) => name.replace(
    /^([a-z]+)([\d.x]+)_[a-z]+([\d.]+)/, '$1 of $2 mm on $3 mm').replace(
    /_rim([\d.]+)$/, ', rim $1 mm')).join('; ');
}

// What an estimate was made of.
function seen({ capture, captures, strips, tension, measured }) {
  const count = (strips ?? []).reduce((sum, one) => sum + one.strips, 0);
  const several = (number, name) => number && `${number} ${name}${number > 1 ? 's' : ''}`;
  const pulled = tension && `${tension.strips} strip${tension.strips > 1 ? 's' : ''} under weights`;
  const others = [...(measured ?? []).map((one) => one.kind), capture.source && capture.known?.drape_coefficient_percent && 'drape coefficient'];
  if (captures || strips || tension || measured) return [several(captures?.length, 'capture'), several(count, 'strip'), pulled, ...others].filter(Boolean).join(', ');
  return capture.views ? `${capture.views} views` : capture.known?.drape_coefficient_percent ? 'drape coefficient' : 'outline from above';
}

// Known values as text, with their keys, which end in the unit.
function known(values) {
  const text = (value) => (typeof value === 'object' ? Object.entries(value).filter(([, one]) => one != null).map((one) => one.join(' ')).join(', ') : value);
  return Object.entries(values ?? {}).filter(([name, value]) => value != null && name !== 'error_percent')
    .map(([name, value]) => `${name} ${text(value)}`).join('; ');
}

// What strips under weights measure, as text.
function stretched({ measured, stretch_n_per_m: stretch, shear_n_per_m: shear }) {
  return [['bias', 'shear', shear], ['warp', 'stretch along the warp', stretch.warp], ['weft', 'stretch along the weft', stretch.weft]]
    .filter(([direction]) => measured.includes(direction)).map(([, name, value]) => {
      const { median, near } = texts(value);
      return `${name} ${median} (${near}) N/m`;
    }).join('; ');
}

// Of the air, in words.
const conditions = ({ temperature_c: warm, humidity_percent: humid, conditioning_h: hours }) => [warm && `${warm} °C`, humid && `${humid} % r.h.`,
  hours && `conditioned (h): ${hours}`].filter(Boolean).join(', ');

// Facts of an estimate beside its moduli: name and text.
export function facts(estimate) {
  const { capture, resimulation: drape, captures, strips, tension } = estimate;
  const both = (seen, made) => [seen && `${seen} captured`, made && `${made} simulated`].filter(Boolean).join(', ');
  const range = (values) => [...new Set(values.filter(Boolean))].join(', ');
  return [
    ['Tester', tester(capture.rig)],
    ['Density', `${capture.density_g_m2} g/m²`],
    ['Face on top', captures ? range(captures.map((one) => one.capture.face)) : strips || tension ? '' : capture.face],
    ['Seen', seen(estimate)],
    ['Known values', range([capture, ...(captures ?? []).map((one) => one.capture), ...(strips ?? []), ...(tension ? [tension] : []), ...(estimate.measured ?? [])].map((one) => known(one.known)))],
    ['Conditions', conditions(capture.labels ?? {})],
    ...['date', 'operator', 'laboratory', 'camera', 'remarks'].map((key) => [capital(key), capture.labels?.[key]]),
    ['Drape coefficient', captures ? range(captures.map((one) => percent(one.capture.drape_coefficient_percent)))
      : both(percent(capture.drape_coefficient_percent), percent(drape?.drape_coefficient_percent))],
    ['Stretch and shear', tension && stretched(tension)],
    ['Nodes', both(drape && String(drape.folds_captured), drape && String(drape.folds_simulated))],
  ].filter(([, text]) => text);
}
