// All fabrics: list, search, choice for a comparison.

import { ask, at, element, link, percent, save, tester, texts } from './common.js';

const COUNT = 50;
const MOST = 4; // fabrics in a comparison
const QUIET = 250; // ms without a key, after which is searched
const chosen = new Map(); // fabrics by the identity of their result
let searches = 0; // so that an older answer does not replace a newer one
let timer = 0;
let first = 0;

const words = () => at('search').value.trim();

export async function list(further = false) {
  const turn = ++searches;
  first = further ? first + COUNT : 0;
  at('error-library').textContent = '';
  const query = new URLSearchParams({ search: words(), first, count: COUNT });
  try {
    const { fabrics } = await ask(`/fabrics?${query}`);
    if (turn !== searches) return;
    const rows = fabrics.map(row);
    if (further) at('fabrics').append(...rows);
    else at('fabrics').replaceChildren(...rows);
    at('further').hidden = fabrics.length < COUNT;
    at('none').hidden = further || fabrics.length > 0;
    for (const id of ['fabrics-table', 'table']) at(id).hidden = !at('none').hidden;
    choose();
  } catch (error) {
    at('error-library').textContent = error.message;
  }
}

function row(fabric) {
  const made = element('tr');
  const { result, estimate } = fabric;
  const box = element('input');
  box.type = 'checkbox';
  box.disabled = !result;
  box.checked = chosen.has(result);
  box.dataset.result = result ?? '';
  box.setAttribute('aria-label', `compare ${fabric.name}`);
  box.addEventListener('change', () => {
    if (box.checked) chosen.set(result, fabric.name);
    else chosen.delete(result);
    choose();
  });
  const cell = (label, content) => {
    const one = element('td');
    one.dataset.label = label;
    one.append(content);
    return one;
  };
  const name = element('th');
  name.scope = 'row';
  name.append(result ? link(`#${result}`, fabric.name) : link(`#fabric=${fabric.id}`, fabric.name));
  if (fabric.notes) name.append(element('span', fabric.notes, 'wide'));
  if (fabric.apart) name.append(element('span', `not joined: ${fabric.apart}`, 'wide warnings'));
  if (estimate?.contradictions?.length) name.append(element('span', estimate.contradictions[0].text, 'wide warnings'));
  const moduli = element('div', estimate ? '' : 'no estimate', 'moduli');
  for (const [direction, { alpha_uN_m: alpha }] of Object.entries(estimate?.moduli ?? {})) {
    moduli.append(element('span', `${direction} ${texts(alpha).median}`));
  }
  made.append(cell('compare', box), name,
    cell('date', new Date(1000 * fabric.created).toLocaleDateString()), cell('captures', String(fabric.captures)),
    cell('tester', estimate ? tester(estimate.capture.rig) : ''),
    cell('density, g/m²', estimate ? String(estimate.capture.density_g_m2) : ''),
    cell('α, µN·m', moduli),
    cell('drape coefficient', percent(estimate?.capture.drape_coefficient_percent)));
  return made;
}

function choose() {
  for (const box of at('fabrics').querySelectorAll('[type=checkbox]')) {
    box.disabled = !box.dataset.result || (chosen.size >= MOST && !box.checked);
  }
  at('compare').disabled = chosen.size < 2;
  at('compare-help').textContent = chosen.size
    ? `${[...chosen.values()].join(', ')} (${chosen.size} of at most ${MOST})` : 'Choose two to four fabrics to compare.';
}

at('search').addEventListener('input', () => {
  clearTimeout(timer);
  timer = setTimeout(() => list(), QUIET);
});
at('table').addEventListener('click', () => save(`/fabrics.xlsx?${new URLSearchParams({ search: words() })}`, 'error-library'));
at('further').addEventListener('click', () => list(true));
at('compare').addEventListener('click', () => { location.hash = `compare=${[...chosen.keys()].join(',')}`; });
