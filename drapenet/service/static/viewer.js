// The captured surface, if depth was captured, and the simulated drape side by side, seen by one
// camera, so that they turn together.

import {
  Box3, Color, DirectionalLight, GLTFLoader, HemisphereLight, OrbitControls, PerspectiveCamera, Scene,
  WebGLRenderer,
} from './three.js';

const BACKGROUND = new Color(0xffffff);
const STEP = Math.PI / 24; // rad, a press of an arrow key
const NEARER = 0.9; // a press of +
const HIGHEST = 0.05; // rad from the axis
let ended = () => {}; // removes what an earlier drape has left

export async function view(address, canvas, overlay) {
  ended();
  const renderer = new WebGLRenderer({ canvas, antialias: true });
  renderer.setScissorTest(true);
  const { scene: found } = await new GLTFLoader().loadAsync(address);
  const parts = Object.fromEntries(['captured', 'simulated', 'support'].map((name) => [name, found.getObjectByName(name)]));
  const camera = new PerspectiveCamera(32, 1, 0.05, 5);
  const scene = new Scene();
  scene.background = BACKGROUND;
  scene.add(found, camera, new HemisphereLight(0xffffff, 0x8a8a8a, 1.6));
  const lamp = new DirectionalLight(0xffffff, 1.8);
  lamp.position.set(-0.5, 0.8, 0.6);
  camera.add(lamp);

  const shown = ['captured', 'simulated'].filter((name) => parts[name]);
  const box = new Box3().setFromObject(parts[shown[0]] ?? found);
  const controls = new OrbitControls(camera, canvas);
  box.getCenter(controls.target);
  camera.position.set(0, 0.27, 0.58).add(controls.target); // as the rig's camera stands
  controls.enablePan = false;
  controls.minDistance = 0.25;
  controls.maxDistance = 2;
  controls.update();

  const draw = () => {
    const width = canvas.clientWidth;
    const height = canvas.clientHeight;
    if (!width || !height) return;
    const ratio = Math.min(devicePixelRatio, 2);
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      renderer.setPixelRatio(ratio);
      renderer.setSize(width, height, false);
    }
    const views = overlay.checked || shown.length < 2 ? [shown] : shown.map((name) => [name]);
    views.forEach((names, k) => {
      const [left, share] = [(width * k) / views.length, width / views.length];
      renderer.setViewport(left, 0, share, height);
      renderer.setScissor(left, 0, share, height);
      camera.aspect = share / height;
      camera.updateProjectionMatrix();
      for (const name of shown) parts[name].visible = names.includes(name);
      renderer.render(scene, camera);
    });
  };

  const press = (event) => {
    const offset = camera.position.clone().sub(controls.target);
    let [radius, polar, azimuth] = [offset.length(), Math.acos(offset.y / offset.length()), Math.atan2(offset.x, offset.z)];
    if (event.key === 'ArrowLeft') azimuth -= STEP;
    else if (event.key === 'ArrowRight') azimuth += STEP;
    else if (event.key === 'ArrowUp') polar -= STEP;
    else if (event.key === 'ArrowDown') polar += STEP;
    else if (event.key === '+') radius *= NEARER;
    else if (event.key === '-') radius /= NEARER;
    else return;
    event.preventDefault();
    polar = Math.min(Math.max(polar, HIGHEST), Math.PI - HIGHEST);
    camera.position.setFromSphericalCoords(radius, polar, azimuth).add(controls.target);
    controls.update();
    draw();
  };

  const sizes = new ResizeObserver(draw);
  sizes.observe(canvas);
  controls.addEventListener('change', draw);
  overlay.addEventListener('change', draw);
  canvas.addEventListener('keydown', press);
  ended = () => {
    sizes.disconnect();
    controls.dispose();
    overlay.removeEventListener('change', draw);
    canvas.removeEventListener('keydown', press);
    renderer.dispose();
  };
  draw();
  return shown.includes('captured');
}
