"""Initial shapes of a drape, which determine the folds of the equilibrium (section 5.2.1)."""

from typing import Annotated

import numpy as np
from scipy.interpolate import CloughTocher2DInterpolator, LinearNDInterpolator
from scipy.optimize import brentq
from scipy.spatial import ConvexHull, QhullError

from common.arguments import numbers, wrong
from common.errors import InputError
from common.types import Metres, Points, RestPoints
from common.workers import one_blas_thread
from sim.mesh.specimen import share_of_offset
from sim.rig import Rig

STARTS = ("sine", "fold", "ring")
"""Random initial shapes; for a warm start from another drape see :func:`borrowed_positions`."""

LOWERED = "lowered"
"""The start by lowering (:mod:`sim.lowering`)."""

OtherRest = Annotated[np.ndarray, "(C, 2) float, m, rest points on another mesh"]
Borrowed = tuple[OtherRest, Annotated[np.ndarray, "(C, 3) float, m, positions on that mesh"]]

_RING_WAVES = (4, 15)  # range of the number of waves, end exclusive


def check_start(start: str, rig: Rig) -> None:
    """InputError unless ``start`` is a start of drapes on ``rig``."""
    if start not in (LOWERED, *STARTS):
        raise InputError(f"unknown start '{start}'; choose from {', '.join((LOWERED, *STARTS))}")
    if start != "sine" and not rig.has_plate:
        raise InputError(f"start={start} needs a plate, which {rig.name} lacks")


def initial_positions(
    rest: RestPoints, *, rig: Rig, start: str, rng: np.random.Generator
) -> Points:
    """Initial positions, flat on the plate; see :data:`STARTS`."""
    if not rig.has_plate:
        return _hung(rest, rig) + waves(rest, rig, rng, amplitude=5e-3)[:, [0, 2, 1]]
    if start == "sine":
        flat = np.column_stack([rest, np.zeros(len(rest))])
        return flat + waves(rest, rig, rng, amplitude=5e-3)
    shape = _fold if start == "fold" else _ring
    return shape(rest, rig, rng) + waves(rest, rig, rng, amplitude=1e-3)


def waves(
    rest: RestPoints, rig: Rig, rng: np.random.Generator, *, amplitude: Metres, count: int = 8
) -> Points:
    """Vertical displacements: random plane sine waves that vanish at the rim."""
    angle = rng.uniform(0, 2 * np.pi, count)
    wavelength = rng.uniform(0.06, 0.3, count)
    phase = rng.uniform(0, 2 * np.pi, count)
    direction = np.stack([np.cos(angle), np.sin(angle)])
    waves = np.sin(2 * np.pi * (rest @ direction) / wavelength + phase).sum(1) / np.sqrt(count)
    fade = 1.0 - np.exp(-rig.to_plate(rest) / (0.2 * rig.specimen_size / 2))
    height = amplitude * fade * waves
    return np.column_stack([np.zeros_like(rest), height])


def _fold(rest: RestPoints, rig: Rig, rng: np.random.Generator) -> np.ndarray:
    """The specimen bent down on both sides of the plate, in a random direction: beyond the plate
    a circular arc of up to a quarter turn, then straight, without stretch or intersection."""
    angle = rng.uniform(0, np.pi)
    bend = 0.02 * rng.uniform(0.7, 1.5)  # m, radius of the arc
    turn = rng.uniform(0.5, 0.95) * np.pi / 2
    across = np.array([np.cos(angle), np.sin(angle)])
    along = np.array([-across[1], across[0]])
    s, t = rest @ across, rest @ along
    radius = rig.sharp.plate_radius
    arc = np.maximum(np.abs(s) - radius, 0.0)
    theta = np.minimum(arc / bend, turn)
    straight = np.maximum(arc - bend * turn, 0.0)
    reach = np.minimum(np.abs(s), radius) + bend * np.sin(theta)
    reach += straight * np.cos(turn)
    drop = bend * (1 - np.cos(theta)) + straight * np.sin(turn)
    return np.column_stack([(np.sign(s) * reach)[:, None] * across + t[:, None] * along, -drop])


def _ring(rest: RestPoints, rig: Rig, rng: np.random.Generator) -> np.ndarray:
    """Waves around the plate, as of cloth lowered evenly. Their number is preserved where an
    equilibrium with it exists."""
    waves, phase = rng.integers(*_RING_WAVES), rng.uniform(0, 2 * np.pi)
    angle = np.arctan2(rest[:, 1], rest[:, 0])
    height = rig.to_plate(rest) * (0.25 * np.cos(waves * angle + phase) - 0.5)
    return np.column_stack([rest, height])


def _hung(rest: RestPoints, rig: Rig) -> np.ndarray:
    """A rectangle held at its upper corners, its rows bent to circular arcs between them."""
    width, height = rig.sides
    assert rig.corners_apart, "without a plate corners hold a specimen"
    chord = rig.corners_apart / width
    turn = brentq(lambda t: np.sin(t) / t - chord, 1e-6, np.pi)
    radius = width / 2 / turn
    angle = rest[:, 0] / radius
    sag = radius * (np.cos(angle) - np.cos(turn))
    return np.column_stack([radius * np.sin(angle), -sag, rest[:, 1] - height / 2])


def borrowed_positions(
    rest: RestPoints, *, rig: Rig, borrowed: Borrowed
) -> Points:
    """Positions interpolated from rest points and positions of another fabric's drape on ``rig``.
    If the offsets of the specimens differ, points on the plate correspond to points on the plate,
    the border to the border, and points between are shifted in proportion."""
    try:
        other_rest, other_positions = borrowed
        count = len(other_rest)
    except (TypeError, ValueError):
        raise wrong("borrowed", borrowed, "(near.rest, near.positions) of a drape") from None
    other_positions = numbers("positions", other_positions, f"finite positions ({count}, 3), m",
                              (count, 3))
    try:
        area = ConvexHull(other_rest).volume
    except (QhullError, ValueError):
        area = 0.0
    if abs(area / rig.specimen_area - 1) > 0.03:
        raise InputError(f"the borrowed drape's specimen measures {1e4 * area:.0f} cm², that of "
                         f"{rig.name} {1e4 * rig.specimen_area:.0f} cm²")
    centre, other_centre = (0.5 * (r.min(0) + r.max(0)) for r in (rest, other_rest))
    share = share_of_offset(rest, rig, centre)
    return interpolate_positions(other_rest, other_positions,
                                 rest + share[:, None] * (other_centre - centre))


@one_blas_thread
def interpolate_positions(
    coarse_rest: OtherRest, coarse_positions: np.ndarray, rest: RestPoints, *, smooth: bool = True
) -> np.ndarray:
    """Positions (V, n) of rest points on a ``smooth`` surface through those, (C, n), m, of the same
    specimen on a coarser mesh, or on its triangles, beyond which folds as narrow as a triangle do
    not swing. Other numbers of the vertices are interpolated like their n = 3 coordinates."""
    surface = (CloughTocher2DInterpolator if smooth else LinearNDInterpolator)(
        coarse_rest, coarse_positions)
    centre = (coarse_rest.min(0) + coarse_rest.max(0)) / 2
    inward = centre + (rest - centre) * (1 - 1e-9)  # keeps the border inside the hull
    positions = surface(inward)
    outside = np.isnan(positions[:, 0])
    if outside.any():
        positions[outside] = _beyond_border(surface, coarse_rest, centre, inward[outside])
    return positions


def _beyond_border(
    surface: CloughTocher2DInterpolator | LinearNDInterpolator, rest: np.ndarray,
    centre: np.ndarray, points: np.ndarray
) -> np.ndarray:
    """Linear extrapolation (N, 3) of ``surface`` to points (N, 2) outside the hull of ``rest``:
    the border of a disc has more corners on a finer mesh, some of them outside."""
    equations = ConvexHull(rest).equations
    ray = points - centre
    rise = ray @ equations[:, :2].T
    room = -(centre @ equations[:, :2].T + equations[:, 2])
    crossing = np.where(rise > 0, room / np.where(rise > 0, rise, 1.0), np.inf).min(axis=1)
    last = (crossing * (1 - 1e-6))[:, None]
    before = 0.98 * last
    at_last, at_before = surface(centre + last * ray), surface(centre + before * ray)
    return at_last + (at_last - at_before) * ((1 - last) / (last - before))
