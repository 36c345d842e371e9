// Sentences of the service as the page says them: fields by their labels, pictures by their numbers. Terminal, Python and
// HTTP interface name fields by the keys of files.

import { tester } from './common.js';
import { form, isDescribed } from './fields.js';
import { labelsOf } from './labels.js';
import { testerName } from './support.js';

let table = null; // of labels, for sentences that are shown together

function labels() {
  if (!table) queueMicrotask(() => { table = null; }); // fields and their labels change
  table ??= labelsOf(form);
  return table;
}

// Sentences whose remedy the page has in another form than files.
const SAID = [[/the scale is not known: .*/, 'the scale is not known: lay the printed mat under the stand, or drag the dashed circle to the edge of the plate’s top, and state how far above it the camera was']];

// Sizes that an answer to the first question fills in, which nobody has typed, are doubted first.
function doubted(sentence, rig) {
  const name = rig.replace(/_rim.*/, '');
  const card = name && form.querySelector(`[name=support][value="${name}"]`);
  return card ? sentence.replace(/the scale first(.*), then the tester/, `first that the specimen is a ${tester(name)}, the sizes that “${card.closest('label').textContent.trim()}” fills in, then the scale$1`) : sentence;
}

// What is said of a file, and of what files state, keeps its keys.
function withLabels(sentence, rig) {
  const said = sentence.replace(/; (known has values|outline is) such as .*/, '').replace(/^(outline|known) (has )?/, '').replaceAll(/, such as \{[^}]*\}/g, '').replace(/^(tension|strips)\.(\d+)(?= has )/, (all, list, k) => `strip ${Number(k) + 1}`);
  if (/\.yaml\b/.test(said) || isDescribed()) return sentence;
  const other = SAID.find(([from]) => from.test(said));
  if (other) return said.replace(...other);
  const found = labels();
  const keys = Object.keys(found).sort((one, other) => other.length - one.length).join('|').replaceAll('.', '\\.');
  return doubted(said, rig).replaceAll(new RegExp(`(?<![\\w.])(?:outline\\.|known\\.)?(${keys})(?!\\w|\\.\\w)=?`, 'g'), (all, key) => `“${found[key]}”${all.endsWith('=') ? ' = ' : ''}`);
}

// Without the names that pictures have at the service, which nobody gave them. `rig`: the tester's name.
export const plainly = (sentence, rig = testerName()) => withLabels(sentence.replaceAll(/, outline_\d\.[a-z]+,/g, ',').replaceAll(/\boutline_(\d)\.[a-z]+/g, 'picture $1')
  .replaceAll(/\boutline\.(jpe?g|png|hei[cf]|webp|avif|tiff?)\b/g, 'the picture').replaceAll('outline.mat', 'the mat'), rig);
