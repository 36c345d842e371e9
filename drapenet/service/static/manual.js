// The manual: beside each key of files where it comes first, what the page calls it.

import { labelsOf } from './labels.js';

const answer = await fetch('/');
const found = labelsOf(new DOMParser().parseFromString(await answer.text(), 'text/html').getElementById('form'));
for (const code of document.querySelectorAll(':not(pre, h1, h2, h3, h4, a) > code')) {
  const [, key] = /^(?:outline\.|known\.)?([\w.]+)/.exec(code.textContent) ?? [];
  if (!found[key]) continue;
  code.insertAdjacentHTML('afterend', ' <span class="note"></span>');
  code.nextElementSibling.textContent = `(on the page: “${found[key]}”)`;
  delete found[key];
}
