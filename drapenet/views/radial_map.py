"""Map of a drape from all views of a capture, independent of the camera.

Seen from a point on the axis, below the plate, a drape is nearly star-shaped: it is described by
its distance as a function of azimuth and elevation, into which all views are fused. The camera's
pose is estimated from the plate (:func:`drapenet.views.pose.locate_camera`), the turns of the
table from the overlap of views.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter

from data.render.cameras import Camera
from sim.rig import Rig

AZIMUTHS, ELEVATIONS = 128, 48
_UNDER = 0.9  # of the plate's radius, smallest radius of hanging cloth in the map
_DEPTH = 0.6  # of the map's centre below the plate, in overhangs
_MIN_FACING = 0.15  # minimum cosine in the weight of a pixel
PIXEL = 1.73e-3
"""m, size of a pixel of the rig's camera on the plate, the unit of weights."""
MAX_TURN_ERROR = np.radians(6.0)
"""rad, of the table in a view: 2.5 standard deviations of the training captures."""
_LENGTH_BIAS = (-0.02, 0.01)  # m, range of the bias of the length from rim to hem
_MAX_LENGTH_ERROR = 0.02  # m, at which the cost of a length error saturates
SIGMAS = (0.7, 1.5, 4.0, 12.0)  # cells, of the successive Gaussians that fill gaps

# Registration of views with each other, in cells of one degree:
_DEGREES, _ROWS = 360, 24
_HANGING = 17  # rows that exclude the rim, where all drapes are similar
_MAX_TURN_STEPS = 12  # degrees, range of the search for a turn's error
_TURN = 4.0  # degrees, its standard deviation
_SHIFT = 2.5e-3  # m, standard deviation of the plate's estimated centre
CENTRE_BIAS = 2.0e-3
"""m, bias of the plate's estimated centre towards the camera: cloth bends down over the rim, and
more of it is visible on the camera's side."""
_GAP, _MAX_GAP = 1.5e-3, 6e-3  # m, between views of the same cloth: standard deviation; cut-off
_MIN_COMMON_CELLS = 60  # for a comparison of two views
_INDEPENDENT = 20.0  # number of independent cells of a pair
_ROUNDS = 3


@dataclass(frozen=True)
class DrapeMap:
    """Distance of a captured drape by direction from a point on its axis.

    Attributes:
        distance: (AZIMUTHS, ELEVATIONS) m, gaps filled from their neighbours. Azimuths run
            counter-clockwise from ``zero``, rows from the lowest up.
        weight: (AZIMUTHS, ELEVATIONS) weighted number of pixels in each direction, in pixels of the
            reference camera; 0 in gaps.
        zero: direction of azimuth 0 in the first view, rad.
        turns: (K,) rad, estimated turn of the table in each view.
        centre: (2,) m, of the plate in the camera's plate axes, from the registration of views.
    """

    distance: np.ndarray
    weight: np.ndarray
    zero: float
    turns: np.ndarray
    centre: np.ndarray


def centre_height(rig: Rig) -> float:
    """Height, m, of the map's centre relative to the plate, negative."""
    return -_DEPTH * (rig.specimen_size - rig.plate_diameter) / 2


def elevations(rig: Rig) -> np.ndarray:
    """(ELEVATIONS + 1,) borders of the map's rows, rad: from the lowest possible hem to the plate's
    rim.
    """
    depth = -centre_height(rig)
    return np.linspace(np.arctan2(depth - rig.overhang, _UNDER * rig.plate_radius),
                       np.arctan2(depth, rig.plate_radius), ELEVATIONS + 1)


def drape_map(
    views: np.ndarray, camera: Camera, rig: Rig, *, turns: np.ndarray | None = None,
    zero: float | None = None,
) -> DrapeMap:
    """Fuse the views of one capture.

    Args:
        views: (K, H, W) z-depth, m, background 0.
        camera: of all of them, with its pose relative to the plate
            (:func:`drapenet.views.pose.locate_camera`).
        turns: (K,) rad, nominal turns of the table; None: multiples of 2 pi/K. Actual turns are
            estimated from the overlap of views.
        zero: direction of azimuth 0 in the first view, rad, such as that of the warp; None: that of
            a square's side, in [0, pi/2).
    """
    count = len(views)
    turns = np.arange(count) * (2 * np.pi / count) if turns is None else np.asarray(turns, float)
    clouds = [camera.cloth_points(view) for view in views]
    centre = np.array([0.0, CENTRE_BIAS])
    if count > 1:
        turns, centre = _registered(clouds, turns, rig)
    clouds = [cloud - [*centre, 0] for cloud in clouds]
    if zero is None:
        zero = 0.0 if rig.specimen == "disc" else side_direction(
            *fused(clouds, turns, rig), rig)
    distance, weight = fused(clouds, turns + zero, rig)
    pixel = np.linalg.norm(camera.world_to_camera[:3, 3]) / camera.fx
    return DrapeMap(distance, weight * (pixel / PIXEL) ** 2, zero, turns, centre)


def drape_coefficient(found: DrapeMap, rig: Rig) -> float:
    """Drape coefficient of a capture, from 0 to 1 (:func:`sim.measures.drape_coefficient`); NaN if
    less than half of the outline is visible.
    """
    borders = elevations(rig)
    flat = found.distance * np.cos((borders[1:] + borders[:-1]) / 2)
    radius = np.where(found.weight > 0, flat, 0.0).max(axis=1)
    seen = np.flatnonzero(radius > 0)
    if len(seen) < AZIMUTHS / 2:
        return np.nan
    # Centres of border pixels are half a pixel inside the hem.
    radius = np.interp(np.arange(AZIMUTHS), seen, radius[seen], period=AZIMUTHS) + PIXEL / 2
    plate = np.pi * rig.plate_radius**2
    area = np.pi * np.square(np.maximum(radius, rig.plate_radius)).mean()
    return float((area - plate) / (rig.specimen_area - plate))


def turn_doubts(turns: np.ndarray, nominal: np.ndarray) -> list[str]:
    """One line for each of the table's turns (K,), rad, that differs from the ``nominal`` one."""
    return [f"the table was turned by {np.degrees(turn):.0f}° in view {k}, not by "
            f"{np.degrees(given):.0f}°: the estimate may be wrong; take the views again"
            for k, (turn, given) in enumerate(zip(turns, nominal, strict=True))
            if not abs(turn - given) < MAX_TURN_ERROR]


def side_direction(distance: np.ndarray, weight: np.ndarray, rig: Rig) -> float:
    """Direction of a square specimen's side, in [0, pi/2) rad from azimuth 0.

    The length of cloth from rim to hem is that of the flat specimen, longest towards the four
    corners; the direction minimises the error of these lengths. Arguments as in :class:`DrapeMap`.
    """
    borders = elevations(rig)
    height = (borders[1:] + borders[:-1]) / 2
    radius, up = distance * np.cos(height), distance * np.sin(height)
    steps = np.hypot(np.diff(radius, axis=1), np.diff(up, axis=1))
    seen = weight > 0
    hem = np.where(seen.any(axis=1), seen.argmax(axis=1), ELEVATIONS)
    below = np.arange(ELEVATIONS) >= hem[:, None]
    lengths = (steps * below[:, :-1]).sum(axis=1)
    # Lengths are unreliable where little of a line is visible.
    trust = ((seen & below).sum(axis=1) / np.maximum(below.sum(axis=1), 1)) ** 2 + 1e-3
    azimuth = 2 * np.pi * (np.arange(AZIMUTHS) + 0.5) / AZIMUTHS
    sides = np.radians(np.arange(0.0, 90.0))
    direction = azimuth - sides[:, None]
    flat = rig.specimen_size / 2 / np.maximum(np.abs(np.cos(direction)), np.abs(np.sin(direction)))
    gap = lengths - (flat - rig.plate_radius)
    # Correct the common bias of the hem; the cost saturates for outliers of single folds.
    gap -= np.clip(np.median(gap, axis=1, keepdims=True), *_LENGTH_BIAS)
    return float(sides[(trust * np.minimum(np.abs(gap), _MAX_LENGTH_ERROR)).sum(axis=1).argmin()])


def disagreement(clouds: list[np.ndarray], turns: np.ndarray, rig: Rig) -> float:
    """Root mean square difference, m, between views of the same hanging cloth after registration
    that starts from ``turns`` of the table, (K,) rad; NaN if the overlap is too small.

    Args:
        clouds: points of each view, (N, 3) m in the camera's plate axes.
    """
    if len(clouds) < 2:
        return np.nan
    turns, centre = _registered(clouds, turns, rig)
    maps = _distances(clouds, centre, turns, rig)[..., :_HANGING]
    often = np.isfinite(maps).sum(axis=0)
    gap = np.abs(maps - np.nansum(maps, axis=0) / np.maximum(often, 1))[:, often > 1]
    gap = gap[np.isfinite(gap)]
    if len(gap) <= _MIN_COMMON_CELLS:
        return np.nan
    return float(np.sqrt(np.square(np.minimum(gap, _MAX_GAP)).mean()))


def fused(
    clouds: list[np.ndarray], turns: np.ndarray, rig: Rig
) -> tuple[np.ndarray, np.ndarray]:
    """Distances, gaps filled, and weights of a map from the points of all views, (N, 3) m each, in
    the plate's axes; ``turns``: (K,) rad.
    """
    total, weight = np.zeros((2, AZIMUTHS, ELEVATIONS))
    for cloud, turn in zip(clouds, turns, strict=True):
        sums, part = _binned(cloud, turn, rig, AZIMUTHS, ELEVATIONS)
        total += sums
        weight += part
    return _filled(total / np.maximum(weight, 1e-12), weight > 0), weight


def _binned(
    points: np.ndarray, turn: float, rig: Rig, columns: int, rows: int
) -> tuple[np.ndarray, np.ndarray]:
    """Sums (columns, rows) of weighted distances and of weights of one view's points."""
    radius, height = np.hypot(points[:, 0], points[:, 1]), points[:, 2] - centre_height(rig)
    low, *_, high = elevations(rig)
    row = (np.arctan2(height, radius) - low) * (rows / (high - low))
    inside = (row >= 0) & (row < rows)
    azimuth = np.arctan2(points[inside, 1], points[inside, 0])
    column = np.floor((azimuth - turn) * (columns / (2 * np.pi))).astype(int) % columns
    cell = column * rows + row[inside].astype(int)
    facing = np.maximum(-np.sin(azimuth), _MIN_FACING) ** 2  # the camera is at -y
    distance = np.hypot(radius[inside], height[inside])
    return tuple(np.bincount(cell, values, minlength=columns * rows).reshape(columns, rows)
                 for values in (facing * distance, facing))


def _registered(
    clouds: list[np.ndarray], turns: np.ndarray, rig: Rig
) -> tuple[np.ndarray, np.ndarray]:
    """Turns of the table (K,), the first as given, and the plate's centre (2,), m, in the clouds.

    Turns are first estimated in whole degrees from the overlap of adjacent views, then refined
    together with the centre by least squares.
    """
    shift = np.array([0.0, CENTRE_BIAS])
    start = turns = turns + np.radians(_whole_degrees(_distances(clouds, shift, turns, rig)))
    for _ in range(_ROUNDS):
        maps = _distances(clouds, shift, turns, rig)
        so_far = np.concatenate([shift - [0, CENTRE_BIAS], turns - start])
        change = _least_squares(maps, turns, so_far, rig)
        shift, turns = shift + change[:2], turns + change[2:]
    return turns, shift


def _distances(
    clouds: list[np.ndarray], shift: np.ndarray, turns: np.ndarray, rig: Rig
) -> np.ndarray:
    """(K, _DEGREES, _ROWS) mean distance, m, of each view's points from the map's centre at
    ``shift`` (2,), m; NaN in empty cells.
    """
    total, weight = np.stack([_binned(cloud - [*shift, 0.0], turn, rig, _DEGREES, _ROWS)
                              for cloud, turn in zip(clouds, turns, strict=True)], axis=1)
    return np.where(weight > 0, total / np.where(weight > 0, weight, 1), np.nan)


def _whole_degrees(maps: np.ndarray) -> np.ndarray:
    """Corrections (K,), degrees, of all turns but the first, that minimise the misfit of adjacent
    views, by dynamic programming.
    """
    count = len(maps)
    steps = np.arange(-_MAX_TURN_STEPS, _MAX_TURN_STEPS + 1)
    prior = 0.5 * (steps / _TURN) ** 2
    # Cost of each difference of two corrections, within ±2 _MAX_TURN_STEPS.
    pairs = [_costs(maps[k], maps[(k + 1) % count]) for k in range(count if count > 2 else 1)]
    difference = steps[None, :] - steps[:, None] + 2 * _MAX_TURN_STEPS
    cost, choices = pairs[0][steps + 2 * _MAX_TURN_STEPS] + prior, []
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


def _costs(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(4 _MAX_TURN_STEPS + 1,) misfit of two maps by turn of the second, degrees."""
    costs = []
    for degrees in range(-2 * _MAX_TURN_STEPS, 2 * _MAX_TURN_STEPS + 1):
        gap = np.abs(np.roll(other, -degrees, axis=0) - one)
        gap = gap[np.isfinite(gap)]
        mean = (np.minimum(gap, _MAX_GAP) ** 2).mean() if len(gap) > _MIN_COMMON_CELLS else _GAP**2
        costs.append(0.5 * _INDEPENDENT * mean / _GAP**2)
    return np.array(costs)


def _least_squares(
    maps: np.ndarray, turns: np.ndarray, so_far: np.ndarray, rig: Rig
) -> np.ndarray:
    """Gauss-Newton step (2 + K,) of centre, m, and turns, rad, for the misfit of all views.

    A move v of a view's points changes the distance in direction u by n·v / n·u, where n is the
    surface normal of the mean map.

    Args:
        so_far: (2 + K,) present deviations from the expected values.
    """
    seen = np.isfinite(maps)
    often = seen.sum(axis=0)
    # NaN in cells without cloth and for slopes beside them.
    mean = np.where(seen, maps, 0.0).sum(axis=0) / np.where(often > 0, often, np.nan)
    borders = elevations(rig)
    height = np.linspace(borders[0], borders[-1], 2 * _ROWS + 1)[1::2]
    azimuth = np.radians(np.arange(_DEGREES) + 0.5)
    by_azimuth = (np.roll(mean, -2, axis=0) - np.roll(mean, 2, axis=0)) / np.radians(4.0)
    by_height = np.gradient(mean, height, axis=1)
    outward = np.cos(height) + np.sin(height) * by_height / mean
    around = -by_azimuth / mean / np.cos(height)
    c, s = np.cos(azimuth)[:, None], np.sin(azimuth)[:, None]
    by_x, by_y = outward * c - around * s, outward * s + around * c
    count = len(maps)
    columns = np.zeros((count, 2 + count, *mean.shape))
    for k, turn in enumerate(turns):
        # A move of the centre moves the points backwards, in the specimen's rotated axes.
        columns[k, 0] = -(np.cos(turn) * by_x - np.sin(turn) * by_y)
        columns[k, 1] = -(np.sin(turn) * by_x + np.cos(turn) * by_y)
        columns[k, 2 + k] = by_azimuth
    gaps = np.where(seen & (often > 1), maps - mean, 0.0)
    columns = np.where(seen[:, None], columns, 0.0)
    columns = columns - columns.sum(axis=0) / np.maximum(often, 1)
    used = seen & (often > 1) & np.isfinite(columns).all(axis=1)
    rows = columns.transpose(1, 0, 2, 3)[:, used]
    weights = 1 / (1 + (gaps[used] / _GAP) ** 2)
    weights *= _INDEPENDENT * count / max(len(weights), 1) / _GAP**2
    sigma = np.r_[[_SHIFT] * 2, [1e-6], [np.radians(_TURN)] * (count - 1)]
    normal = (rows * weights) @ rows.T + np.diag(1 / sigma**2)
    return -np.linalg.solve(normal, (rows * weights) @ gaps[used] + so_far / sigma**2)


def _filled(mean: np.ndarray, known: np.ndarray) -> np.ndarray:
    """The map with gaps filled by Gaussians of increasing width."""
    filled, gaps = np.where(known, mean, 0.0), ~known
    for sigma in SIGMAS:
        weight = gaussian_filter(known.astype(float), sigma, mode=("wrap", "nearest"))
        smooth = gaussian_filter(np.where(known, mean, 0.0), sigma, mode=("wrap", "nearest"))
        now = gaps & (weight > 0.05)
        filled[now] = smooth[now] / weight[now]
        gaps &= ~now
    filled[gaps] = mean[known].mean() if known.any() else 0.0
    return filled
