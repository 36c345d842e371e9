// Other fabrics that are like a result, and typical published ones.

import { ask, at, element, link } from './common.js';

function row(id, { fabric, place, source, alike, differences }) {
  const name = element('th');
  name.scope = 'row';
  name.append(place ? link(`#${place}`, fabric) : fabric);
  if (source) name.append(element('span', `published KES B, as transcribed: ${source}`, 'wide'));
  const [probability, apart] = [element('td', alike), element('td', differences.replaceAll('-', '−'))];
  if (place) probability.append(' ', link(`#compare=${id},${place}`, 'compare'));
  [probability.dataset.label, apart.dataset.label] = ['alike', 'differs by'];
  const made = element('tr');
  made.append(name, probability, apart);
  return made;
}

// Compared once unfolded, which takes the service a second; unless another result is on the page by then, or it cannot say.
export function showAlike(id, isShown) {
  at('alike').hidden = false;
  at('alike-first').textContent = 'Like this one';
  at('alike-rows').replaceChildren();
  at('alike').ontoggle = () => at('alike').open && !at('alike-rows').hasChildNodes() && compareWithOthers(id, isShown);
  at('alike').ontoggle();
}

async function compareWithOthers(id, isShown) {
  const found = await ask(`/estimates/${encodeURIComponent(id)}/alike`).catch(() => []);
  if (!isShown()) return;
  const [first] = found;
  const near = !(first?.probability >= 0.5) ? 'none that could stand in for it' : first.alike === 'not known' ? 'not known well enough' : `${first.fabric}, ${first.alike}`;
  at('alike-first').textContent = `Like this one: ${near}`;
  at('alike-rows').replaceChildren(...found.map((one) => row(id, one)));
  at('alike').hidden = !found.length;
}
