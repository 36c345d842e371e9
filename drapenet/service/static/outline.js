// The photograph as it is read, before the estimate, with the outline and the circle of the plate.
// Moving the circle fills the plate's fields of the form, which then ask for another reading.

import { ask, at, element } from './common.js';

const DELAY = 400; // ms after the last change
const KNOB = 0.025; // radius, of the picture's width
const GUESS = 0.45; // diameter, of the smaller side, until the plate is known
const LEAST = 20; // pixels, diameter
const STEPS = { ArrowLeft: [-1, 0, 0], ArrowRight: [1, 0, 0], ArrowUp: [0, -1, 0], ArrowDown: [0, 1, 0],
  '+': [0, 0, 2], '=': [0, 0, 2], '*': [0, 0, 2], '-': [0, 0, -2], _: [0, 0, -2] };
const svg = at('seen-picture');
const [image, specimen, warp, hem, plate] = svg.children;
const [rim, knob] = plate.children;
const form = at('form');
let timer = null;
let next = null; // content of the form, to be read
let reading = false;
let seen = null; // the last answer with a picture
let circle = null; // of the plate, pixels of the picture

// ---- reading

// Reads the photograph of a form's content, or shows none.
export function look(data) {
  clearTimeout(timer);
  next = data;
  if (data) timer = setTimeout(read, DELAY);
  else show(null);
}

// One at a time; what has changed meanwhile is read next, in place of what is then no longer asked.
async function read() {
  if (reading || !next) return;
  reading = true;
  at('seen').hidden = false;
  at('seen-status').textContent = 'Reading the photograph …';
  while (next) {
    const data = next;
    const found = await ask('/outline', { method: 'POST', body: data }).catch(({ message }) => ({ refusal: message }));
    if (data === next) {
      next = null;
      show(found);
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
    svg.toggleAttribute('hidden', false);
    draw();
  }
  at('seen-help').hidden = !seen;
  at('seen-move').hidden = !seen?.movable;
  at('seen-refusal').textContent = found?.refusal ?? '';
  at('seen-status').textContent = seen?.outline ? `Outline found: ${seen.nodes} nodes, drape coefficient ${seen.drape_coefficient_percent.toFixed(1)} % as the camera sees it.` : '';
  at('seen-warnings').replaceChildren(...(found?.warnings ?? []).map(({ text }) => element('li', text)));
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
