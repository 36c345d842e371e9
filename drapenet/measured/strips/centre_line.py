"""The centre line of a thin strip in a photograph, from its clamp to its tip.

What differs from a plain ground is the strip and its clamp, which is thick where the strip is
thin. Across the strip's rough path its two edges are located to a fraction of a pixel; the centre
line is half way between them, whatever the strip's thickness. All pictures are (H, W), and all
strips here hang to the right.
"""

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from scipy import sparse
from scipy.ndimage import median_filter
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from common.errors import InputError
from common.types import Mask, PixelPath, Radians
from data.pictures.edge import sampled
from sim.cantilever.moduli import arc_lengths

POINTS = 60  # of a centre line
BLUR = 1.2  # pixels, standard deviation
MIN_CONTRAST = 0.12  # between strip and ground, of the brightest
NOISE_LEVEL = 6.0  # standard deviations of the ground, at which something differs from it
MAX_COVERED = 0.5  # of the picture that may differ from the ground
MIN_EXTENT = 1.0  # of a strip, in thicknesses of the thinnest clamp
PIECE_SHARE = 0.1  # of the strip's pixels; smaller pieces are specks
SECOND_SHARE = 0.5  # of the strip's extent, that another strip on its clamp has at least
MAX_BRANCH = 0.012  # of a strip's pixels that may lie outside of its usual width
MAX_TURN = np.radians(50.0)  # between successive twelfths of a strip, which cloth does not exceed
MAX_ROLL = np.radians(15.0)
EDGE_LEVEL = 0.35  # of the contrast; parts of a strip seen obliquely are nearer to the ground's
FIBRE_LEVEL = 0.25  # of the contrast; what continues the strip at its tip with less is loose fibres
_GROUND_STEP = 10.0  # brightness from the ground's, within which a pixel may show it
_STEP = 1.5  # pixels between two places at which the edges are located
_LEAST_ERROR = 0.03  # pixels, of a point
_SOURCE_GAP = 3  # pixels between strip and clamp
_ROUNDS = 3


@dataclass(frozen=True)
class CentreLine:
    """A strip in a picture; lengths in pixels."""

    points: PixelPath  # (N, 2) from the clamp to the tip; the last is the tip's end
    error: np.ndarray  # (N,) standard errors across
    band: float  # median width of the strip as seen
    thinnest: float  # nearly its smallest width
    clamp: np.ndarray  # (2,) where the centre line leaves the clamp
    roll: Radians  # of the horizontal, by the clamp's edges, clockwise; NaN if they are not seen
    uneven: float | None = None  # by how much the clamp's edges above and below the strip differ


def trace_strip(
    grey: np.ndarray, ignored: Mask, *, thick: float, clamp: np.ndarray | None,
    roll: Radians | None, slope: Radians
) -> CentreLine:
    """The strip in a picture (H, W) float32, 0 to 255; InputError if there is not exactly one.

    Args:
        ignored: pixels that show neither cloth nor clamp, such as a printed board.
        thick: half the thickness, pixels, from which on something is a clamp.
        clamp: (2,) where the strip leaves the clamp, pixels, if it is stated.
        roll: of the horizontal in the picture, clockwise, if it is stated.
        slope: of the clamp below the horizontal, rad.
    """
    smooth = cv2.GaussianBlur(grey, (0, 0), BLUR)
    ground, noise = _ground(smooth, ignored)
    contrast = np.where(ignored, np.float32(0), smooth - ground)
    level = max(MIN_CONTRAST * 255 / 2, NOISE_LEVEL * noise)
    differs = np.abs(contrast) > level
    if (share := differs.mean()) > MAX_COVERED:
        raise InputError(f"{share:.0%} of the picture differ from its ground, at most "
                         f"{MAX_COVERED:.0%} may; use a plain ground of another brightness")
    solid = _thick_parts(differs, thick)
    edge_roll = _edge_roll(solid, thick, slope)
    if roll is None:
        roll = 0.0 if np.isnan(edge_roll) else edge_roll
    out = np.array([np.cos(roll + slope), np.sin(roll + slope)])
    if clamp is not None:
        rows, columns = np.indices(grey.shape)
        solid = differs & ((columns - clamp[0]) * out[0] + (rows - clamp[1]) * out[1] < 0)
    elif not solid.any():
        raise InputError("no clamp was found, that is, nothing thicker than "
                         f"{2 * thick:.0f} pixels; show the clamp, or state clamp_px")
    strip = _strip_beside(differs, solid, thick, clamp)
    path = _rough_path(strip, solid)
    sign = np.sign(np.median(contrast[strip]))
    field = sign * contrast
    band = max(strip.sum() / max(arc_lengths(path)[-1], 1.0), 1.5)
    for _ in range(_ROUNDS):
        path = _resampled(path, max(2 * band, 15.0))
        path, widths, peak = _midway(field, path, band)
        band = float(np.median(widths))
    if peak < MIN_CONTRAST * 255:
        raise InputError(f"strip and ground differ by {peak / 255:.0%} of the brightest pixels, "
                         f"at least {MIN_CONTRAST:.0%} is needed; use a ground of another "
                         "brightness, or more light")
    path = _to_the_tip(field, path, band, peak)
    uneven = None
    if clamp is None:
        clamp, uneven = _clamp_edge(np.abs(contrast), solid, path[0], out, band, level)
    traced, path = path, path[(path - clamp) @ out > max(band, 3.0)]
    if len(path) < POINTS:
        raise InputError(f"the strip is only {_STEP * len(path):.0f} pixels long, "
                         f"{_STEP * POINTS:.0f} are needed; move the camera nearer")
    points, error = _thinned(path)
    _require_smooth(points)
    _require_no_branch(strip & (field > EDGE_LEVEL * peak), traced, widths, band)
    clamp = _on_line(points, clamp, out)
    thinnest = float(np.quantile(widths, 0.05))
    return CentreLine(points, error, band, thinnest, clamp, edge_roll, uneven)


def _ground(smooth: np.ndarray, ignored: Mask) -> tuple[np.ndarray, float]:
    """Brightness (H, W) of the ground, the quadratic near to most of the picture, and its noise."""
    factor = max(1, max(smooth.shape) // 150)
    small = smooth[factor // 2 :: factor, factor // 2 :: factor]
    free = ~ignored[factor // 2 :: factor, factor // 2 :: factor]
    rows, columns = (np.linspace(-1, 1, n, dtype=np.float32) for n in small.shape)
    terms = _terms(rows, columns)
    values, basis = small[free], terms[free]
    fits = []
    for start in np.quantile(values, [0.1, 0.3, 0.5, 0.7, 0.9]):  # a clamp may be as large
        off = np.abs(values - start)
        for _ in range(8):
            near = off <= np.quantile(off, 0.4)
            weights = np.linalg.lstsq(basis[near], values[near], rcond=None)[0]
            off = np.abs(values - basis @ weights)
        fits.append((np.count_nonzero(off < _GROUND_STEP), weights, off))
    _, weights, off = max(fits, key=lambda fit: fit[0])
    full = _terms(*(np.linspace(-1, 1, n, dtype=np.float32) for n in smooth.shape))
    # The quantile 0.3 of a normal distribution's size is 0.385 standard deviations.
    return (full @ weights.astype(np.float32)), float(np.quantile(off, 0.3) / 0.385)


def _terms(rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    y, x = np.meshgrid(rows, columns, indexing="ij")
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)


def _inside(mask: Mask) -> np.ndarray:
    """Distance (H, W), pixels, of what is in a mask from what is not, 0 elsewhere."""
    return cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5)


def _thick_parts(differs: Mask, thick: float) -> Mask:
    """What discs of the radius ``thick`` cover within a mask."""
    inner = _inside(differs) > thick
    return _inside(~inner) <= thick if inner.any() else inner


def _edge_roll(solid: Mask, thick: float, slope: Radians) -> Radians:
    """Angle of the long edges of thick parts from the ``slope`` of a clamp, clockwise; NaN without
    any that is nearly as steep."""
    outlines, _ = cv2.findContours(solid.astype(np.uint8), cv2.RETR_EXTERNAL,
                                   cv2.CHAIN_APPROX_NONE)
    height, width = solid.shape
    found = []
    for outline in outlines:
        around = outline[:, 0].astype(np.float64)
        corners = cv2.approxPolyDP(outline, 2.0, True)[:, 0]
        for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            along = (end - start).astype(float)
            length = np.hypot(*along)
            if along[0] == 0 or length < 3.5 * thick or abs(
                    np.arctan(along[1] / along[0]) - slope) > MAX_ROLL:
                continue
            at, off = (around - start) @ along / length, (around - start) @ [-along[1], along[0]]
            part = around[(at > thick) & (at < length - thick) & (np.abs(off) < 3 * length)]
            x, y = part.T
            if ((y < 3) | (y > height - 4)).any() or len(part) < thick:
                continue
            found.append((np.polyfit(x - width / 2, y, 1)[0], length))
    if not found:
        return np.nan
    slopes, lengths = np.array(found).T
    return float(np.arctan(slopes @ lengths / lengths.sum()) - slope)


def _strip_beside(
    differs: Mask, solid: Mask, thick: float, clamp: np.ndarray | None
) -> Mask:
    """The thin piece that leaves the clamp; InputError if there is none, or more."""
    from_solid = _inside(~solid)
    thin = differs & (from_solid > _SOURCE_GAP)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(thin.astype(np.uint8))
    left, top, wide, high, areas = stats[1:].T
    extents = np.hypot(wide, high)
    attached = np.zeros(len(extents), bool)
    attached[np.unique(labels[thin & (from_solid < _SOURCE_GAP + 2)]) - 1] = True
    least = MIN_EXTENT * 2 * thick
    sizes = np.where(attached, extents, 0)
    if sizes.max(initial=0) < least:
        where = "to the right of clamp_px" if clamp is not None else "to the stated side"
        raise InputError(f"no strip leaves the clamp {where}, thin and at least {least:.0f} "
                         "pixels long; check the side to which it hangs, and the contrast")
    if clamp is not None:
        inside = [np.hypot(*(np.argwhere(labels == 1 + k)[:, ::-1] - clamp).T).min()
                  if sizes[k] >= least else np.inf for k in range(len(sizes))]
        chosen = int(np.argmin(inside))
        if inside[chosen] > 3 * thick:
            raise InputError(f"the nearest strip is {inside[chosen]:.0f} pixels from clamp_px; "
                             "state the point at which the strip leaves the clamp")
    else:
        to_the_right = _to_the_right(labels, sizes, least, solid)
        chosen = int(np.argmax(np.where(to_the_right, sizes, 0)))
        if not to_the_right[chosen]:
            raise InputError("the strip hangs to the other side of its clamp than stated; correct "
                             "hangs")
    height, width = differs.shape
    border = (left < 3) | (top < 3) | (left + wide > width - 3) | (top + high > height - 3)
    if border[chosen]:
        raise InputError("the strip touches the border of the picture, so that its tip is not "
                         "seen; move the camera back")
    others = np.arange(len(areas)) != chosen
    rivals = others & attached & (extents > SECOND_SHARE * extents[chosen])
    pieces = others & ~attached & ~border & (areas > PIECE_SHARE * areas[chosen])
    if rivals.any() or pieces.any():
        raise InputError(f"{1 + (rivals | pieces).sum()} pieces differ from the ground, the strip "
                         "and its clamp must be the only ones; take away what is not cloth, cut "
                         "loose fibres off, and light the strip evenly and without a shadow on the "
                         "ground; state clamp_px if the clamp is not seen")
    return labels == 1 + chosen


def _to_the_right(labels: np.ndarray, sizes: np.ndarray, least: float, solid: Mask) -> np.ndarray:
    """Whether each piece (P,) of sufficient size has its middle to the right of the clamp's."""
    clamp = np.flatnonzero(solid.any(axis=0)).mean()
    return np.array([size >= least and np.flatnonzero((labels == 1 + k).any(axis=0)).mean() > clamp
                     for k, size in enumerate(sizes)])


def _rough_path(strip: Mask, solid: Mask) -> PixelPath:
    """Middles of the pixels of a strip at equal distances within it from the clamp."""
    rows, columns = np.nonzero(strip)
    number = np.full((strip.shape[0] + 2, strip.shape[1] + 2), -1)
    number[rows + 1, columns + 1] = np.arange(len(rows))
    starts, ends, steps = [], [], []
    for down, right in ((0, 1), (1, -1), (1, 0), (1, 1)):
        other = number[rows + 1 + down, columns + 1 + right]
        starts.append(np.flatnonzero(other >= 0))
        ends.append(other[other >= 0])
        steps.append(np.full(len(ends[-1]), np.hypot(down, right)))
    graph = sparse.csr_array((np.concatenate(steps), (np.concatenate(starts),
                                                      np.concatenate(ends))),
                             shape=(len(rows),) * 2)
    from_solid = _inside(~solid)[rows, columns]
    sources = np.flatnonzero(from_solid < from_solid.min() + 1.5)
    reach = dijkstra(graph, directed=False, indices=sources, min_only=True)
    step = max(4.0, 0.5 * len(rows) / reach.max())
    places = np.column_stack([columns, rows])
    bins = (reach / step).astype(int)
    count = np.bincount(bins)
    return np.column_stack([np.bincount(bins, axis) for axis in places.T]) / count[:, None]


def _require_no_branch(strip: Mask, path: PixelPath, widths: np.ndarray, band: float) -> None:
    """InputError for a strip with parts far from its centre line, over its ``widths`` (K,), pixels,
    from its start on. Its ends are left out, where the corners of an end seen obliquely are."""
    distance, nearest = cKDTree(path).query(np.argwhere(strip)[:, ::-1])
    arc = arc_lengths(path)
    within = (arc[nearest] > 1.5 * band) & (arc[nearest] < arc[-1] - 1.5 * band)
    usual = median_filter(widths, min(61, len(widths)))
    local = np.maximum(usual[np.minimum(nearest, len(usual) - 1)], band)
    away = (distance > 0.7 * local + 3) & within
    if away.mean() > MAX_BRANCH:
        raise InputError(f"{away.mean():.1%} of the strip lie away from its centre line, more than "
                         f"{MAX_BRANCH:.1%}; take away what is not cloth, such as a shadow, and "
                         "cut threads that hang from it")


def _resampled(path: PixelPath, window: float) -> PixelPath:
    """A path at equal steps, smoothed over a ``window`` in pixels."""
    from scipy.signal import savgol_filter  # importing it takes a third of a second

    arc = arc_lengths(path)
    at = np.arange(0.0, arc[-1], _STEP)
    even = np.column_stack([np.interp(at, arc, axis) for axis in path.T])
    odd = min(int(window / _STEP) // 2 * 2 + 1, (len(even) - 1) // 2 * 2 + 1)
    return savgol_filter(even, odd, 2, axis=0) if odd > 3 else even


def _midway(
    field: np.ndarray, path: PixelPath, band: float
) -> tuple[PixelPath, np.ndarray, float]:
    """The path half way between the edges of a strip, its widths, pixels, and its contrast."""
    along = np.gradient(path, axis=0)
    along /= np.linalg.norm(along, axis=1)[:, None]
    normal = np.column_stack([-along[:, 1], along[:, 0]])
    half = int(np.ceil(1.2 * band + 8))
    offsets = np.arange(-4 * half, 4 * half + 1) / 4
    profile = sampled(field, path[:, None] + offsets[:, None] * normal[:, None])
    inner = np.abs(offsets) <= max(0.6 * band, 2.0)
    peaks = profile[:, inner].max(axis=1)
    peaks = median_filter(peaks, min(31, len(peaks)))
    (strip,) = np.nonzero(peaks > FIBRE_LEVEL * np.median(peaks))
    part = slice(strip[-1] + 1)
    path, normal, profile, peaks = path[part], normal[part], profile[part], peaks[part]
    start = np.flatnonzero(inner)[profile[:, inner].argmax(axis=1)]
    limit = EDGE_LEVEL * peaks
    ends = []
    for side in (1, -1):
        crossing = np.full(len(path), np.nan)
        for k, (row, at) in enumerate(zip(profile, start, strict=True)):
            beyond = row[at::side]
            (below,) = np.nonzero(beyond < limit[k])
            if len(below) and below[0]:
                last, first = beyond[below[0] - 1], beyond[below[0]]
                crossing[k] = offsets[at] + side / 4 * (
                    below[0] - 1 + (last - limit[k]) / (last - first))
        ends.append(crossing)
    widths, shift = ends[0] - ends[1], (ends[0] + ends[1]) / 2
    usual = np.nanmedian(widths) if np.isfinite(widths).any() else np.nan
    sound = np.isfinite(widths) & (widths < 2.5 * usual + 4)
    if not sound.mean() > 0.7:
        raise InputError("the edges of the strip are not clear over "
                         f"{1 - sound.mean():.0%} of its length; use a plain ground of another "
                         "brightness, and focus on the strip")
    return (path[sound] + shift[sound, None] * normal[sound], widths[sound],
            float(np.median(peaks)))


def _to_the_tip(field: np.ndarray, path: PixelPath, band: float, peak: float) -> PixelPath:
    """The path, extended straight to where the contrast is half of the strip's. Within a width of
    its end the strip may be cut obliquely, as seen, so that its middle is unknown there."""
    path = path[: -max(2, int(band / _STEP))]
    near = path[-max(8, int(2 * band / _STEP)) :]
    along = near[-1] - near[0]
    along = along / np.linalg.norm(along)
    at = np.arange(-2 * band, 5 * band + 12, 0.25)
    profile = sampled(field, (path[-1] + at[:, None] * along)[None])[0]
    (inside,) = np.nonzero(profile > peak / 2)
    if not len(inside) or inside[-1] == len(at) - 1:
        raise InputError("the tip of the strip is not clear; cut loose fibres off it, and leave "
                         "plain ground around it, without a shadow")
    last = inside[-1]
    end = at[last] + 0.25 * (profile[last] - peak / 2) / (profile[last] - profile[last + 1])
    return np.vstack([path, path[-1] + np.arange(_STEP, end, _STEP)[:, None] * along,
                      path[-1] + end * along])


def _clamp_edge(
    strength: np.ndarray, solid: Mask, root: np.ndarray, out: np.ndarray, band: float, level: float
) -> tuple[np.ndarray, float]:
    """Point (2,) of the clamp's edge near the strip's ``root``, and how far, pixels, the edges
    above and below the strip differ. The edge below counts, because the strip lies on it."""
    down = np.array([-out[1], out[0]])
    edges = []
    for side in (1, -1):
        rows = side * (band + 4 + np.arange(0.0, max(2 * band, 24.0)))
        at = np.arange(-40.0, 40.0, 0.25)
        places = root + rows[:, None, None] * down + at[:, None] * out
        profile, inside = sampled(strength, places), sampled(solid.astype(np.float32), places)
        found = []
        for values, covered in zip(profile, inside, strict=True):
            (last,) = np.nonzero(covered[:-1] > 0.5)
            if not len(last) or last[-1] > len(at) - 20:
                continue
            inner = values[max(last[-1] - 40, 0) : max(last[-1] - 12, 1)]
            half = max(np.median(inner) / 2, level)
            (crossed,) = np.nonzero(values[max(last[-1] - 40, 0) :] < half)
            if len(crossed):
                found.append(at[max(last[-1] - 40, 0) + crossed[0]])
        if len(found) > len(rows) / 3:
            edges.append(float(np.median(found)))
    if not edges:
        return root - 1.5 * out, 0.0
    return root + edges[0] * out, abs(edges[0] - edges[-1])


def _thinned(path: PixelPath) -> tuple[PixelPath, np.ndarray]:
    """:data:`POINTS` places of a path, from quadratics through equal parts of it, and their
    standard errors across; neighbouring places of the path depend on each other."""
    arc = arc_lengths(path)
    bounds = np.linspace(0, arc[-1], POINTS)  # the tip is the last point
    points, errors = [], []
    for low, high in pairwise(bounds):
        part = (arc >= low) & (arc <= high)
        at = arc[part] - (low + high) / 2
        degree = min(2, max(part.sum() - 2, 0))
        basis = np.vander(at, degree + 1, increasing=True)
        found, *_ = np.linalg.lstsq(basis, path[part], rcond=None)
        left = path[part] - basis @ found
        points.append(found[0])
        errors.append(np.sqrt((left**2).sum() / max(part.sum() - degree - 1, 1))
                      / np.sqrt(max(part.sum() / 3, 1)))
    return np.vstack([*points, path[-1]]), np.maximum(np.append(errors, errors[-1]), _LEAST_ERROR)


def _require_smooth(points: PixelPath) -> None:
    """InputError for a line with a kink."""
    chords = np.diff(points[:: max(1, len(points) // 12)], axis=0)
    heading = np.unwrap(np.arctan2(chords[:, 1], chords[:, 0]))
    if (turn := np.abs(np.diff(heading)).max()) > MAX_TURN:
        raise InputError(f"the strip has a kink of {np.degrees(turn):.0f}°, more than "
                         f"{np.degrees(MAX_TURN):.0f}° within a twelfth of its length; press it "
                         "flat, cut another strip, or light it without a shadow beside it")


def _on_line(points: PixelPath, clamp: np.ndarray, out: np.ndarray) -> np.ndarray:
    """Where the line, continued, passes the clamp's edge."""
    near = points[:6]
    along, across = (near - clamp) @ out, (near - clamp) @ [-out[1], out[0]]
    offset = np.polyfit(along, across, 2)[-1]
    return clamp + offset * np.array([-out[1], out[0]])
