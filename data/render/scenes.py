"""Synthetic raw frames: what a depth camera sees of a drape test before anything is cut out.

The tester (plate and column) stands on a table before a wall, with other things around it. Nothing
stands between the camera and the cloth.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh

from common.types import DepthImage, Faces, Masks, Metres, Points, Radians, Turns, Views
from data.render.cameras import Camera
from data.render.rays import DepthRenderer
from data.render.sensors import StructuredLight, load_sensor
from data.render.setups import Setups
from sim.rig import Rig

CLUTTER = {"empty": 0, "some": 5, "full": 14}
"""Number of objects on the table."""
TABLE = (0.220, 0.320)  # m, below the plate
WALL = (0.45, 0.90)  # m, behind the plate's axis
_CLEAR = 0.04  # m, between objects and the space that cloth can reach
_BESIDE = (0.25, 0.70)  # m, of objects from the plate's axis
_HEIGHTS = (0.03, 0.35)  # m, of objects
_GAP = 0.3e-3  # m, of the plate's top below the cloth's middle surface
_AWAY = 10.0  # m, depth that marks pixels without cloth
_TRIES = 20  # places tried for each object


@dataclass(frozen=True)
class RawScene:
    """Frames of a whole scene with the truth about it."""

    frames: Views
    background: DepthImage  # without specimen
    cloth: Masks  # pixels of the frames that show cloth
    clean: Views  # of the cloth alone, without noise
    camera: Camera
    turns: Turns
    orientation: Radians  # direction of the warp in the first frame
    table: Metres  # height above the plate (negative)
    column: Metres  # radius


def raw_scene(
    positions: Points, faces: Faces, rng: np.random.Generator, *, rig: Rig,
    turns: Turns, sensor: str = "smooth", clutter: str = "some", column: Metres | None = None,
) -> RawScene:
    """Frames of a drape in a random scene, one for each turn of the table.

    ``sensor``: a name in ``configs/sensor``; ``clutter``: one of :data:`CLUTTER`; ``column``: its
    radius, random if None, 20 to 90 % of the plate's.
    """
    camera = Setups.load().camera(rng, rig)
    orientation = float(rng.uniform(0, 2 * np.pi))
    clean = DepthRenderer(positions, faces).views(camera, orientation, turns)
    table, column_drawn = -rng.uniform(*TABLE), rng.uniform(0.2, 0.9) * rig.plate_radius
    column = column_drawn if column is None else column
    wall, askew = rng.uniform(*WALL), rng.uniform(-0.3, 0.3)
    empty = _depth([
        _box([0, wall / 2, table - 0.01], [3.0, wall + 2.0, 0.02]),  # the table
        _box([0, wall + 0.01, 0], [6.0, 0.02, 4.0], askew),
        _cylinder(0, 0, rig.plate_radius - 0.5e-3, -6e-3, -_GAP),
        _cylinder(0, 0, column, table, -5e-3),
    ], camera)
    for _ in range(CLUTTER[clutter]):
        empty = _with_object(empty, clean, camera, rig, table, rng)
    cloth = (clean > 0) & (_distance(clean) <= _distance(empty))
    scene = np.where(cloth, clean, empty).astype(np.float32)
    frames, cloth, background = _measured(scene, cloth, empty, sensor, camera, rng)
    return RawScene(frames, background, cloth, clean, camera, np.asarray(turns, float),
                    orientation, table, column)


def _distance(depth: np.ndarray) -> np.ndarray:
    return np.where(depth > 0, depth, np.inf)


def _depth(meshes: list[trimesh.Trimesh], camera: Camera) -> DepthImage:
    mesh: Any = trimesh.util.concatenate(meshes)
    return DepthRenderer(mesh.vertices, mesh.faces).view(camera)


def _box(centre: Sequence[float], size: Sequence[float], turn: float = 0.0) -> trimesh.Trimesh:
    pose = trimesh.transformations.rotation_matrix(turn, [0, 0, 1])
    pose[:3, 3] = centre
    return trimesh.creation.box(size, pose)


def _cylinder(x: float, y: float, radius: float, low: float, high: float) -> trimesh.Trimesh:
    mesh = trimesh.creation.cylinder(radius, high - low, sections=64)
    return mesh.apply_translation([x, y, (low + high) / 2])


def _with_object(
    empty: DepthImage, clean: Views, camera: Camera, rig: Rig, table: Metres,
    rng: np.random.Generator,
) -> DepthImage:
    """The empty scene with a box or cylinder outside the cloth's reach that hides no cloth in any
    view; unchanged if there is no such place.
    """
    for _ in range(_TRIES):
        away, azimuth = rng.uniform(*_BESIDE), rng.uniform(-np.pi / 3, 4 / 3 * np.pi)
        x, y = away * np.cos(azimuth), away * np.sin(azimuth)
        high, wide = table + rng.uniform(*_HEIGHTS), rng.uniform(0.02, 0.08)
        if rng.random() < 0.5:
            mesh = _cylinder(x, y, wide, table, high)
        else:
            size = [2 * wide, 2 * rng.uniform(0.02, 0.08), high - table]
            mesh = _box([x, y, (table + high) / 2], size, rng.uniform(0, np.pi))
        nearest = np.linalg.norm(mesh.vertices[:, :2], axis=1).min()
        if nearest < rig.reach + _CLEAR and high > -rig.overhang - _CLEAR:
            continue
        depth = _distance(_depth([mesh], camera))
        if (np.isfinite(depth) & (depth < clean)).any():
            continue
        if np.isfinite(depth).any():
            return np.where(depth < _distance(empty), depth, empty)
    return empty


def _measured(
    scene: Views, cloth: Masks, empty: DepthImage, name: str, camera: Camera,
    rng: np.random.Generator,
) -> tuple[Views, Masks, DepthImage]:
    """Frames, the pixels in them that show cloth, and the empty scene, as the sensor gives them."""
    sensor, seed = load_sensor(name), int(rng.integers(2**63))
    # The empty scene is one of the capture's views, because the sensor's bias is that of a capture.
    noisy = sensor(np.concatenate([scene, empty[None]]), camera, seed)
    if isinstance(sensor, StructuredLight) and sensor.strength:
        # This sensor displaces pixels, equally for equal seeds. A second pass with everything but
        # the cloth far away shows which pixels have become cloth.
        marked = np.where(cloth, scene, _AWAY)
        marked = sensor(np.concatenate([marked, np.full_like(empty[None], _AWAY)]), camera, seed)
        cloth = (marked[:-1] > 0) & (marked[:-1] < _AWAY / 2)
    return noisy[:-1], cloth, noisy[-1]
