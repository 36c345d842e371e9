"""Turns of the table and the plate's centre, from the overlap of views in cells of one degree."""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from common.types import Points, Turns
from drapenet.views.directions import Polar, elevations
from sim.rig import Rig

CENTRE_BIAS = 2.0e-3
"""m, of the plate's estimated centre towards the camera, where more of the bent rim is visible."""
_DEGREES, _ROWS = 360, 24
_HANGING = 17  # rows that exclude the rim, where all drapes are similar
_MAX_TURN_STEPS = 12  # degrees, range of the search for a turn's error
_TURN = 4.0  # degrees, its standard deviation
_SHIFT = 2.5e-3  # m, standard deviation of the plate's estimated centre
_GAP, _MAX_GAP = 1.5e-3, 6e-3  # m, between views of the same cloth: standard deviation; cut-off
_MIN_COMMON_CELLS = 60  # for a comparison of two views
_INDEPENDENT = 20.0  # number of independent cells of a pair
_ROUNDS = 3


def register(clouds: list[Points], turns: Turns, rig: Rig) -> tuple[Turns, np.ndarray]:
    """Turns of the table, the first as stated, and the plate's centre (2,), m, in the clouds' axes:
    first turns in whole degrees, then both by least squares.
    """
    centre = np.array([0.0, CENTRE_BIAS])
    if len(clouds) == 1:
        return turns, centre
    seen = [Polar.of(cloud, centre, rig) for cloud in clouds]
    start = turns = turns + np.radians(_whole_degrees(_distances(seen, turns)))
    for k in range(_ROUNDS):
        if k:
            seen = [Polar.of(cloud, centre, rig) for cloud in clouds]
        maps = _distances(seen, turns)
        change = np.concatenate([centre - [0, CENTRE_BIAS], turns - start])
        step = _least_squares(maps, turns, change, rig)
        centre, turns = centre + step[:2], turns + step[2:]
    return turns, centre


def disagreement(clouds: list[Points], turns: Turns, centre: np.ndarray, rig: Rig) -> float:
    """RMS difference, m, of views registered with a centre (2,), m; NaN if they overlap too little.
    """
    if len(clouds) < 2:
        return np.nan
    seen = [Polar.of(cloud, centre, rig) for cloud in clouds]
    maps = _distances(seen, turns)[..., :_HANGING]
    often = np.isfinite(maps).sum(axis=0)
    gap = np.abs(maps - np.nansum(maps, axis=0) / np.maximum(often, 1))[:, often > 1]
    gap = gap[np.isfinite(gap)]
    if len(gap) <= _MIN_COMMON_CELLS:
        return np.nan
    return float(np.sqrt(np.square(np.minimum(gap, _MAX_GAP)).mean()))


def _distances(seen: list[Polar], turns: Turns) -> np.ndarray:
    """(K, _DEGREES, _ROWS) mean distance, m, of each view's points; NaN in empty cells."""
    total, weight = np.stack([view.binned(turn, _DEGREES, _ROWS)
                              for view, turn in zip(seen, turns, strict=True)], axis=1)
    return np.where(weight > 0, total / np.where(weight > 0, weight, 1), np.nan)


def _whole_degrees(maps: np.ndarray) -> np.ndarray:
    """Corrections (K,), degrees, of all turns but the first that minimise the misfit of adjacent
    views, by dynamic programming.
    """
    count = len(maps)
    steps = np.arange(-_MAX_TURN_STEPS, _MAX_TURN_STEPS + 1)
    prior = 0.5 * (steps / _TURN) ** 2
    # Cost of each difference of two corrections, within ±2 _MAX_TURN_STEPS.
    pairs = [_costs(maps[k], maps[(k + 1) % count]) for k in range(count if count > 2 else 1)]
    difference = steps[None, :] - steps[:, None] + 2 * _MAX_TURN_STEPS
    cost = pairs[0][steps + 2 * _MAX_TURN_STEPS] + prior
    choices = []
    for k in range(1, count - 1):
        table = cost[:, None] + pairs[k][difference]
        choices.append(table.argmin(axis=0))
        cost = table.min(axis=0) + prior
    if count > 2:
        cost = cost + pairs[-1][-steps + 2 * _MAX_TURN_STEPS]
    best = [int(cost.argmin())]
    for choice in reversed(choices):
        best.insert(0, int(choice[best[0]]))
    return np.concatenate([[0.0], steps[best].astype(float)])


def _costs(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(4 _MAX_TURN_STEPS + 1,) misfit of two maps by turn of the second, degrees."""
    squares, common = _gaps(first, second)
    mean = np.where(common > _MIN_COMMON_CELLS, squares / np.maximum(common, 1), _GAP**2)
    return 0.5 * _INDEPENDENT * mean / _GAP**2


def _gaps(first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sums (4 _MAX_TURN_STEPS + 1,) of squared gaps, m², cut off, and numbers of common cells."""
    most = 2 * _MAX_TURN_STEPS
    around = np.concatenate([second[-most:], second, second[:most]])
    filled = np.isfinite(first)
    # By cell and step; sums along the first axis add one cell after the other.
    gaps = sliding_window_view(around, 2 * most + 1, axis=0)[filled] - first[filled][:, None]
    np.minimum(np.abs(gaps, out=gaps), _MAX_GAP, out=gaps)
    common = np.isfinite(gaps)  # else the other cell is empty
    gaps[~common] = 0.0
    return np.square(gaps, out=gaps).sum(axis=0), common.sum(axis=0)


def _least_squares(maps: np.ndarray, turns: Turns, change: np.ndarray, rig: Rig) -> np.ndarray:
    """Gauss-Newton step (2 + K,) of centre and turns, after a ``change`` from the expected ones.

    A move v of a view's points changes the distance in direction u by n·v / n·u, where n is the
    surface normal of the mean map.
    """
    visible = np.isfinite(maps)
    often = visible.sum(axis=0)
    # NaN in cells without cloth and for slopes beside them.
    mean = np.where(visible, maps, 0.0).sum(axis=0) / np.where(often > 0, often, np.nan)
    borders = elevations(rig)
    height = np.linspace(borders[0], borders[-1], 2 * _ROWS + 1)[1::2]
    azimuth = np.radians(np.arange(_DEGREES) + 0.5)
    by_azimuth = (np.roll(mean, -2, axis=0) - np.roll(mean, 2, axis=0)) / np.radians(4.0)
    by_height = np.gradient(mean, height, axis=1)
    outward = np.cos(height) + np.sin(height) * by_height / mean
    around = -by_azimuth / mean / np.cos(height)
    c, s = np.cos(azimuth)[:, None], np.sin(azimuth)[:, None]
    by_x = outward * c - around * s
    by_y = outward * s + around * c
    used = (often > 1) & np.isfinite(by_x + by_y + by_azimuth)
    normal, slope = _normal_equations(maps[:, used], mean[used], by_x[used], by_y[used],
                                      by_azimuth[used], np.cos(turns), np.sin(turns))
    count = len(maps)
    scale = _INDEPENDENT * count / max(int(often[used].sum()), 1) / _GAP**2
    sigma = np.r_[[_SHIFT] * 2, [1e-6], [np.radians(_TURN)] * (count - 1)]
    return -np.linalg.solve(scale * normal + np.diag(1 / sigma**2),
                            scale * slope + change / sigma**2)


def _normal_equations(
    maps: np.ndarray, mean: np.ndarray, by_x: np.ndarray, by_y: np.ndarray, by_azimuth: np.ndarray,
    cosine: np.ndarray, sine: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Normal matrix (2 + K, 2 + K) and right-hand side (2 + K,) of the gaps of maps (K, N), NaN in
    empty cells, to their mean (N,) with its slopes (N,), by centre and turns."""
    count, seen = len(maps), np.isfinite(maps.T)
    rows = np.zeros((len(mean), count, 2 + count))
    # A move of the centre moves the points backwards, in the specimen's rotated axes.
    rows[:, :, 0] = -(cosine * by_x[:, None] - sine * by_y[:, None])
    rows[:, :, 1] = -(sine * by_x[:, None] + cosine * by_y[:, None])
    rows[:, range(count), range(2, 2 + count)] = by_azimuth[:, None]
    rows[~seen] = 0.0
    rows -= rows.sum(axis=1, keepdims=True) / seen.sum(axis=1)[:, None, None]
    rows, gaps = rows[seen], (maps.T - mean[:, None])[seen]
    own = rows * (1 / (1 + (gaps / _GAP) ** 2))[:, None]
    return (own[:, :, None] * rows[:, None, :]).sum(axis=0), (own * gaps[:, None]).sum(axis=0)
