"""Random views of a drape, as the network that cuts cloth out of photographs learns them."""

import cv2
import numpy as np

from common.types import Metres
from data.pictures.cut import steps
from data.pictures.mat import CODE, MATS, on_ground, printed_at
from data.pictures.planes import behind
from data.pictures.reading import encoded
from data.render.hard import HARD
from data.render.phone import exposed, mat_around
from data.render.scenery import Scenery

HIGHEST = 0.25  # m, plates over the ground
STORED, _TIMES = 256, 2  # pixels of a picture, and those rendered for each, along a side
_PLACE, _SCALE = 1e-3, 4e-3  # deviations of the mat: m, and relative
_PLACE_OF_CODE = 2e-4  # m
_ON_MAT, _CODED = 0.5, 0.45  # shares of the scenes, and of the mats
_HARD = {True: (0.3, 0.55, 0.15), False: (0.65, 0.3, 0.05)}  # of scenes by difficulties: on a mat,
# and without, where nothing tells cloth from a ground of its colour
_BENT, _FAR = 5e-3, 0.2  # of its scale by the lens, at a distance in m from the middle


def scene_of(positions: np.ndarray, rest: np.ndarray, faces: np.ndarray, plate: Metres,
             reach: Metres, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """A random view of a drape (V, 3), m, flat (V, 2), with the plate's and the specimen's radii:
    arrays of what :class:`data.pictures.cut.ClothView` is given, and ``cloth`` (STORED, STORED),
    the share of each pixel that the specimen covers, of 255."""
    low = float(-positions[:, 2].min())
    spare = max(HIGHEST - low, 0.05)
    height = low + rng.choice([rng.uniform(0, 3e-3), rng.uniform(0, 0.3) * spare,
                               rng.uniform(0, 1) * spare], p=[0.1, 0.3, 0.6])
    mat = None
    if rng.random() < _ON_MAT:
        mat = mat_around(reach) if rng.random() < 0.8 else str(rng.choice(list(MATS)))
    turn = rng.uniform(0, 2 * np.pi)
    cos, sin = np.cos(turn), np.sin(turn)
    cloth = positions @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1.0]]) + [0, 0, height]
    coded = mat is not None and rng.random() < _CODED
    scenery = Scenery.random(cloth, rest, faces, rng, mat=mat, plate_radius=plate,
                             plate_height=height, ground=CODE if coded else None)
    for kind in rng.permutation(list(HARD))[: rng.choice(3, p=_HARD[mat is not None])]:
        scenery = HARD[str(kind)](scenery, reach, rng)
    off = np.zeros(2)
    known = mat is not None or rng.random() < 0.5
    if not known:
        off = rng.normal(0, 0.15 * reach, 2)
    above = float(np.exp(rng.uniform(np.log(0.3), np.log(2.0))))
    lean, around = 0.45 * rng.uniform() ** 2, rng.uniform(0, 2 * np.pi)
    eye = np.array([*(above * lean * np.array([np.cos(around), np.sin(around)])), height + above])
    end = steps(reach, STORED)[-1] * (1 + (1 - 1 / _TIMES) / (STORED - 1))
    fine = np.linspace(-end, end, _TIMES * STORED)
    plane = np.dstack([*np.meshgrid(fine + off[0], -fine + off[1]),
                       np.full((_TIMES * STORED,) * 2, height)])
    rays = plane - eye
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    light, shown = scenery.seen(eye, rays, rng)
    light *= _fallen(plane, reach, rng)[..., None]
    picture = exposed(light.astype(np.float32), rng, blur=np.exp(rng.uniform(-1.2, 0.9)))
    quality = [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(50, 97))]
    picture = np.asarray(cv2.imdecode(cv2.imencode(".jpg", picture, quality)[1],
                                      cv2.IMREAD_COLOR))
    size = (STORED, STORED)
    printed, on_mat = expected(mat, None if coded else scenery.mat_ground,
                               plane[::_TIMES, ::_TIMES, :2], eye, height, rng)
    return {"picture": cv2.resize(picture, size, interpolation=cv2.INTER_AREA),
            "printed": printed, "on_mat": on_mat,
            "cloth": cv2.resize(np.uint8(255) * shown, size, interpolation=cv2.INTER_AREA),
            "plate": np.array(plate), "reach": np.array(reach),
            "off": off if known else np.full(2, np.nan)}


def expected(mat: str | None, ground: np.ndarray | None, plane: np.ndarray, eye: np.ndarray,
             height: Metres, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """The mat (STORED, STORED), with a ``ground`` of a colour (3,) or the code, None, as it must
    appear behind places (STORED, STORED, 2) of the plate's plane, with errors of the pose; and
    where it is."""
    if mat is None:
        return np.zeros((STORED, STORED), np.uint8), np.zeros((STORED, STORED), bool)
    there = behind(plane, eye, height)
    bent = rng.normal(0, _BENT) * np.square(np.linalg.norm(there, axis=2, keepdims=True) / _FAR)
    if ground is not None:
        there = eye[:2] + (there - eye[:2]) * np.exp(rng.normal(0, _SCALE) + bent)
    if ground is None:  # its place is measured on the code
        return printed_at(mat, there + rng.normal(0, _PLACE_OF_CODE, 2), CODE)
    printed, on_mat = printed_at(mat, there + rng.normal(0, _PLACE, 2))
    tone = encoded(np.clip(ground.mean(), 0, 1))
    return np.where(on_ground(mat, there), tone * printed, printed).astype(np.uint8), on_mat


def _fallen(plane: np.ndarray, reach: Metres, rng: np.random.Generator) -> np.ndarray:
    """Light (H, W) that the photographer's shadow leaves, mostly all."""
    if rng.random() > 0.2:
        return np.ones(plane.shape[:2])
    way, soft = rng.normal(size=2), reach * np.exp(rng.uniform(-4, 0))
    side = (plane[..., :2] @ way) / np.linalg.norm(way) + rng.uniform(-1, 1) * reach
    return 1 - rng.uniform(0.1, 0.7) / (1 + np.exp(-np.clip(side / soft, -30, 30)))
