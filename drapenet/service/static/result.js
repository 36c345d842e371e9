// The result of an estimate: followed until its fabric is settled, shown, exported.

import { ask, at, capital, element, facts, link, own, QUANTITIES, reveal, save, texts } from './common.js';
import { showAlike } from './alike.js';
import { addTo, ended } from './form.js';
import { showHeadline } from './headline.js';
import { plainly } from './words.js';

const POLL = 400; // ms between two looks at a running estimate
const LONGEST_WAIT = 5000; // ms between two tries where the service does not answer
const ENDED = ['done', 'failed', 'interrupted'];
const STAGES = {
  reading: 'Reading and checking the files', estimating: 'Estimating', joining: 'Joining all that is known of the fabric',
  simulating: 'Draping the estimate for the report',
};
const FILES = {
  'report.html': 'Report (HTML)', 'report.pdf': 'Report (PDF)', 'report.png': 'Report (PNG)', 'strips.png': 'Strips (PNG)',
  'estimate.json': 'Estimate (JSON)', 'drape.glb': 'Drape (GLB)', 'torque.svg': 'Torque curves (SVG)',
  'garment.png': 'Garments (PNG)', 'garment.glb': 'Garments (GLB)',
};

let following = 0; // counts the estimates that were followed, so that an older one stops
let shown = {};
let current = null; // the content that is shown
let asked = 0; // counts the cards that were asked for, so that older ones do not replace newer ones

export function stop() {
  following += 1;
}

export function follow(id) {
  reset();
  return poll(id);
}

async function poll(id) {
  const turn = ++following;
  let wait = POLL;
  while (turn === following) {
    try {
      const content = await ask(`/estimates/${encodeURIComponent(id)}`);
      at('lost').hidden = true;
      wait = POLL;
      if (turn !== following) return;
      show(id, content);
      if (isSettled(content)) return;
    } catch (error) {
      if (turn !== following) return;
      if (!error.lost) {
        at('title').textContent = 'No result';
        at('failure').textContent = error.message;
        at('progress').hidden = true;
        return;
      }
      at('lost').hidden = false;
      wait = Math.min(2 * wait, LONGEST_WAIT);
    }
    await new Promise((resolve) => setTimeout(resolve, wait));
  }
}

// Whether all captures of the fabric have ended and are joined.
function isSettled({ captures, garment }) {
  if (garment && !ENDED.includes(garment.state)) return false;
  const joint = captures.find((one) => one.members);
  const done = captures.filter((one) => !one.members && one.state === 'done').map((one) => one.id);
  return captures.every((one) => ENDED.includes(one.state))
    && (done.length < 2 || (joint && joint.members.join() === done.join()));
}

function reset() {
  shown = {};
  current = null;
  for (const id of ['fabric', 'editor', 'numbers', 'all-numbers', 'alike', 'pictures-of-it', 'preview', 'torque', 'shapes', 'downloads', 'garment', 'earlier', 'lost']) at(id).hidden = true;
  for (const id of ['failure', 'status', 'copied', 'error-export', 'error-fabric']) at(id).textContent = '';
  for (const id of ['warnings', 'cards']) at(id).replaceChildren();
  asked += 1;
  at('progress').hidden = false;
  at('title').textContent = 'Sending';
  at('title').focus({ preventScroll: true });
  reveal('result');
}

function show(id, content) {
  const before = current;
  current = content;
  showFabric(id, content);
  const finished = content.state === 'done';
  at('progress').hidden = ENDED.includes(content.state);
  at('status').textContent = finished ? '' : content.state === 'queued' ? 'Waiting; the first estimate after a start of the service takes up to a minute more …'
    : content.state === 'running' ? `${STAGES[content.stage] ?? 'Working'} …` : '';
  at('failure').textContent = plainly(content.error ?? '');
  if (before?.state !== content.state) ended(id, content);
  const warnings = content.estimate?.warnings ?? content.warnings ?? [];
  const contradictions = content.estimate?.contradictions ?? [];
  at('warnings').replaceChildren(...warnings.map(({ text }) => element('li', plainly(text, content.estimate?.capture.rig), contradictions.some((found) => found.text === text) ? 'contradiction' : '')));
  if (content.estimate) {
    showHeadline(content.estimate);
    showNumbers(content.estimate);
  }
  for (const [figure, file] of [['preview', 'preview.png'], ['torque', 'torque.svg'], ['garment', 'garment.png']]) {
    if (content.files.includes(file) && !shown[file]) {
      shown[file] = true;
      for (const image of at(figure).querySelectorAll('img')) image.src = `/estimates/${id}/${file}`;
      at(figure).querySelector('a').href = `/estimates/${id}/${file}`;
      at(figure).hidden = false;
      if (figure !== 'garment') at('pictures-of-it').hidden = false;
    }
  }
  if (finished) showGarment(content.garment);
  if (finished && shown.links !== content.files.join()) {
    shown.links = content.files.join();
    showLinks(id, content.files);
  }
  if (finished && !shown.cards) {
    shown.cards = true;
    showCards(id);
    showEarlier(id);
    showAlike(id, () => id === current?.id);
    if (content.files.includes('drape.glb')) showShapes(`/estimates/${id}/drape.glb`);
  }
}

function showFabric(id, content) {
  at('title').textContent = content.fabric_name;
  at('notes').textContent = content.notes;
  at('notes').hidden = !content.notes;
  at('remove-capture').hidden = content.captures.length < 2 || Boolean(content.members);
  showContradictions(id, content.captures);
  const list = element('ul');
  for (const one of [...content.captures].sort((a, b) => Boolean(b.members) - Boolean(a.members))) {
    const item = element('li');
    const label = link(`#${one.id}`, one.name);
    if (one.id === id) label.setAttribute('aria-current', 'page');
    item.append(label, one.state === 'done' ? '' : ` (${one.state})`);
    list.append(item);
  }
  const key = list.textContent + id;
  if (shown.captures !== key) at('captures').replaceChildren(list); // a link keeps its focus
  shown.captures = key;
  at('captures').hidden = content.captures.length < 2;
  at('fabric').hidden = false;
}

// Earlier results of this visitor that have the same pictures: such as with a height that was corrected since.
async function showEarlier(id) {
  const found = await ask(`/estimates/${encodeURIComponent(id)}/same_pictures`).catch(() => []);
  const earlier = found.filter((one) => own().includes(one.id));
  if (id !== current?.id) return;
  at('earlier').hidden = !earlier.length;
  at('earlier').replaceChildren('These pictures were estimated before, as ', ...earlier.flatMap((one, k) => [k ? ', ' : '', link(`#${one.id}`, one.fabric_name)]), '.');
}

// Those that the fabric's other estimates have found, above all the joint one.
function showContradictions(id, captures) {
  at('contradictions').replaceChildren(...captures.filter((one) => one.id !== id).flatMap((one) => (one.contradictions ?? [])
    .map(({ text }) => element('li', `${one.name}: ${plainly(text)}`, 'contradiction'))));
}

function showNumbers(estimate) {
  at('facts').replaceChildren(...facts(estimate).flatMap(([name, text]) => [element('dt', name), element('dd', text)]));
  at('heads').replaceChildren(element('th'), ...QUANTITIES.map(([, , name, unit]) => {
    const head = element('th', name);
    head.scope = 'col';
    head.append(element('br'), element('span', unit, 'unit'));
    return head;
  }));
  at('rows').replaceChildren(...Object.keys(estimate.moduli).map((direction) => {
    const row = element('tr');
    const head = element('th', direction);
    head.scope = 'row';
    row.append(head);
    for (const [part, quantity, name, unit] of QUANTITIES) {
      const cell = element('td');
      cell.dataset.label = `${name}, ${unit}`;
      const value = estimate[part][direction][quantity];
      if (value) {
        const { median, near, wide } = texts(value);
        cell.append(element('b', median), element('span', near, 'near'), element('span', wide, 'wide'));
      } else cell.append(element('span', 'not determined', 'wide'));
      row.append(cell);
    }
    return row;
  }));
  const poor = [...estimate.mostly_usual ?? [], ...estimate.assumed ?? []].map(({ text }) => `${capital(text)}. `).join('')
    .replaceAll('beta', 'β').replaceAll('alpha', 'α');
  const next = (estimate.next_measurements ?? []).map((one) => `${one.measurement}: α ${one.alpha_narrower_percent.toFixed()} %, β ${one.beta_narrower_percent.toFixed()} % (${one.minutes} min)`);
  at('poor').textContent = poor + (estimate.advice ?? []).map(({ text }) => `Advice: ${text}. `).join('')
    + (next.length ? `Measured next, intervals would become narrower by ${next.join('; ')}. ` : '')
    + (estimate.kes_note ? `${estimate.kes_note}.` : '');
  const { views, rig } = estimate.capture;
  at('as-read').textContent = views || !rig || estimate.captures ? '' : 'Green: the outline. Yellow: the plate. Blue, dotted: the reach of the flat specimen. Red: the warp.';
  at('all-numbers').hidden = false;
}

function showLinks(id, files) {
  at('links').replaceChildren(...Object.entries(FILES).filter(([file]) => files.includes(file)).map(([file, text]) => {
    const made = link(`/estimates/${id}/${file}`, text);
    if (file !== 'report.html') made.download = file;
    return made;
  }));
  at('downloads').hidden = false;
}

// The preview that was asked for, if any.
function showGarment(garment) {
  const running = garment && !ENDED.includes(garment.state);
  const { made, expected } = garment?.progress ?? { made: 0 };
  at('make-garment').disabled = running;
  at('make-garment').hidden = garment?.state === 'done';
  at('garment-status').textContent = !running ? '' : made ? `${made} of ${expected} skirts` : 'The first skirt is draped …';
  at('error-garment').textContent = garment?.error ?? '';
}

// A card for each tool: what to type into which field, and what is not known of it.
async function showCards(id) {
  const turn = ++asked;
  try {
    const { cards, in_folds: folds, drapenet: { directions, modulus_at_curvature_1_m: bend } } = await ask(`/estimates/${id}/export/fields?${new URLSearchParams(curvature())}`);
    if (turn !== asked) return;
    const open = [...at('cards').querySelectorAll('[open] summary')].map((summary) => summary.textContent);
    at('cards').replaceChildren(element('p', `Stiffnesses at a curvature of ${bend} 1/m. ${folds}`, 'help'), ...cards.map((card) => {
      const made = element('details');
      made.open = open.includes(card.tool);
      made.append(element('summary', card.tool), element('p', card.where, 'help'));
      const table = element('table');
      for (const { field, value, unit = '', note } of card.fields) {
        const row = element('tr');
        const cell = element('td');
        cell.append(element('b', value ?? 'not known'), ` ${value == null ? '' : unit}`);
        if (note) cell.append(element('span', note, 'wide'));
        const head = element('th', field);
        head.scope = 'row';
        row.append(head, cell);
        table.append(row);
      }
      if (directions !== 'warp/weft') made.append(element('p', 'The capture does not mark the warp: warp stands for the stiffer yarns, weft for the softer.', 'warnings'));
      made.append(table, element('p', card.unknown, 'warnings'), element('p', `Source: ${card.source}`, 'help'));
      return made;
    }));
  } catch (error) {
    if (turn === asked) at('cards').replaceChildren(element('p', error.message, 'error'));
  }
}

async function showShapes(address) {
  for (const id of ['shapes', 'pictures-of-it']) at(id).hidden = false;
  try {
    const { view } = await import('./viewer.js');
    const captured = await view([address], at('canvas'), at('overlay'));
    for (const part of at('shapes').querySelectorAll('.captured')) part.hidden = !captured;
  } catch {
    at('help-canvas').textContent = 'This browser cannot draw in 3-D (WebGL); download the GLB file instead.';
  }
}

const number = (id) => at(id).value.trim().replace(',', '.');
const curvature = () => ({ curvature_1_m: number('curvature') || '0' });

// Save files that are made with the settings for other tools.
function saveMade(file) {
  const query = new URLSearchParams({ mesh: at('mesh').value, edge_mm: number('edge'), ...curvature() });
  save(`/estimates/${current.id}/${file}?${query}`, 'error-export');
}

// ---- the fabric

function edit(open) {
  at('editor').hidden = !open;
  at('edit').setAttribute('aria-expanded', String(open));
  if (!open) return;
  at('editor').elements.name.value = current.fabric_name;
  at('editor').elements.notes.value = current.notes;
  at('editor').elements.name.focus();
}

async function change(address, options, then) {
  at('error-fabric').textContent = '';
  try {
    await ask(address, options);
    then();
  } catch (error) {
    at('error-fabric').textContent = error.message;
  }
}

at('edit').addEventListener('click', () => edit(at('editor').hidden));
at('editor').addEventListener('submit', (event) => {
  event.preventDefault();
  const { name, notes } = at('editor').elements;
  change(`/fabrics/${current.fabric}`, {
    method: 'PATCH', headers: { 'content-type': 'application/json' },
    body: JSON.stringify({ name: name.value.trim() || 'unnamed', notes: notes.value.trim() }),
  }, () => {
    edit(false);
    at('edit').focus();
    follow(location.hash.slice(1));
  });
});
at('more').addEventListener('click', () => {
  const first = current.estimate?.captures?.[0] ?? current.estimate ?? null;
  addTo(current.fabric, current.fabric_name, first?.capture);
});
at('remove-capture').addEventListener('click', () => {
  const other = current.captures.find((one) => one.id !== current.id && !one.members);
  if (!confirm(`Remove ${current.name} of ${current.fabric_name} and its files?`)) return;
  change(`/estimates/${current.id}`, { method: 'DELETE' }, () => { location.hash = other.id; });
});
at('remove-fabric').addEventListener('click', () => {
  if (!confirm(`Remove ${current.fabric_name}, its captures and files?`)) return;
  change(`/fabrics/${current.fabric}`, { method: 'DELETE' }, () => {
    addTo(null);
    location.hash = 'fabrics';
  });
});
at('copy').addEventListener('click', async () => {
  try {
    await navigator.clipboard.writeText(location.href);
    at('copied').textContent = 'copied';
  } catch {
    at('copied').textContent = location.href;
  }
});
// A laboratory that reads all numbers each time opens them once.
const FOLDS = 'drapenet.folds';
for (const fold of document.querySelectorAll('[data-fold]')) {
  fold.open = (localStorage.getItem(FOLDS) ?? '').split(',').includes(fold.dataset.fold);
  fold.addEventListener('toggle', () => localStorage.setItem(FOLDS, [...document.querySelectorAll('[data-fold][open]')].map((one) => one.dataset.fold).join()));
}
for (const button of document.querySelectorAll('[data-export]')) {
  button.addEventListener('click', () => saveMade(`export/${button.dataset.export}`));
}
at('make-garment').addEventListener('click', async () => {
  at('make-garment').disabled = true;
  try {
    await ask(`/estimates/${current.id}/garment`, { method: 'POST' });
    poll(current.id);
  } catch (error) {
    at('make-garment').disabled = false;
    at('error-garment').textContent = error.message;
  }
});
at('all-files').addEventListener('click', () => saveMade('files.zip'));
at('curvature').addEventListener('change', () => showCards(current.id));
