// Up to four fabrics side by side: a table, their torque curves, drapes that turn together.

import { ask, at, element, facts, link, QUANTITIES, texts } from './common.js';

const COLOURS = ['var(--first)', 'var(--second)', 'var(--third)', 'var(--fourth)'];
const DASHES = ['', '7 3', '2 3', '9 3 2 3'];
const [WIDTH, HEIGHT, LEFT, BOTTOM] = [300, 210, 34, 24];

export async function compare(ids) {
  at('error-comparison').textContent = '';
  for (const id of ['compared', 'quantities', 'curves', 'tiles']) at(id).replaceChildren();
  try {
    const all = await Promise.all(ids.slice(0, 4).map((id) => ask(`/estimates/${encodeURIComponent(id)}`)));
    const whole = all.filter((one) => one.estimate && one.curves);
    if (whole.length < all.length) at('error-comparison').textContent = 'An estimate is not finished, or failed.';
    showTable(whole);
    showCurves(whole);
    await showDrapes(whole);
  } catch (error) {
    at('error-comparison').textContent = error.message;
  }
  at('comparison').dataset.shown = ids.join(',');
}

function showTable(all) {
  at('comparison').style.setProperty('--count', all.length);
  at('compared').replaceChildren(element('td'), ...all.map((one, k) => {
    const head = element('th');
    head.scope = 'col';
    const mark = element('span', '', 'mark');
    mark.style.background = COLOURS[k];
    head.append(mark, link(`#${one.id}`, one.fabric_name));
    return head;
  }));
  const line = (name, cells) => {
    const row = element('tr');
    const head = element('th', name);
    head.scope = 'row';
    row.append(head, ...cells);
    return row;
  };
  const known = all.map((one) => new Map(facts(one.estimate)));
  const names = [...new Set(known.flatMap((one) => [...one.keys()]))];
  const rows = names.map((name) => line(name, known.map((one) => element('td', one.get(name) ?? ''))));
  for (const [part, quantity, name, unit] of QUANTITIES) {
    for (let k = 0; k < 3; k += 1) {
      rows.push(line(`${name} ${direction(all, k)}, ${unit}`, all.map((one) => {
        const value = Object.values(one.estimate[part])[k][quantity];
        const cell = element('td', value ? '' : 'not determined');
        if (value) cell.append(element('b', texts(value).median), element('span', texts(value).near, 'near'));
        return cell;
      })));
    }
  }
  at('quantities').replaceChildren(...rows);
}

const direction = (all, k) => [...new Set(all.map((one) => Object.keys(one.estimate.moduli)[k]))].join(' or ');

function drawn(kind, attributes, text = '') {
  const made = document.createElementNS('http://www.w3.org/2000/svg', kind);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.textContent = text;
  return made;
}

function showCurves(all) {
  const bands = all.map((one) => Object.entries(one.curves).filter(([key]) => key !== 'curvature_1_m').map(([, band]) => band));
  const highest = Math.max(...bands.flat().flatMap((band) => band.interval_68[1]));
  const [x, last] = [all[0].curves.curvature_1_m, all[0].curves.curvature_1_m.at(-1)];
  const step = 10 ** Math.floor(Math.log10(highest));
  const top = Math.ceil(highest / step) * step;
  const place = (curvature, torque) => `${(LEFT + (curvature / last) * (WIDTH - LEFT - 6)).toFixed(1)},`
    + `${(HEIGHT - BOTTOM - (torque / top) * (HEIGHT - BOTTOM - 16)).toFixed(1)}`;
  at('curves').replaceChildren(...[0, 1, 2].map((k) => {
    const name = direction(all, k);
    const diagram = drawn('svg', { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: 'img', 'aria-label': `torque of ${name} over curvature` });
    diagram.append(drawn('text', { x: LEFT, y: 11, class: 'name' }, name));
    for (const [at0, label] of [[0, '0'], [last / 2, String(last / 2)], [last, String(last)]]) {
      const [px] = place(at0, 0).split(',');
      diagram.append(drawn('text', { x: px, y: HEIGHT - 8, 'text-anchor': at0 === last ? 'end' : 'middle' }, label));
    }
    for (const torque of [0, top / 2, top]) {
      const [, py] = place(0, torque).split(',');
      diagram.append(drawn('line', { x1: LEFT, x2: WIDTH - 6, y1: py, y2: py, class: 'grid' }),
        drawn('text', { x: LEFT - 4, y: Number(py) + 4, 'text-anchor': 'end' }, String(Number(torque.toPrecision(3)))));
    }
    bands.forEach((band, j) => {
      const { median, interval_68: [low, high] } = band[k];
      const edge = [...x.map((at0, i) => place(at0, high[i])), ...x.map((at0, i) => place(at0, low[i])).reverse()];
      diagram.append(drawn('polygon', { points: edge.join(' '), fill: COLOURS[j], opacity: 0.13 }),
        drawn('polyline', { points: x.map((at0, i) => place(at0, median[i])).join(' '), fill: 'none', stroke: COLOURS[j], 'stroke-width': 2, 'stroke-dasharray': DASHES[j] }));
    });
    return diagram;
  }));
}

// A joint estimate has no drape: that of its latest capture is shown. Strips and values have none.
async function showDrapes(all) {
  const draped = all.map((one) => [one, one.captures.filter((part) => part.rig && (one.members ?? [one.id]).includes(part.id)).at(-1)])
    .filter(([, part]) => part);
  const parts = draped.map(([, part]) => part);
  if (!parts.length) {
    at('help-drapes').textContent = 'No drape was seen of these fabrics.';
    return;
  }
  const columns = parts.length > 2 && at('drapes').clientWidth < 600 ? 2 : parts.length;
  at('tiles').style.gridTemplateColumns = `repeat(${columns}, 1fr)`;
  at('tiles').replaceChildren(...draped.map(([one, part]) => {
    const label = element('span', one.members ? `${one.fabric_name}: ${part.name}` : one.fabric_name);
    label.style.color = COLOURS[all.indexOf(one)];
    return label;
  }));
  try {
    const { view } = await import('./viewer.js');
    await view(parts.map((part) => `/estimates/${part.id}/drape.glb`), at('drapes'), null, columns);
  } catch {
    at('help-drapes').textContent = 'This browser cannot draw in 3-D (WebGL), or a drape is missing.';
  }
}
