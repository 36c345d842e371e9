// The page: which of its parts the address names.

import { ask, at, reveal } from './common.js';
import './form.js';
import { compare } from './compare.js';
import { list } from './library.js';
import { follow, stop } from './result.js';

const SECTIONS = ['result', 'library', 'comparison'];

function open(section, title) {
  for (const id of SECTIONS) at(id).hidden = id !== section;
  if (!title) return;
  at(title).focus({ preventScroll: true });
  reveal(section);
}

async function route(arrived = true) {
  const [name, value] = decodeURIComponent(location.hash.slice(1)).split('=');
  stop();
  if (name === 'compare' && value) {
    open('comparison', 'comparison-title');
    await compare(value.split(','));
  } else if (name === 'fabric' && value) {
    const { estimates } = await ask(`/fabrics/${encodeURIComponent(value)}`).catch(() => ({ estimates: [] }));
    location.replace(estimates.length ? `#${estimates.at(-1).id}` : '#fabrics');
  } else if (name && name !== 'fabrics') {
    open('result');
    await follow(name);
  } else {
    open('library', arrived && 'library-title');
    await list();
  }
}

addEventListener('hashchange', () => route());
route(Boolean(location.hash));
