"""Synthetic raw frames: what a depth camera sees of a drape test before anything is cut out.

The tester (plate and column) stands on a table before a wall, with other things around it. Nothing
stands between the camera and the cloth.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
import trimesh

from data.render.cameras import Camera, CameraRig
from data.render.rasterise import camera_tensors
from data.render.renderer import DepthRenderer
from data.render.sensor import load_sensor
from data.render.setups import Setups
from data.render.structured_light import StructuredLight
from sim.rig import Rig

CLUTTER = {"empty": 0, "some": 5, "full": 14}
"""Things on the table, by density."""
TABLE = (0.220, 0.320)  # m, below the plate
WALL = (0.45, 0.90)  # m, behind the plate's axis
_CLEAR = 0.04  # m, between things and the space that cloth can reach
_BESIDE = (0.25, 0.70)  # m, of things from the plate's axis
_HEIGHTS = (0.03, 0.35)  # m, of things
_GAP = 0.3e-3  # m, of the plate's top below the cloth's middle surface
_AWAY = 10.0  # m, by which a label puts all that is not cloth farther away
_TRIES = 20  # places tried for each thing


@dataclass(frozen=True)
class RawScene:
    """Frames of a whole scene, and what nobody knows of it.

    Attributes:
        frames: (K, H, W) float32 z-depth, m, 0 where the sensor saw nothing.
        background: (H, W) the same without specimen.
        cloth: (K, H, W) bool, pixels of the frames that show cloth.
        clean: (K, H, W) z-depth of the cloth alone, m, background 0, without noise.
        camera: with its pose relative to the plate.
        turns: (K,) rad, how far the table had turned in each frame.
        orientation: direction of the warp in the first frame, rad.
        table: m, height of the table above the plate (negative).
        column: m, radius of the column.
    """

    frames: np.ndarray
    background: np.ndarray
    cloth: np.ndarray
    clean: np.ndarray
    camera: Camera
    turns: np.ndarray
    orientation: float
    table: float
    column: float


def raw_scene(
    positions: np.ndarray, faces: np.ndarray, rng: np.random.Generator, *, rig: Rig,
    turns: Sequence[float], sensor: str = "smooth", clutter: str = "some",
    setups: Setups | None = None, column: float | None = None,
) -> RawScene:
    """Frames of a drape with vertices (V, 3), m, and triangles (F, 3), in a scene drawn at random.

    Args:
        rig: with a plate.
        turns: (K,) rad, how far the table has turned in each frame.
        sensor: a name in ``configs/sensor``. clutter: one of :data:`CLUTTER`.
        setups: that the camera is drawn from; None: ``configs/setup/real.yaml``.
        column: m, radius of the column; None: a fifth to nine tenths of the plate's.
    """
    camera = (setups or Setups.load()).camera(rng, CameraRig.load(rig))
    orientation = float(rng.uniform(0, 2 * np.pi))
    clean = DepthRenderer(positions, faces).views(camera, orientation, turns)
    table, column_drawn = -rng.uniform(*TABLE), rng.uniform(0.2, 0.9) * rig.plate_radius
    column = column_drawn if column is None else column
    still = _depth([*_room(table, rng), *_tester(rig, column, table)], camera)
    for _ in range(CLUTTER[clutter]):
        still = _with_thing(still, clean, camera, rig, table, rng)
    shown = (clean > 0) & (_distance(clean) <= _distance(still))
    scene = np.where(shown, clean, still).astype(np.float32)
    frames, cloth, background = _sensed(scene, shown, still, sensor, camera, rng)
    return RawScene(frames, background, cloth, clean, camera, np.asarray(turns, float),
                    orientation, table, column)


def _distance(depth: np.ndarray) -> np.ndarray:
    """Depth with nothing, 0, infinitely far away."""
    return np.where(depth > 0, depth, np.inf)


def _depth(meshes: list[trimesh.Trimesh], camera: Camera) -> np.ndarray:
    """(H, W) z-depth of meshes in world axes, m, 0 where there is none."""
    mesh = trimesh.util.concatenate(meshes)
    return DepthRenderer(mesh.vertices, mesh.faces).view(camera)


def _box(centre: Sequence[float], size: Sequence[float], turn: float = 0.0) -> trimesh.Trimesh:
    pose = trimesh.transformations.rotation_matrix(turn, [0, 0, 1])
    pose[:3, 3] = centre
    return trimesh.creation.box(size, pose)


def _cylinder(x: float, y: float, radius: float, low: float, high: float) -> trimesh.Trimesh:
    mesh = trimesh.creation.cylinder(radius, high - low, sections=64)
    return mesh.apply_translation([x, y, (low + high) / 2])


def _room(table: float, rng: np.random.Generator) -> list[trimesh.Trimesh]:
    """The table, up to the wall, and the wall, not quite across the camera's view."""
    wall, askew = rng.uniform(*WALL), rng.uniform(-0.3, 0.3)
    return [_box([0, wall / 2, table - 0.01], [3.0, wall + 2.0, 0.02]),
            _box([0, wall + 0.01, 0], [6.0, 0.02, 4.0], askew)]


def _tester(rig: Rig, column: float, table: float) -> list[trimesh.Trimesh]:
    return [_cylinder(0, 0, rig.plate_radius - 0.5e-3, -6e-3, -_GAP),
            _cylinder(0, 0, column, table, -5e-3)]


def _with_thing(
    still: np.ndarray, clean: np.ndarray, camera: Camera, rig: Rig, table: float,
    rng: np.random.Generator,
) -> np.ndarray:
    """The empty scene (H, W) with one more box or cylinder, that hides no cloth in any view and
    stays out of the cloth's reach; as it was where no such place is found.
    """
    for _ in range(_TRIES):
        away, azimuth = rng.uniform(*_BESIDE), rng.uniform(-np.pi / 3, 4 / 3 * np.pi)
        x, y = away * np.cos(azimuth), away * np.sin(azimuth)
        high, wide = table + rng.uniform(*_HEIGHTS), rng.uniform(0.02, 0.08)
        if rng.random() < 0.5:
            thing = _cylinder(x, y, wide, table, high)
        else:
            size = [2 * wide, 2 * rng.uniform(0.02, 0.08), high - table]
            thing = _box([x, y, (table + high) / 2], size, rng.uniform(0, np.pi))
        nearest = np.linalg.norm(thing.vertices[:, :2], axis=1).min()
        if nearest < rig.reach + _CLEAR and high > -rig.overhang - _CLEAR:
            continue
        depth = _distance(_depth([thing], camera))
        if (np.isfinite(depth) & (depth < clean)).any():
            continue
        if np.isfinite(depth).any():
            return np.where(depth < _distance(still), depth, still)
    return still


def _sensed(
    scene: np.ndarray, shown: np.ndarray, still: np.ndarray, name: str, camera: Camera,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frames, the pixels in them that show cloth, and the empty scene, as the sensor gives them."""
    sensor, seed = load_sensor(name), int(rng.integers(2**63))
    numbers, _ = camera_tensors([camera])

    def through(pictures: np.ndarray) -> np.ndarray:
        generator = torch.Generator().manual_seed(seed)
        return sensor(torch.from_numpy(pictures.astype(np.float32)), numbers[0],
                      generator).numpy()

    # The empty scene goes along as one more view: one capture has one bias.
    noisy = through(np.concatenate([scene, still[None]]))
    cloth = shown
    if isinstance(sensor, StructuredLight) and sensor.strength:
        # It looks beside a pixel's place, by the same draws for equal seeds: so a label is carried
        # through it as a depth that no scene has.
        labels = np.where(shown, scene, _AWAY)
        cloth = through(np.concatenate([labels, np.full_like(still[None], _AWAY)]))[:-1]
        cloth = (cloth > 0) & (cloth < _AWAY / 2)
    return noisy[:-1], cloth, noisy[-1]
