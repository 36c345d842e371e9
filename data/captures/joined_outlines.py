"""The outline of one drape from the axis, joined from pictures of it from several places.

The network moves each picture's outline to the axis (:mod:`data.captures.off_axis`). Its errors
grow with the camera's lean and where cloth hangs straight down, so that pictures count the less
there. Seen from different heights, the depth of the hem changes the radii: a depth at each azimuth
is fitted with the radius. What differs from the others counts less, and a picture that differs over
a good part of the azimuth is left out. A plate that was turned between pictures is turned back.

What lies in the same place on the ground in two pictures, though a hem over it would have moved, is
a shadow, print or paper (:func:`hidden_by_ground`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from common.types import Metres, Outline, Radians
from data.captures.off_axis import AZIMUTH, AZIMUTHS, OUTWARDS, seen_from_axis
from data.pictures.planes import behind
from sim.outlines import closed, farthest
from sim.rig import Rig

MAX_UNLIKE = 0.08  # of the azimuth, over which a picture may differ from the others
MAX_PARTED = 0.02  # of the azimuth, over which two pictures may differ from each other
_UNLIKE = 4.0  # times its expected error, by which a picture differs
_POSED = 5e-4  # m, error by pose, mat, and place and height of the plate
_MOVED, _HIDDEN, _HANGING = 0.05, 0.12, 0.25
"""Error of moving an outline, of overhang times lean: of cloth that spreads, and added for cloth
that hangs straight down, within this share of the overhang from the rim."""
_TURNED = 0.7  # of the distance between two outlines, to which a turn of the plate reduces it
_DEPTH, _DEPTH_ERROR = 0.5, 0.2  # of the overhang, usual depth of the hem below the plate
_DEPTHS = np.linspace(0.0, 1.0, 21)  # tried
_DEPTH_LEFT = 0.15  # of the overhang, by which depth differs along the hem
_ROBUST, _ROUNDS = 2.0, 5  # times its error, from which on what is seen loses weight
_BELOW = np.linspace(0.0, 1.0, 5)  # of the overhang, depths of a hem that are thought of
_STILL, _PARALLAX = 2e-3, 4e-3  # m, on the ground, of an edge that stays and of a hem that moves
_STILL_SHARE = 1 / 3  # of its parallax that a hem may seem to move
_RUN = 9  # azimuths, over which an edge stays at least
_GROUND = 0.010  # m, error of an outline that follows something on the ground
_TURNS = (np.arange(AZIMUTHS)[:, None] + np.arange(AZIMUTHS)) % AZIMUTHS  # back by each azimuth


class SeenOutline(NamedTuple):
    """An outline as seen on the plane of the plate, about its centre, by a camera at the place
    ``beside`` (2,), m, the axis and at ``height`` above the plate; ``error``: (A,) m, standard
    deviation of its radii as they were read."""

    curve: Outline
    beside: np.ndarray
    height: Metres
    error: np.ndarray

    def turned(self, angle: Radians) -> "SeenOutline":
        """The same, turned counter-clockwise."""
        return SeenOutline(turned(self.curve, angle), turned(self.beside, angle), self.height,
                    around(self.error, -angle))


@dataclass(frozen=True)
class JoinedOutline:
    """What several views show together, at :data:`AZIMUTHS` (A) equally spaced azimuths.

    Attributes:
        used: which views agree, in order; the others are left out.
        reference: which of them is nearest to the axis.
        turned: counter-clockwise from the first view, rad, of the drape in each view; taken back.
        radius: (A,) m, of the outline from the axis at the height of the ``reference``.
        seen: (A,) m, the same outline about as the reference shows it.
        error: (A,) m, standard deviation of ``radius``.
        parted: where, rad, and over which share of the azimuth the only two that are used
            contradict each other; None if they do not.
        grounded: (A,) where all that are used show something on the ground in place of the hem.
    """

    used: list[int]
    reference: int
    turned: list[Radians]
    radius: np.ndarray
    seen: np.ndarray
    error: np.ndarray
    parted: tuple[Radians, float] | None
    grounded: np.ndarray


def join_outlines(views: Sequence[SeenOutline], rig: Rig, plate_height: Metres) -> JoinedOutline:
    """Join two or more views of a drape on a plate at a height over the ground; of a rectangle, the
    x-axis is along its first side in the first."""
    overhang = rig.border(AZIMUTH) - rig.plate_radius
    lean = np.array([np.linalg.norm(view.beside) / view.height for view in views])
    moved, error = on_axis(views, rig)
    grounded, turns = hidden_by_ground(views, rig, plate_height), [0.0] * len(views)
    for k in range(1, len(views)):
        # The plate may have been turned: as far as brings the shapes of the outlines together.
        off = np.abs(moved[k][_TURNS] - moved[0] - (moved[k] - moved[0]).mean())
        apart = off.mean(axis=1)
        best = int(apart.argmin())
        limit = _UNLIKE * np.hypot(error[0], np.quantile(error[k], 0.9))
        unlike = (off[[0, best]] > limit).mean(axis=1)
        if unlike[0] > MAX_PARTED and unlike[1] <= MAX_UNLIKE and apart[best] < _TURNED * apart[0]:
            turns[k] = float((AZIMUTH[best] + np.pi) % (2 * np.pi) - np.pi)
    if any(turns):
        grounded = np.array([around(here, angle) > 0.5
                             for here, angle in zip(grounded, turns, strict=True)])
        views = [view.turned(-angle) for view, angle in zip(views, turns, strict=True)]
        moved, error = on_axis(views, rig)
    error = np.hypot(error, _GROUND * grounded)
    height = np.array([[view.height] for view in views])
    # Pictures from different heights show how deep the hem hangs: in the mean, then everywhere.
    tried = [moved * (1 + depth * overhang / height) for depth in _DEPTHS]
    cost = [np.log1p(np.square((hems - _fitted(hems, error, 0 * hems, overhang)[0]) / error)).mean()
            + np.square((depth - _DEPTH) / _DEPTH_ERROR) / AZIMUTHS
            for hems, depth in zip(tried, _DEPTHS, strict=True)]
    depth = _DEPTHS[int(np.argmin(cost))] * overhang
    used = list(range(len(views)))
    while True:
        reference = min(used, key=lambda k: lean[k])
        radii = moved * (1 + depth / height) / (1 + depth / height[reference])
        deeper = moved * (1 / height[reference] - 1 / height)  # change of radii with the depth
        radius, below, deviation = _fitted(radii[used], error[used], deeper[used], overhang)
        off = np.abs(radii[used] - radius - deeper[used] * below)
        unlike = (off > _UNLIKE * error[used]).mean(axis=1)
        if len(used) == 2 or unlike.max() <= MAX_UNLIKE:
            break
        used.pop(int(unlike.argmax()))
    parted = None
    if len(used) == 2:
        one, other = used
        apart = np.abs(radii[one] - radii[other]) > _UNLIKE * np.sqrt(
            np.square(error[used]).sum(axis=0)
            + np.square(_DEPTH_LEFT * overhang * (deeper[one] - deeper[other])))
        if (share := float(apart.mean())) > MAX_PARTED:
            parted = float(np.angle(apart @ np.exp(1j * AZIMUTH))), share
    differing = np.average(np.square(off), axis=0, weights=1 / np.square(error[used]))
    here = views[reference]
    shown = radius[:, None] * OUTWARDS + (depth / (here.height + depth))[:, None] * here.beside
    everywhere = np.asarray(grounded[used].all(axis=0))
    error = np.sqrt(np.square(deviation) + differing / (len(used) - 1))
    return JoinedOutline(used, reference, turns, radius, _radii(shown),
                  np.hypot(error, _GROUND * everywhere), parted, everywhere)


def hidden_by_ground(views: Sequence[SeenOutline], rig: Rig, plate_height: Metres) -> np.ndarray:
    """Where (K, A) the outline of each view lies on the ground as another view's does, though the
    parallax of any hem between the plate and the full overhang below it is larger."""
    below = np.minimum(rig.border(AZIMUTH) - rig.plate_radius, plate_height)[:, None]
    eyes = [np.append(view.beside, plate_height + view.height) for view in views]
    radii = [_radii(behind(view.curve, eye, plate_height))
             for view, eye in zip(views, eyes, strict=True)]

    def moved(one: int, other: int, depth: float) -> np.ndarray:
        """Radii (A,) of what the first sees, on the ground as the other would see a hem there."""
        eye, height = eyes[one], plate_height - depth * below
        hem = eye[:2] + (radii[one][:, None] * OUTWARDS - eye[:2]) * (1 - height / eye[2])
        return _radii(behind(hem, eyes[other], height))

    found = np.zeros((len(views), AZIMUTHS), dtype=bool)
    for one, other in combinations(range(len(views)), 2):
        parallax = np.array([off for depth in _BELOW for off in (
            radii[one] - moved(one, other, depth), moved(other, one, depth) - radii[other])])
        least = np.maximum(np.maximum(parallax.min(axis=0), -parallax.max(axis=0)), 0)
        still = (least > _PARALLAX) & (np.abs(radii[one] - radii[other])
                                       < np.minimum(_STILL, _STILL_SHARE * least))
        found[[one, other]] |= ndimage.binary_opening(np.tile(still, 3), np.ones(_RUN))[
            AZIMUTHS : 2 * AZIMUTHS]
    return found


def _radii(points: np.ndarray) -> np.ndarray:
    """Farthest radii (A,) of a curve (N, 2)."""
    return farthest(closed(points), AZIMUTHS)


def _fitted(
    radii: np.ndarray, error: np.ndarray, deeper: np.ndarray, overhang: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Radius (A,) of radii (K, A) with errors, which change by ``deeper`` with the depth; depth
    beyond the mean one, m; and the radius' standard deviation. What differs counts less."""
    weight = start = 1 / np.square(error)
    for _ in range(_ROUNDS):
        first, mixed = weight.sum(axis=0), (weight * deeper).sum(axis=0)
        second = (weight * deeper**2).sum(axis=0) + 1 / np.square(_DEPTH_LEFT * overhang)
        value, slope = (weight * radii).sum(axis=0), (weight * deeper * radii).sum(axis=0)
        determinant = first * second - mixed**2
        radius = (second * value - mixed * slope) / determinant
        below = (first * slope - mixed * value) / determinant
        off = (radii - radius - deeper * below) / (_ROBUST * error)
        weight = start / (1 + np.square(off))
    return radius, below, np.sqrt(second / determinant)


def on_axis(views: Sequence[SeenOutline], rig: Rig) -> tuple[np.ndarray, np.ndarray]:
    """Radii (K, A), m, as the network moves each view to the axis, and their errors."""
    moved = np.array([_radii(seen_from_axis(*view[:3], rig)) for view in views])
    lean = np.array([[np.linalg.norm(view.beside) / view.height] for view in views])
    overhang = rig.border(AZIMUTH) - rig.plate_radius
    hanging = np.exp(-np.maximum(moved - rig.plate_radius, 0) / overhang / _HANGING)
    read = np.hypot([view.error for view in views], _POSED)
    return moved, np.hypot(read, lean * overhang * (_MOVED + _HIDDEN * hanging))


def turned(points: np.ndarray, angle: Radians) -> np.ndarray:
    """Points (..., 2), m, turned counter-clockwise."""
    cos, sin = np.cos(angle), np.sin(angle)
    return points @ np.array([[cos, sin], [-sin, cos]])


def around(values: np.ndarray, angle: Radians) -> np.ndarray:
    """Values (A,) at equally spaced azimuths, each at an ``angle`` from its place before."""
    return np.interp(AZIMUTH + angle, AZIMUTH, values, period=2 * np.pi)
