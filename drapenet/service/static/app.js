// The page: sends a capture, follows its estimate, shows it. What comes from the service is put into
// the page as text only.

const POLL = 400; // ms between two looks at a running estimate
const LONGEST_WAIT = 5000; // ms between two tries where the service does not answer
const ENDED = ['done', 'failed', 'interrupted'];
const STAGES = {
  reading: 'Reading and checking the capture', estimating: 'Estimating',
  refining: 'The simulator refines the estimate', simulating: 'Draping the estimate for the report',
};
const QUANTITIES = [
  ['moduli', 'alpha_uN_m'], ['moduli', 'beta_nN_m2'],
  ['laboratory', 'bending_length_mm'], ['laboratory', 'flexural_rigidity_uN_m'],
];
const FILES = {
  'report.html': 'Report (HTML)', 'report.png': 'Report (PNG)', 'estimate.json': 'Estimate (JSON)',
  'drape.glb': 'Drape (GLB)', 'torque.svg': 'Torque curves (SVG)',
};

const at = (id) => document.getElementById(id);
const limits = document.body.dataset;
let following = 0; // counts the estimates that were followed, so that an older one stops
let shown = {};

// ---- what is sent

const suffix = (name) => name.slice(name.lastIndexOf('.')).toLowerCase().replace('.yml', '.yaml');
const chosen = () => [...at('files').files];
const isDescribed = () => chosen().some((file) => ['.zip', '.yaml'].includes(suffix(file.name)) || file.name === 'density.txt');

function check() {
  at('error-files').textContent = '';
  if (chosen().length && !isDescribed()) at('camera').open = true;
}

function complain(id, sentence, field) {
  at(id).textContent = sentence;
  if (field) {
    field.setAttribute('aria-invalid', 'true');
    field.focus();
  }
}

function clear() {
  for (const id of ['error-files', 'error-density', 'error-tester', 'error']) at(id).textContent = '';
  for (const field of at('form').querySelectorAll('[aria-invalid]')) field.removeAttribute('aria-invalid');
}

function isComplete() {
  const files = chosen();
  if (!files.length) {
    complain('error-files', 'No files yet: drop the views of a drape, or its photograph, here, or choose them.', at('files'));
    return false;
  }
  const wrong = files.find((file) => !limits.kinds.split(',').includes(suffix(file.name)));
  if (wrong) {
    complain('error-files', `${wrong.name}: files of this kind are not taken.`, at('files'));
    return false;
  }
  const bytes = files.reduce((sum, file) => sum + file.size, 0);
  if (bytes > Number(limits.bytes) || files.length > Number(limits.files)) {
    complain('error-files', `${files.length} files with ${(bytes / 1e6).toFixed(0)} MB; at most `
      + `${limits.files} files with ${(limits.bytes / 1e6).toFixed(0)} MB.`, at('files'));
    return false;
  }
  const density = at('density').value.trim().replace(',', '.');
  if ((density === '' && !isDescribed()) || Number.isNaN(Number(density))) {
    complain('error-density', 'Weigh the specimen and give its density in g/m², such as 210.', at('density'));
    return false;
  }
  if (at('tester').value === '' && !isDescribed() && !isScan()) {
    at('camera').open = true;
    complain('error-tester', 'Choose the tester: the specimen and the plate under it.', at('tester'));
    return false;
  }
  if (isOtherSize() && [at('size'), at('plate')].some((field) => !(number(field) > 0))) {
    complain('error-tester', 'Give the diameter or side of the specimen and the diameter of the plate in mm.', at('size'));
    return false;
  }
  return true;
}

const isScan = () => chosen().length === 1 && !/^view_\d/.test(chosen()[0].name)
  && ['.npz', '.obj', '.ply'].includes(suffix(chosen()[0].name));
const number = (field) => Number(field.value.trim().replace(',', '.'));
const isOtherSize = () => at('tester').value.includes('_') && !/\d/.test(at('tester').value);

// The name of the chosen tester, such as disc254_support127; empty where capture.yaml states it.
function tester() {
  const [specimen, holder] = at('tester').value.split('_');
  return isOtherSize() ? `${specimen}${number(at('size'))}_${holder}${number(at('plate'))}` : at('tester').value;
}

async function send() {
  clear();
  if (!isComplete()) return;
  const form = new FormData();
  for (const file of chosen()) form.append('files', file, file.name);
  for (const field of at('form').querySelectorAll('input[name]:not([type=file]), select[name]')) {
    if (field.value.trim()) form.append(field.name, field.value.trim());
  }
  if (tester()) form.append('tester', tester());
  form.append('refine', at('refine').checked ? 'yes' : 'no');
  at('submit').disabled = true;
  try {
    const answer = await fetch('/estimates', { method: 'POST', body: form });
    const content = await answer.json();
    if (!answer.ok) complain('error', content.error ?? `The service answers ${answer.status}.`);
    else location.hash = content.id;
  } catch {
    complain('error', 'The service cannot be reached. Your files are still chosen: press Estimate again.');
  } finally {
    at('submit').disabled = false;
  }
}

async function tryExample(name) {
  clear();
  try {
    const answer = await fetch(`/examples/${name}.zip`);
    const transfer = new DataTransfer();
    transfer.items.add(new File([await answer.blob()], `${name}.zip`));
    at('files').files = transfer.files;
    await send();
  } catch {
    complain('error', 'The service cannot be reached; try again.');
  }
}

// ---- what comes back

async function follow(id) {
  const turn = ++following;
  reset();
  let wait = POLL;
  while (turn === following) {
    try {
      const answer = await fetch(`/estimates/${encodeURIComponent(id)}`);
      const content = await answer.json();
      at('lost').hidden = true;
      wait = POLL;
      if (turn !== following) return;
      if (!answer.ok) {
        at('title').textContent = 'No result';
        at('failure').textContent = content.error ?? `The service answers ${answer.status}.`;
        at('progress').hidden = true;
        return;
      }
      show(id, content);
      if (ENDED.includes(content.state)) return;
    } catch {
      at('lost').hidden = false;
      wait = Math.min(2 * wait, LONGEST_WAIT);
    }
    await new Promise((resolve) => setTimeout(resolve, wait));
  }
}

function reset() {
  shown = {};
  for (const id of ['numbers', 'preview', 'torque', 'shapes', 'downloads', 'lost']) at(id).hidden = true;
  for (const id of ['failure', 'status', 'copied', 'error-export']) at(id).textContent = '';
  at('warnings').replaceChildren();
  at('progress').hidden = false;
  at('progress').removeAttribute('value');
  at('result').hidden = false;
  at('title').textContent = 'Sending';
  at('title').focus({ preventScroll: true });
  if (at('result').getBoundingClientRect().top > innerHeight - 100) at('result').scrollIntoView();
}

function show(id, content) {
  at('title').textContent = content.name;
  const finished = content.state === 'done';
  at('progress').hidden = ENDED.includes(content.state);
  at('status').textContent = finished ? '' : content.state === 'queued' ? 'Waiting for a free worker'
    : content.state === 'running' ? stage(content) : '';
  at('failure').textContent = content.error ?? '';
  const warnings = content.estimate?.warnings ?? content.warnings ?? [];
  at('warnings').replaceChildren(...warnings.map((line) => element('li', line)));
  if (content.estimate) showNumbers(content.estimate);
  for (const [figure, file] of [['preview', 'preview.png'], ['torque', 'torque.svg']]) {
    if (content.files.includes(file) && !shown[file]) {
      shown[file] = true;
      at(figure).querySelector('img').src = `/estimates/${id}/${file}`;
      at(figure).hidden = false;
    }
  }
  if (finished) {
    showLinks(id, content.files);
    if (content.files.includes('drape.glb')) showShapes(`/estimates/${id}/drape.glb`);
  }
}

function stage(content) {
  const progress = content.progress;
  if (!progress) {
    at('progress').removeAttribute('value');
    return `${STAGES[content.stage] ?? 'Working'} …`;
  }
  at('progress').max = progress.expected;
  at('progress').value = progress.made;
  return `${STAGES[content.stage]}: ${progress.made} of about ${progress.expected} drapes`;
}

function element(kind, text, name = '') {
  const made = document.createElement(kind);
  made.textContent = text;
  made.className = name;
  return made;
}

function showNumbers(estimate) {
  at('rows').replaceChildren(...Object.keys(estimate.moduli).map((direction) => {
    const row = document.createElement('tr');
    row.append(element('th', direction));
    for (const [part, quantity] of QUANTITIES) {
      const cell = document.createElement('td');
      const value = estimate[part][direction][quantity];
      if (value) {
        const digits = places(value.interval_68);
        const range = (interval) => interval.map((end) => end.toFixed(digits)).join(' to ');
        cell.append(element('b', value.median.toFixed(digits)), element('span', range(value.interval_68), 'near'),
          element('span', range(value.interval_90), 'wide'));
      }
      row.append(cell);
    }
    return row;
  }));
  const { capture: { drape_coefficient_percent: coefficient, views }, resimulation } = estimate;
  const simulated = resimulation ? `, ${resimulation.drape_coefficient_percent.toFixed(1)} % simulated with the estimate` : '';
  const corrected = resimulation && !views ? ', without perspective' : '';
  at('coefficient').textContent = coefficient
    ? `Drape coefficient ${coefficient.toFixed(1)} % as captured${corrected}${simulated}.` : '';
  at('poor').textContent = estimate.poorly_constrained.length
    ? `Poorly constrained by this drape: ${estimate.poorly_constrained.join(', ')}.` : '';
  at('numbers').hidden = false;
}

// As many digits as the interval's width deserves.
function places([low, high]) {
  const half = (high - low) / 2;
  return half > 0 ? Math.min(Math.max(1 - Math.floor(Math.log10(half)), 0), 6) : 0;
}

function showLinks(id, files) {
  at('links').replaceChildren(...Object.entries(FILES).filter(([file]) => files.includes(file)).map(([file, text]) => {
    const link = element('a', text);
    link.href = `/estimates/${id}/${file}`;
    if (file !== 'report.html') link.download = file;
    return link;
  }));
  at('downloads').hidden = false;
}

async function showShapes(address) {
  at('shapes').hidden = false;
  try {
    const { view } = await import('./viewer.js');
    const captured = await view(address, at('canvas'), at('overlay'));
    for (const part of at('shapes').querySelectorAll('.captured')) part.hidden = !captured;
  } catch {
    at('help-canvas').textContent = 'This browser cannot draw in 3-D (WebGL); download the GLB file instead.';
  }
}

async function fetchExport(name) {
  at('error-export').textContent = '';
  const id = location.hash.slice(1);
  const edge = at('edge').value.trim().replace(',', '.');
  const query = new URLSearchParams({ mesh: at('mesh').value, edge_mm: edge });
  try {
    const answer = await fetch(`/estimates/${id}/export/${name}?${query}`);
    if (!answer.ok) {
      const { error } = await answer.json();
      at('error-export').textContent = error ?? `The service answers ${answer.status}.`;
      return;
    }
    const named = /filename="([^"]*)"/.exec(answer.headers.get('content-disposition') ?? '');
    const link = document.createElement('a');
    link.href = URL.createObjectURL(await answer.blob());
    link.download = named ? named[1] : name;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  } catch {
    at('error-export').textContent = 'The service cannot be reached; try again.';
  }
}

// ---- events

at('files').addEventListener('change', check);
at('tester').addEventListener('change', () => {
  for (const label of document.querySelectorAll('.sizes')) label.hidden = !isOtherSize();
});
for (const kind of ['dragover', 'dragenter']) {
  document.addEventListener(kind, (event) => {
    event.preventDefault();
    at('drop').classList.add('over');
  });
}
document.addEventListener('dragleave', (event) => event.relatedTarget ?? at('drop').classList.remove('over'));
document.addEventListener('drop', (event) => {
  event.preventDefault();
  at('drop').classList.remove('over');
  at('files').files = event.dataTransfer.files;
  check();
});
at('form').addEventListener('submit', (event) => {
  event.preventDefault();
  send();
});
for (const button of document.querySelectorAll('[data-example]')) {
  button.addEventListener('click', () => tryExample(button.dataset.example));
}
at('copy').addEventListener('click', async () => {
  try {
    await navigator.clipboard.writeText(location.href);
    at('copied').textContent = 'copied';
  } catch {
    at('copied').textContent = location.href;
  }
});
for (const button of document.querySelectorAll('[data-export]')) {
  button.addEventListener('click', () => fetchExport(button.dataset.export));
}
addEventListener('hashchange', () => location.hash.length > 1 && follow(location.hash.slice(1)));
if (location.hash.length > 1) follow(location.hash.slice(1));
