// Drapes beside each other, seen by one camera, so that they turn together. Of one file, these are
// the captured surface, if depth was captured, and the simulated drape; of several, one of each.

import {
  Box3, Color, DirectionalLight, GLTFLoader, HemisphereLight, OrbitControls, PerspectiveCamera, Scene,
  WebGLRenderer,
} from './three.js';

const BACKGROUND = new Color(matchMedia('(prefers-color-scheme: dark)').matches ? 0x1a2130 : 0xffffff);
const FIELD = 32; // degrees, of the smaller side of a tile
const STEP = Math.PI / 24; // rad, a press of an arrow key
const NEARER = 0.9; // a press of +
const HIGHEST = 0.05; // rad from the axis
const ended = new WeakMap(); // of a canvas: removes what an earlier view of it has left

// Whether a captured surface is shown. `overlay`, if any, is the box that shows all in one place.
export async function view(addresses, canvas, overlay = null, columns = 2) {
  ended.get(canvas)?.();
  const loaded = await Promise.all(addresses.map((address) => new GLTFLoader().loadAsync(address)));
  const renderer = new WebGLRenderer({ canvas, antialias: true });
  renderer.setScissorTest(true);
  const camera = new PerspectiveCamera(FIELD, 1, 0.05, 5);
  const scene = new Scene();
  scene.background = BACKGROUND;
  scene.add(camera, new HemisphereLight(0xffffff, 0x8a8a8a, 1.6));
  const lamp = new DirectionalLight(0xffffff, 1.8);
  lamp.position.set(-0.5, 0.8, 0.6);
  camera.add(lamp);

  const parts = [];
  const tiles = loaded.flatMap(({ scene: found }) => {
    const [captured, simulated, support] = ['captured', 'simulated', 'support'].map((name) => found.getObjectByName(name));
    const drapes = [captured, simulated].filter(Boolean);
    parts.push(...drapes, support);
    scene.add(found);
    return (loaded.length > 1 ? [simulated ?? captured] : drapes).map((drape) => [drape, support]);
  });
  const box = new Box3().setFromObject(tiles[0]?.[0] ?? scene);
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
    const views = overlay?.checked ? [tiles.flat()] : tiles;
    const across = Math.min(columns, views.length);
    const [share, part] = [width / across, height / Math.ceil(views.length / across)];
    views.forEach((visible, k) => {
      const [left, below] = [share * (k % across), height - part * (1 + Math.floor(k / across))];
      renderer.setViewport(left, below, share, part);
      renderer.setScissor(left, below, share, part);
      camera.aspect = share / part;
      camera.fov = camera.aspect < 1 ? FIELD / camera.aspect : FIELD; // a narrow tile shows the whole drape
      camera.updateProjectionMatrix();
      for (const one of parts) one.visible = visible.includes(one);
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
  overlay?.addEventListener('change', draw);
  canvas.addEventListener('keydown', press);
  ended.set(canvas, () => {
    sizes.disconnect();
    controls.dispose();
    overlay?.removeEventListener('change', draw);
    canvas.removeEventListener('keydown', press);
    renderer.dispose();
  });
  draw();
  return loaded.length === 1 && tiles.length > 1;
}
