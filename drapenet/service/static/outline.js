// The photograph as it is read, before the estimate, with the outline and the circle of the plate.
// Moving the circle fills the plate's fields of the form, which then ask for another reading.

import { ask, at, element } from './common.js';
import { isOverMat } from './fields.js';
import { testerName, topOf } from './support.js';
import { plainly } from './words.js';

const DELAY = 400; // ms after the last change
const KNOB = 0.025; // radius, of the picture's width
const GUESS = 0.45; // diameter, of the smaller side, until the plate is known
const LEAST = 20; // pixels, diameter
const LABEL = 0.16; // of its width, half of an arrow's label
const MARGIN = 0.03; // of the picture's width, of an arrow from its border, and half the size of the arrow's head
const STEPS = { ArrowLeft: [-1, 0, 0], ArrowRight: [1, 0, 0], ArrowUp: [0, -1, 0], ArrowDown: [0, 1, 0],
  '+': [0, 0, 2], '=': [0, 0, 2], '*': [0, 0, 2], '-': [0, 0, -2], _: [0, 0, -2] };
const svg = at('seen-picture');
const [image, specimen, warp, hem, unclear, plate, way] = svg.children;
const [rim, knob] = plate.children;
const [arrow, foot, label] = way.children;
const form = at('form');
let timer = null;
let next = null; // makes the content of the form, to be read
let reading = false;
let fresh = false; // whether the photograph was not shown yet
let seen = null; // the last answer with a picture
let unread = new Image();
let circle = null; // of the plate, pixels of the picture

// ---- reading

// Reads the photograph of the content that a function makes of a form, after a delay; null shows none. A new photograph,
// without delay, is brought into view.
export function look(content, delay = DELAY) {
  clearTimeout(timer);
  next = content;
  fresh ||= !delay;
  if (content && !delay) { // another picture: what was said of the last one is not of it
    at('seen-refusal').textContent = '';
    at('seen-warnings').replaceChildren();
    svg.toggleAttribute('hidden', true);
    at('seen').hidden = false;
    at('seen-status').textContent = 'Reading the photograph …';
  }
  if (content) timer = setTimeout(read, delay);
  else show(null);
}

// A picture that is not read yet; what the browser cannot show, such as HEIC, has its name only.
export async function preview(file, delay = DELAY) {
  look(null);
  URL.revokeObjectURL(unread.src);
  unread = new Image();
  unread.src = URL.createObjectURL(file);
  const { src } = unread;
  const can = await unread.decode().then(() => true, () => false);
  if (next || src !== unread.src) return; // it is read meanwhile, or another is shown
  show(can ? { picture: src, width: unread.naturalWidth, height: unread.naturalHeight, movable: false, centred: true } : {});
  if (!can) at('seen-status').textContent = 'This browser cannot show the picture; it is sent as it is.';
  if (!delay) at('seen').scrollIntoView();
}

// One at a time; what has changed meanwhile is read next, in place of what is then no longer asked.
async function read() {
  if (reading || !next) return;
  reading = true;
  at('seen').hidden = false;
  at('seen-status').textContent = 'Reading the photograph …';
  while (next) {
    const content = next;
    const found = await ask('/outline', { method: 'POST', body: await content() }).catch(({ message }) => ({ refusal: message }));
    if (content === next) {
      next = null;
      show(found);
      if (fresh) (seen ? svg : at('seen')).scrollIntoView({ block: 'nearest' });
      fresh = false;
    }
  }
  reading = false;
}

function show(found) {
  at('seen').hidden = !found;
  if (!found?.picture) {
    seen = null;
    svg.toggleAttribute('hidden', true);
  } else {
    seen = found;
    svg.setAttribute('viewBox', `-.5 -.5 ${found.width} ${found.height}`);
    for (const [key, value] of Object.entries({ width: found.width, height: found.height, href: found.picture })) image.setAttribute(key, value);
    for (const [line, points] of [[hem, found.outline], [specimen, found.specimen], [warp, found.warp]]) {
      line.setAttribute('points', (points ?? []).join(' '));
    }
    circle = found.plate ?? { x: (found.width - 1) / 2, y: (found.height - 1) / 2, diameter: GUESS * Math.min(found.width, found.height) };
    plate.toggleAttribute('hidden', !found.plate && !found.movable);
    plate.classList.toggle('movable', found.movable);
    plate.classList.toggle('guessed', !found.centred);
    unclear.setAttribute('d', (found.unclear ?? []).map((part) => `M${part.join('L')}`).join(''));
    svg.toggleAttribute('hidden', false);
    draw();
    drawWay();
  }
  at('seen-help').hidden = !seen;
  at('seen-move').hidden = !seen?.movable;
  at('seen-refusal').textContent = plainly(found?.refusal ?? '');
  at('seen').dispatchEvent(new CustomEvent('read', { detail: found }));
  at('seen-status').textContent = seen?.outline ? `Outline found: ${seen.nodes} node${seen.nodes === 1 ? '' : 's'}, drape coefficient ${seen.drape_coefficient_percent.toFixed(1)} % as the camera sees it.${seen.warnings.length ? '' : ' Nothing in it is doubtful.'}${unsure()}` : '';
  at('seen-warnings').replaceChildren(...(found?.warnings ?? []).map(({ text }) => {
    const [fact, ...remedy] = plainly(text).split(/(?<=: )/);
    const item = element('li', '');
    item.append(element('strong', fact), remedy.join(''));
    return item;
  }));
}

// What one picture over the mat seldom shows, and several from different places do; and what none shows.
function unsure() {
  if (seen.cameras?.length !== 1 || !isOverMat()) return '';
  const top = topOf(testerName());
  return [top && `Is the yellow circle, ${top} mm, on the edge of the top?`, form.elements.arrow.value || form.elements.warp_direction_deg.value.trim() ? '' : 'Does the warp lie along the mat’s arrow?',
    `Is the top ${form.elements.plate_height_mm.value.trim()} mm over the mat? One picture seldom shows a wrong height, another from one side does.`].filter(Boolean).map((question) => ` ${question}`).join('');
}

// An arrow from the foot of the latest camera, or the border of the picture, to that of the next.
function drawWay() {
  const { width, height, next_camera: to } = seen;
  way.toggleAttribute('hidden', !to);
  if (!to) return;
  const size = MARGIN * width;
  const last = seen.cameras.at(-1);
  const reaching = [width, height].map((side, k) => { // the share of the way from the next one back within the picture
    const step = last[k] - to[k];
    return step ? ((step > 0 ? side - size : size) - to[k]) / step : 1;
  });
  const share = Math.min(1, ...reaching);
  const from = to.map((value, k) => value + share * (last[k] - value));
  const [right, down] = to.map((value, k) => value - from[k]);
  const length = Math.hypot(right, down);
  const [x, y] = length ? [right / length, down / length] : [0, -1];
  const head = [1, -1].map((turn) => [to[0] - size * (x + turn * y), to[1] - size * (y - turn * x)]);
  arrow.setAttribute('d', `M${from}L${to}M${head[0]}L${to}L${head[1]}`);
  for (const [key, value] of Object.entries({ cx: from[0], cy: from[1], r: size / 2 })) foot.setAttribute(key, value);
  label.textContent = 'next picture';
  const middle = Math.min(Math.max(to[0], LABEL * width), (1 - LABEL) * width);
  for (const [key, value] of Object.entries({ x: middle, y: to[1] + (down < 0 ? -0.7 : 1.6) * size, 'font-size': 1.4 * size })) label.setAttribute(key, value);
  way.setAttribute('aria-label', seen.warnings.map(({ values }) => values.next).find(Boolean) ?? label.textContent);
}

// ---- the circle

function draw() {
  const radius = circle.diameter / 2;
  const place = (what, x, r) => Object.entries({ cx: x, cy: circle.y, r }).forEach(([key, value]) => what.setAttribute(key, value));
  place(rim, circle.x, radius);
  place(knob, circle.x + radius, KNOB * seen.width);
  plate.setAttribute('aria-label', `the plate: centre ${Math.round(circle.x)}, ${Math.round(circle.y)}, diameter ${Math.round(circle.diameter)} of ${seen.width} by ${seen.height} pixels`
    + (seen.movable ? '; the arrow keys move it, plus and minus change its size' : ''));
}

// Moves the circle within the picture, and states it in pixels of the file.
function move(x, y, diameter) {
  const within = (value, most) => Math.min(Math.max(value, 0), most);
  circle = { x: within(x, seen.width), y: within(y, seen.height), diameter: Math.max(diameter, LEAST) };
  plate.classList.remove('guessed');
  draw();
  const stated = { plate_x: (circle.x + 0.5) * seen.scale - 0.5, plate_y: (circle.y + 0.5) * seen.scale - 0.5, plate_diameter: circle.diameter * seen.scale };
  for (const [name, value] of Object.entries(stated)) {
    form.elements[name].value = value.toFixed(1);
    form.elements[name].dataset.placed = '';
  }
  form.elements.mm_per_px.value = ''; // either states the scale
  form.elements.plate_x.dispatchEvent(new Event('change', { bubbles: true }));
}

function under(event) {
  return new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
}

plate.addEventListener('pointerdown', (event) => {
  if (!seen.movable || event.button) return;
  event.preventDefault();
  plate.focus({ preventScroll: true });
  plate.setPointerCapture(event.pointerId);
  const [start, { x, y, diameter }, sized] = [under(event), circle, event.target === knob];
  plate.onpointermove = (moved) => {
    const to = under(moved);
    if (sized) move(x, y, diameter + 2 * (to.x - start.x));
    else move(x + to.x - start.x, y + to.y - start.y, diameter);
  };
});
plate.addEventListener('touchstart', (event) => { // the page does not scroll; touch-action is not for parts of an SVG
  if (seen.movable) event.preventDefault();
}, { passive: false });
for (const end of ['pointerup', 'pointercancel']) {
  plate.addEventListener(end, () => {
    plate.onpointermove = null;
  });
}
plate.addEventListener('keydown', (event) => {
  const step = STEPS[event.key];
  if (!step || !seen.movable || event.ctrlKey || event.metaKey || event.altKey) return;
  event.preventDefault();
  const [x, y, more] = step.map((value) => value * (event.shiftKey ? 10 : 1));
  move(circle.x + x, circle.y + y, circle.diameter + more);
});
