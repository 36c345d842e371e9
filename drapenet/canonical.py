"""One map of a drape from all views of a capture, whatever camera took them.

Pixels of different views have nothing to do with each other, and those of one view change with the
camera. Seen from a point on the axis, below the plate, a drape is nearly star-shaped: so its
distance by azimuth and elevation describes it, and all views add to one map. Where the camera
stood is taken from the plate (:func:`drapenet.registration.locate_camera`), how far the table
turned from what two views see of the same cloth.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter

from data.cameras import Camera
from sim.scene import Rig

AZIMUTHS, ELEVATIONS = 128, 48
_UNDER = 0.9  # of the plate's radius, where cloth that hangs straight down is looked for
_DEPTH = 0.6  # of the point that the drape is seen from below the plate, in overhangs
_MIN_FACING = 0.15  # least weight of a pixel, relative to one that faces the camera
PIXEL = 1.73e-3
"""m, what a pixel spans on the plate, seen by the rig's camera: weights count such pixels."""
MAX_TURN_ERROR = np.radians(6.0)
"""rad, of the table in a view: two and a half deviations of what the network is trained on."""
_LENGTH_BIAS = (-0.02, 0.01)  # m, by which the cloth from rim to hem may seem longer than it is
_MAX_LENGTH_ERROR = 0.02  # m, beyond which such a length is no worse
SIGMAS = (0.7, 1.5, 4.0, 12.0)  # cells over which gaps are filled, one after the other

# How views are registered with each other, in cells of one degree:
_DEGREES, _ROWS = 360, 24
_HANGING = 17  # rows below the rim, where all drapes are alike
_MAX_TURN_STEPS = 12  # degrees, largest error of the table's turn that is looked for
_TURN = 4.0  # degrees, its standard deviation
_SHIFT = 2.5e-3  # m, standard deviation of the plate's centre as located
CENTRE_BIAS = 2.0e-3
"""m, by which the plate is located too near: cloth bends down over the rim, more of it is seen on
the camera's side."""
_GAP, _MAX_GAP = 1.5e-3, 6e-3  # m, between two views of the same cloth: usual; beyond, not so
_MIN_COMMON_CELLS = 60  # cells that two views must share to be compared
_INDEPENDENT = 20.0  # cells of a pair that count as independent
_ROUNDS = 3


@dataclass(frozen=True)
class DrapeMap:
    """What a capture shows of a drape, by direction from a point on its axis.

    Attributes:
        distance: (AZIMUTHS, ELEVATIONS) m, gaps filled from their neighbours. Azimuths run
            counter-clockwise from ``zero``, rows from the lowest up.
        weight: (AZIMUTHS, ELEVATIONS) of the pixels in each direction, as many as the reference
            camera would have there; 0 in gaps.
        zero: direction of azimuth 0 in the first view, rad.
        turns: (K,) rad, how far the table had turned in each view.
        centre: (2,) m, of the plate in the camera's plate axes, as the views agree on it.
    """

    distance: np.ndarray
    weight: np.ndarray
    zero: float
    turns: np.ndarray
    centre: np.ndarray


def centre_height(rig: Rig) -> float:
    """Height, m, below the plate (negative), of the point that a drape on ``rig`` is seen from."""
    return -_DEPTH * (rig.specimen_size - rig.plate_diameter) / 2


def elevations(rig: Rig) -> np.ndarray:
    """(ELEVATIONS + 1,) borders of the map's rows, rad: from the lowest that a hem can be to the
    plate's rim.
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
            (:func:`drapenet.registration.locate_camera`).
        turns: (K,) rad, nominal ones of the table; None: whole K-ths of a turn. What it really
            turned is measured where views overlap.
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
    """Share of the overhanging cloth that is seen from above, as a capture shows it
    (:func:`sim.measures.drape_coefficient`); NaN where less than half of the outline is seen.
    """
    borders = elevations(rig)
    flat = found.distance * np.cos((borders[1:] + borders[:-1]) / 2)
    radius = np.where(found.weight > 0, flat, 0.0).max(axis=1)
    seen = np.flatnonzero(radius > 0)
    if len(seen) < AZIMUTHS / 2:
        return np.nan
    # A pixel's centre lies half a pixel within the hem that it shows.
    radius = np.interp(np.arange(AZIMUTHS), seen, radius[seen], period=AZIMUTHS) + PIXEL / 2
    plate = np.pi * rig.plate_radius**2
    area = np.pi * np.square(np.maximum(radius, rig.plate_radius)).mean()
    return float((area - plate) / (rig.specimen_area - plate))


def turn_doubts(turns: np.ndarray, nominal: np.ndarray) -> list[str]:
    """What to say, a line each, of turns (K,) of the table, rad, unlike the ``nominal`` ones."""
    return [f"the table was turned by {np.degrees(turn):.0f}° in view {k}, not by "
            f"{np.degrees(given):.0f}°: the estimate may be wrong; take the views again"
            for k, (turn, given) in enumerate(zip(turns, nominal, strict=True))
            if not abs(turn - given) < MAX_TURN_ERROR]


def side_direction(distance: np.ndarray, weight: np.ndarray, rig: Rig) -> float:
    """Direction of a square specimen's side, in [0, pi/2) rad from azimuth 0.

    From the rim to the hem the cloth is as long as it is flat, however it hangs: longest towards
    the four corners. Arguments are :class:`DrapeMap`'s.
    """
    borders = elevations(rig)
    height = (borders[1:] + borders[:-1]) / 2
    radius, up = distance * np.cos(height), distance * np.sin(height)
    steps = np.hypot(np.diff(radius, axis=1), np.diff(up, axis=1))
    seen = weight > 0
    hem = np.where(seen.any(axis=1), seen.argmax(axis=1), ELEVATIONS)
    below = np.arange(ELEVATIONS) >= hem[:, None]
    lengths = (steps * below[:, :-1]).sum(axis=1)
    # Where little of a line was seen, its length is a guess.
    trust = ((seen & below).sum(axis=1) / np.maximum(below.sum(axis=1), 1)) ** 2 + 1e-3
    azimuth = 2 * np.pi * (np.arange(AZIMUTHS) + 0.5) / AZIMUTHS
    sides = np.radians(np.arange(0.0, 90.0))
    direction = azimuth - sides[:, None]
    flat = rig.specimen_size / 2 / np.maximum(np.abs(np.cos(direction)), np.abs(np.sin(direction)))
    gap = lengths - (flat - rig.plate_radius)
    # The hem is seen a little short, everywhere alike; one fold seen wrongly must not decide.
    gap -= np.clip(np.median(gap, axis=1, keepdims=True), *_LENGTH_BIAS)
    return float(sides[(trust * np.minimum(np.abs(gap), _MAX_LENGTH_ERROR)).sum(axis=1).argmin()])


def disagreement(clouds: list[np.ndarray], turns: np.ndarray, rig: Rig) -> float:
    """Root mean square of the differences, m, between what views show of the same hanging cloth,
    registered from these turns of the table, (K,) rad; NaN where they share little.

    Args:
        clouds: of each view, (N, 3) m in the camera's plate axes.
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
    """Distances, without gaps, and weights of all views' points together, (N, 3) m of each, in the
    plate's axes; ``turns``: (K,) rad.
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
    facing = np.maximum(-np.sin(azimuth), _MIN_FACING) ** 2  # the camera stands at -y
    distance = np.hypot(radius[inside], height[inside])
    return tuple(np.bincount(cell, values, minlength=columns * rows).reshape(columns, rows)
                 for values in (facing * distance, facing))


def _registered(
    clouds: list[np.ndarray], turns: np.ndarray, rig: Rig
) -> tuple[np.ndarray, np.ndarray]:
    """The table's turns (K,), the first as given, and the plate's centre (2,), m, in the clouds.

    First the turns alone, in whole degrees, from what neighbours in the circle have in common;
    then both together, by least squares.
    """
    shift = np.array([0.0, CENTRE_BIAS])
    start = turns = turns + np.radians(_whole_degrees(_distances(clouds, shift, turns, rig)))
    for _ in range(_ROUNDS):
        maps = _distances(clouds, shift, turns, rig)
        change = _least_squares(maps, turns, np.concatenate([shift - [0, CENTRE_BIAS], turns - start]),
                                rig)
        shift, turns = shift + change[:2], turns + change[2:]
    return turns, shift


def _distances(
    clouds: list[np.ndarray], shift: np.ndarray, turns: np.ndarray, rig: Rig
) -> np.ndarray:
    """(K, _DEGREES, _ROWS) mean distance of each view's points from the axis at ``shift`` (2,), m;
    NaN where it sees none.
    """
    total, weight = np.stack([_binned(cloud - [*shift, 0.0], turn, rig, _DEGREES, _ROWS)
                              for cloud, turn in zip(clouds, turns, strict=True)], axis=1)
    return np.where(weight > 0, total / np.where(weight > 0, weight, 1), np.nan)


def _whole_degrees(maps: np.ndarray) -> np.ndarray:
    """Corrections (K,), degrees, of all turns but the first, that make neighbours agree best."""
    count = len(maps)
    steps = np.arange(-_MAX_TURN_STEPS, _MAX_TURN_STEPS + 1)
    prior = 0.5 * (steps / _TURN) ** 2
    # Cost of each difference of two corrections, from -2 to 2 reaches.
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
    """(4 _MAX_TURN_STEPS + 1,) misfit of two maps with the second turned on by -2 to 2 reaches."""
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
    """Change (2 + K,) of centre, m, and turns, rad, that makes all views agree better.

    A view's points moved by v change its distance in a direction u by n·v/n·u, with the surface's
    normal n, which the mean map has.

    Args:
        so_far: (2 + K,) what was changed already, from its expectation.
    """
    seen = np.isfinite(maps)
    often = seen.sum(axis=0)
    # NaN where no view sees cloth, and so are slopes next to it.
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
        # Taking the centre further on moves the points back, in the specimen's axes turned back.
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
    """The map with its gaps filled from wider and wider neighbourhoods."""
    filled, gaps = np.where(known, mean, 0.0), ~known
    for sigma in SIGMAS:
        weight = gaussian_filter(known.astype(float), sigma, mode=("wrap", "nearest"))
        smooth = gaussian_filter(np.where(known, mean, 0.0), sigma, mode=("wrap", "nearest"))
        now = gaps & (weight > 0.05)
        filled[now] = smooth[now] / weight[now]
        gaps &= ~now
    filled[gaps] = mean[known].mean() if known.any() else 0.0
    return filled
