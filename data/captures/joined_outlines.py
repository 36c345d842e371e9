"""The outline of one drape from the axis, joined from pictures of it from several places.

The network moves each picture's outline to the axis (:mod:`data.captures.off_axis`). Its errors
grow with the camera's lean and where cloth hangs straight down, so that pictures count the less
there; what differs from the others counts less, too, and a picture that differs over a good part of
the azimuth is left out. A plate that was turned between pictures is turned back.

Of 210 simulated drapes, seen with errors of reading (0.5 mm, poses 0.3 %; in 52 one picture with a
fault of 5 to 10 mm over 10 to 30 degrees), the outline from the axis is 0.90 mm (median) and 2.1 mm
(nine of ten) off with two pictures, 0.71 and 1.8 with three, 0.60 and 1.5 with four; the picture
nearest to the axis alone is 1.0 and 2.2 off. A hem in space by least squares, from parallax, was no
better: what is seen of limp cloth is not one line.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from common.types import Metres, Outline, Radians
from data.captures.off_axis import seen_from_axis
from sim.measures import closed, farthest
from sim.rig import Rig

AZIMUTHS = 720
MAX_UNLIKE = 0.08  # of the azimuth, over which a picture may differ from the others
MAX_PARTED = 0.02  # of the azimuth, over which two pictures may differ from each other
_UNLIKE = 4.0  # times its expected error, by which a picture differs
_READ = 6e-4  # m, error of an outline as it is read
_MOVED, _HIDDEN, _HANGING = 0.05, 0.12, 0.25
"""Error of moving an outline, of overhang times lean: of cloth that spreads, and added for cloth
that hangs straight down, within this share of the overhang from the rim."""
_TURNED = 0.5  # of the distance between two outlines, to which a turn of the plate reduces it
_DEPTH, _DEPTH_ERROR = 0.5, 0.2  # of the overhang, usual depth of the hem below the plate
_DEPTHS = np.linspace(0.0, 1.0, 21)  # tried
_DEPTH_LEFT = 0.15  # of the overhang, by which depth differs along the hem
_ROBUST, _ROUNDS = 2.0, 5  # times its error, from which on what is seen loses weight
_AZIMUTH = np.arange(AZIMUTHS) * (2 * np.pi / AZIMUTHS)
_TURNS = (np.arange(AZIMUTHS)[:, None] + np.arange(AZIMUTHS)) % AZIMUTHS  # back by each azimuth
OUTWARDS = np.column_stack([np.cos(_AZIMUTH), np.sin(_AZIMUTH)])


class View(NamedTuple):
    """An outline as seen on the plane of the plate, about its centre, by a camera at the place
    ``beside`` (2,), m, the axis and at ``height`` above the plate."""

    curve: Outline
    beside: np.ndarray
    height: Metres

    def turned(self, angle: Radians) -> "View":
        """The same, turned counter-clockwise."""
        cos, sin = np.cos(angle), np.sin(angle)
        turn = np.array([[cos, sin], [-sin, cos]])
        return View(self.curve @ turn, self.beside @ turn, self.height)


@dataclass(frozen=True)
class Joined:
    """What several views show together, at :data:`AZIMUTHS` (A) equally spaced azimuths.

    Attributes:
        used: which views agree, in order; the others are left out.
        turned: counter-clockwise from the first view, rad, of the drape in each view; taken back.
        radius: (A,) m, of the outline from the axis at the height of the first used.
        seen: (A,) m, the same outline about as that view shows it.
        error: (A,) m, standard deviation of ``radius``.
        parted: where, rad, and over which share of the azimuth the only two that are used
            contradict each other; None if they do not.
    """

    used: list[int]
    turned: list[Radians]
    radius: np.ndarray
    seen: np.ndarray
    error: np.ndarray
    parted: tuple[Radians, float] | None


def join(views: Sequence[View], rig: Rig) -> Joined:
    """Join two or more views; of a rectangle, the x-axis is along its first side in the first."""
    overhang = rig.border(_AZIMUTH) - rig.plate_radius
    moved, error = _moved(views, rig)
    turned = [0.0] * len(views)
    for k in range(1, len(views)):
        # The plate may have been turned: as far as brings the shapes of the outlines together.
        off = np.abs(moved[k][_TURNS] - moved[0] - (moved[k] - moved[0]).mean())
        apart = off.mean(axis=1)
        best = int(apart.argmin())
        unlike = (off[[0, best]] > _UNLIKE * np.hypot(error[0], error[k].max())).mean(axis=1)
        if unlike[0] > MAX_PARTED and unlike[1] <= MAX_UNLIKE and apart[best] < _TURNED * apart[0]:
            turned[k] = float((_AZIMUTH[best] + np.pi) % (2 * np.pi) - np.pi)
    if any(turned):
        views = [view.turned(-angle) for view, angle in zip(views, turned, strict=True)]
        moved, error = _moved(views, rig)
    height = np.array([[view.height] for view in views])
    # Pictures from different heights show how deep the hem hangs.
    tried = [(moved * (1 + depth * overhang / height), depth) for depth in _DEPTHS]
    cost = [float(np.log1p(np.square((hems - _robust_mean(hems, error)) / error)).mean()
                  + np.square((depth - _DEPTH) / _DEPTH_ERROR) / AZIMUTHS) for hems, depth in tried]
    hems, share = tried[int(np.argmin(cost))]
    depth = share * overhang
    error = np.hypot(error, _DEPTH_LEFT * overhang * moved * np.abs(1 / height - 1 / height[0]))
    used = list(range(len(views)))
    while True:
        hem = _robust_mean(hems[used], error[used])
        unlike = (np.abs(hems[used] - hem) > _UNLIKE * error[used]).mean(axis=1)
        if len(used) == 2 or unlike.max() <= MAX_UNLIKE:
            break
        used.pop(int(unlike.argmax()))
    first, hems, error = views[used[0]], hems[used], error[used]
    parted = None
    if len(used) == 2:
        apart = np.abs(hems[1] - hems[0]) > _UNLIKE * np.hypot(*error)
        if (share := float(apart.mean())) > MAX_PARTED:
            parted = float(np.angle(apart @ np.exp(1j * _AZIMUTH))), share
    weight = 1 / np.square(error)
    differing = np.average(np.square(hems - hem), axis=0, weights=weight) / (len(used) - 1)
    below = first.height + depth
    shown = (hem * first.height / below)[:, None] * OUTWARDS + (depth / below)[:, None] * (
        first.beside)
    return Joined(used, turned, hem * first.height / below, farthest(closed(shown), AZIMUTHS),
                  np.sqrt(1 / weight.sum(axis=0) + differing), parted)


def _moved(views: Sequence[View], rig: Rig) -> tuple[np.ndarray, np.ndarray]:
    """Radii (K, A), m, as the network moves each view to the axis, and their errors."""
    moved = np.array([farthest(closed(seen_from_axis(*view, rig)), AZIMUTHS) for view in views])
    lean = np.array([[np.linalg.norm(view.beside) / view.height] for view in views])
    overhang = rig.border(_AZIMUTH) - rig.plate_radius
    hanging = np.exp(-np.maximum(moved - rig.plate_radius, 0) / overhang / _HANGING)
    return moved, _READ + lean * overhang * (_MOVED + _HIDDEN * hanging)


def _robust_mean(values: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Mean (A,) of values (K, A) with errors (K, A); those that differ count less."""
    weight = start = 1 / np.square(error)
    for _ in range(_ROUNDS):
        mean = (weight * values).sum(axis=0) / weight.sum(axis=0)
        weight = start / (1 + np.square((values - mean) / (_ROBUST * error)))
    return mean
