"""Cloth cut out of its ground in a photograph: which pixels show it.

    light relative to the ground -> ground by its soft changes -> cloth and ground by their colours

The ground's light is a smooth function of place, fitted to what surely is ground. Relative to it,
a shadow is darker and has no colour; cloth has a colour, a texture, or a sharp edge. What is
joined to the border without a sharp edge is ground, also where it is shaded; the rest is cloth or
a shadow with a sharp edge. GrabCut (Rother et al. 2004) decides by what the colours of both have
in common, and along edges.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from scipy.spatial import cKDTree

from common.errors import InputError
from common.types import LinearLight, Mask
from data.pictures.reading import Photograph

SIDE = 600  # pixels, of the picture in which cloth is cut out
BORDER = 0.1  # of the smaller side: the ground, where nothing else is known of it
ON_PLATE = 0.85  # of the plate's radius, surely cloth
BEYOND = 1.08  # of the flat specimen's reach, surely ground
SHADE_EDGES = (5.0, 3.0)  # times the ground's median edge strength; soft changes are weaker
LEAST_EDGE = 0.02  # of log light per pixel
GREYNESS = 0.06  # of log light between colours, that shadows may have
_NO_GREY = 0.05  # of the cloth on the plate: all of it has a colour
_USUAL = 0.15  # of log light, between places of the ground without shadow
_SHADING = 0.5  # of log light, between places of one cloth in different light
DARKER = 0.05  # of log light, that shadows at least are
THREADS = (9.0, 15.0, 21.0)  # pixels, of widths of threads at a hem, or bridges to other things
SLIVERS = 8.0  # pixels, from the paper's edge
FLOOR = 0.01  # of light, below which noise rules
_DEGREE = 3  # of the ground's polynomial in x and y
_ROUNDS = 5  # of fits and of GrabCut
_SAMPLES = 6000
MIN_COVERED = 0.9  # of the plate


@dataclass(frozen=True)
class Place:
    """Where cloth may be: sizes and places in pixels of the picture.

    Attributes:
        plate, reach: radii of the plate and of the flat specimen.
        middle: (2,) the plate's centre; None if it is not known.
        ground: what surely shows the ground near the cloth; None for the picture's border.
        paper: where the ground is another one, if there are two: paper on a table.
        outside: what surely is not cloth.
    """

    plate: float
    reach: float
    middle: np.ndarray | None = None
    ground: Mask | None = None
    paper: Mask | None = None
    outside: Mask | None = None


@dataclass(frozen=True)
class Scene:
    """A photograph and a place, reduced to :data:`SIDE`; ``size``: of the photograph, rows and
    columns. What all cuts of a photograph share is computed once."""

    size: tuple[int, int]
    light: LinearLight
    ground: Mask
    paper: Mask
    outside: Mask
    middle: np.ndarray | None
    plate: float
    reach: float

    @classmethod
    def of(cls, photograph: Photograph, place: Place) -> "Scene":
        """The scene of a photograph; InputError for a plate larger than its picture."""
        height, width = photograph.light.shape[:2]
        if 2 * place.plate > min(height, width):
            raise InputError(
                f"the plate has {2 * place.plate * photograph.factor:.0f} pixels of the file, more "
                f"than the picture's {min(height, width) * photograph.factor}; check the scale and "
                "the tester")
        scale = min(1.0, SIDE / max(height, width))
        size = round(scale * width), round(scale * height)

        def small(mask: Mask | None, default: Mask) -> Mask:
            return default if mask is None else cv2.resize(
                mask.astype(np.uint8), size, interpolation=cv2.INTER_AREA) > 0

        none = np.zeros(size[::-1], bool)
        wide = round(BORDER * min(size))
        border = ~none
        border[wide:-wide, wide:-wide] = False
        middle = None if place.middle is None else (np.asarray(place.middle) + 0.5) * scale - 0.5
        light = cv2.resize(photograph.light, size, interpolation=cv2.INTER_AREA)
        return cls((height, width), light,
                   small(place.ground, border), small(place.paper, none),
                   small(photograph.transparent, none) | small(place.outside, none), middle,
                   scale * place.plate, scale * place.reach)

    @cached_property
    def logs(self) -> np.ndarray:
        """Log light (H, W, 3)."""
        return np.log(self.light + FLOOR)

    @cached_property
    def flat(self) -> tuple[np.ndarray, np.ndarray]:
        """Log light (H, W) and its differences between colours (H, W, 3), over that of the ground,
        or of the paper, with which both grounds are lit."""
        return _parted(self.logs - self._smooth(self.paper if self.paper.any() else ~self.paper))

    @cached_property
    def relative(self) -> tuple[np.ndarray, np.ndarray]:
        """The same (H, W) and (H, W, 3) over that of the ground at each place."""
        if not self.paper.any():
            return self.flat
        grounds = self._smooth(self.paper), self._smooth(~self.paper)
        return _parted(self.logs - np.where(self.paper[..., None], *grounds))

    def _smooth(self, zone: Mask) -> np.ndarray:
        """Log light (H, W, 3) of the ground of a zone, continued smoothly."""
        opaque = self.ground & zone & ~self.outside
        degree = 1 if self.paper.any() else _DEGREE  # few places show one of two grounds
        return _smooth(self.logs, opaque if opaque.any() else self.ground, degree)

    @cached_property
    def edges(self) -> np.ndarray:
        """Strength (H, W) of the edges."""
        return _edges(*self.flat)

    def distances(self, centre: np.ndarray) -> np.ndarray:
        """Distances (H, W) from a place, pixels."""
        rows, columns = np.indices(self.ground.shape)
        return np.hypot(columns - centre[0], rows - centre[1])


def cut_cloth(scene: Scene, edge: float) -> Mask:
    """The cloth of a photograph without holes; InputError where none differs from the ground.
    ``edge``: strength of an edge that separates them, of the ground's median."""
    return _enlarged(_cut(scene, edge), scene)


def like_ground(scene: Scene) -> float:
    """Share of the cloth on the plate, whose place is known, with the ground's light and colour."""
    assert scene.middle is not None
    on_plate = scene.distances(scene.middle) < ON_PLATE * scene.plate
    shade, tint = scene.relative
    usual = scene.ground & ~scene.outside & (np.abs(shade) < _USUAL) & (
        np.abs(tint).max(axis=2) < GREYNESS)
    return float(1 - _unlike(scene.logs, on_plate, usual, _USUAL).mean()) if usual.any() else 0.0


def pieces(photograph: Photograph) -> list[Mask]:
    """What sharp edges separate from the ground at the picture's border: each piece, filled."""
    scene = Scene.of(photograph, Place(0.0, 0.0))
    found = []
    for edge in SHADE_EDGES:
        count, labels = cv2.connectedComponents(_raised(scene, edge).astype(np.uint8))
        found += [_enlarged(labels == k, scene) for k in range(1, count)]
    return found


def _enlarged(mask: Mask, scene: Scene) -> np.ndarray:
    """A mask of the scene in pixels of its photograph."""
    return cv2.resize(mask.astype(np.float32), scene.size[::-1]) > 0.5


def _cut(scene: Scene, edge: float, *, on_sheet: bool = False) -> Mask:
    raised = _raised(scene, edge)
    centre = _best_place(raised, scene.plate) if scene.middle is None else scene.middle
    far = scene.distances(centre)
    piece = _piece(raised, centre)
    _require_covered(piece, far < 0.95 * scene.plate, stated=scene.middle is not None)
    if not on_sheet and (far[piece] > BEYOND * scene.reach).any():
        # What differs from the border may be a sheet under the drape, or a lit table in the dark.
        rim = piece & ~_eroded(piece, 0.15 * scene.reach) & _eroded(piece, 0.03 * scene.reach)
        try:
            return _cut(replace(scene, ground=rim, outside=scene.outside | ~piece), edge,
                        on_sheet=True)
        except InputError:
            pass
    return _by_colours(scene, piece, centre, far)


def _parted(logs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean (H, W) of three colours, and their differences from it."""
    shade = logs.mean(axis=2)
    return shade, logs - shade[..., None]


def _smooth(logs: np.ndarray, ground: Mask, degree: int) -> np.ndarray:
    """A polynomial (H, W, 3) of place through what most places of the ground show."""
    rows, columns = np.indices(ground.shape, dtype=np.float32)
    y, x = 2 * rows / ground.shape[0] - 1, 2 * columns / ground.shape[1] - 1
    terms = np.stack([x**i * y**j for i in range(degree + 1) for j in range(degree + 1 - i)],
                     axis=2)
    places = np.flatnonzero(ground)
    places = places[:: max(len(places) // _SAMPLES, 1)]
    if not len(places):
        raise InputError("no ground is seen around the cloth; move the camera up")
    design, seen = terms.reshape(-1, terms.shape[2])[places], logs.reshape(-1, 3)[places]
    kept = np.ones(len(places), bool)
    for _ in range(_ROUNDS):
        fit = np.linalg.lstsq(design[kept], seen[kept], rcond=None)[0]
        off = np.abs(seen - design @ fit)
        kept = (off < 3 * (1.4826 * np.median(off[kept], axis=0) + 0.01)).all(axis=1)
    return (terms @ fit).astype(np.float32)


def _edges(shade: np.ndarray, tint: np.ndarray) -> np.ndarray:
    """Strength (H, W) of the edges, log light per pixel."""
    layers = [np.clip(shade, -1.2, 1.0), *np.moveaxis(2 * tint, 2, 0)]
    total = np.zeros(shade.shape, np.float32)
    for layer in layers:
        smooth = cv2.GaussianBlur(np.ascontiguousarray(layer), (0, 0), 1.0)
        for axis in ((1, 0), (0, 1)):
            total += np.square(cv2.Scharr(smooth, -1, *axis, scale=1 / 32))
    return np.sqrt(total)


def _raised(scene: Scene, edge: float) -> Mask:
    """What sharp edges separate from the ground, filled."""
    edges, ground = scene.edges, scene.ground
    soft = edges < max(edge * float(np.median(edges[ground])), LEAST_EDGE)
    _, labels = cv2.connectedComponents(soft.astype(np.uint8), connectivity=4)
    shares = np.bincount(labels[ground])
    shares[0] = 0
    # Of two grounds, one may show little; cloth may reach into the picture's border.
    least = 0.01 if scene.paper.any() else 0.05
    joined = np.flatnonzero(shares > least * ground.sum())
    rest = ~(np.isin(labels, joined) | scene.outside)
    rest = cv2.erode(rest.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    # Lines, such as the edge of the paper, surround what is not cloth.
    return _filled(_opened(rest, 7))


def _best_place(raised: Mask, plate: float) -> np.ndarray:
    """Where (2,) a disc of the plate's radius is covered best; the middle of such places."""
    radius = max(round(plate), 1)
    disc = cv2.circle(np.zeros((2 * radius + 1, 2 * radius + 1), np.float32), (radius, radius),
                      radius, 1, cv2.FILLED)
    covered = cv2.filter2D(raised.astype(np.float32), -1, disc / disc.sum(),
                           borderType=cv2.BORDER_CONSTANT)
    rows, columns = np.nonzero(covered > covered.max() - 3e-3)
    return np.array([columns.mean(), rows.mean()])


def _piece(mask: Mask, centre: np.ndarray) -> Mask:
    """The piece of a mask around a place, filled; empty if there is none."""
    _, labels = cv2.connectedComponents(mask.astype(np.uint8))
    column, row = np.clip(np.rint(centre).astype(int), 0, np.array(mask.shape[::-1]) - 1)
    label = labels[row, column]
    return _filled((labels == label).astype(np.uint8)) if label else np.zeros(mask.shape, bool)


def _require_covered(piece: Mask, plate: Mask, *, stated: bool) -> None:
    """InputError where cloth cannot lie on the plate."""
    covered = piece[plate].mean() if plate.any() else 0.0
    if covered < MIN_COVERED:
        place, what = ("its stated place", "plate_px") if stated else ("any place", "the scale")
        raise InputError(
            f"what differs from the ground covers {covered:.0%} of the plate at {place}, at least "
            f"{MIN_COVERED:.0%} is needed: if the cloth is as light as the ground or its shadow, "
            "light it from below or use a ground of another colour; move the camera up if the "
            f"drape touches the border; check {what} and the tester")


def _by_colours(scene: Scene, piece: Mask, centre: np.ndarray, far: np.ndarray) -> Mask:
    """The cloth of a piece that is cloth and shadows, by GrabCut; ``far``: distances (H, W) from
    the plate's centre."""
    (shade, tint), plate, reach = scene.flat, scene.plate, scene.reach
    on_plate = far < ON_PLATE * plate
    # The direction along which the colours of the cloth differ most from the ground's.
    spread, ways = np.linalg.eigh(tint[on_plate].T @ tint[on_plate] / max(on_plate.sum(), 1))
    along = tint @ ways[:, -1] * min(1.0, np.sqrt(spread[-1]) / 0.02)
    grain = _grain(shade)
    picture = np.dstack([128 + 38 * np.arcsinh(3 * shade),  # fine near the ground's light
                         128 + 400 * np.clip(along, -0.3, 0.3), np.minimum(1500 * grain, 200)])
    darker, colour = scene.relative
    grey = np.abs(colour).max(axis=2)
    shadow = piece & (grey < GREYNESS) & (darker < -DARKER)
    shadow &= grain < 2 * max(float(np.median(grain[~piece])), 4e-3)
    vivid = (grey[on_plate] < 2 * GREYNESS).mean() < _NO_GREY  # then nothing grey is cloth
    if not vivid:
        shadow[shadow] = _unlike(scene.logs, shadow, on_plate, _SHADING)
    labels = np.where(piece & ~shadow, cv2.GC_PR_FGD, cv2.GC_PR_BGD)
    labels[scene.outside | ~_grown(piece, 4) | (far > BEYOND * reach) | (shadow & vivid)] = (
        cv2.GC_BGD)
    labels[on_plate] = cv2.GC_FGD
    mask = labels.astype(np.uint8)
    models = np.zeros((1, 65)), np.zeros((1, 65))
    cv2.setRNGSeed(0)
    cv2.grabCut(np.clip(picture, 0, 255).astype(np.uint8), mask, (0, 0, 1, 1), *models, _ROUNDS,
                cv2.GC_INIT_WITH_MASK)
    found = (mask == cv2.GC_FGD) | (mask == cv2.GC_PR_FGD)
    # Without threads, and without what a bridge joins to the cloth and the picture's border.
    for width in THREADS:
        body = _piece(_opened(found, width), centre)
        if (body & (far > BEYOND * reach - 2)).sum() > 0.02 * 2 * np.pi * reach:
            raise InputError("what differs from the ground reaches beyond the flat specimen; check "
                             "the scale, the specimen's size and the tester, and take away what is "
                             "not cloth, such as a shadow with a sharp edge")
        if not _touches_border(body):
            found &= _grown(body, width / 2)
            if scene.paper.any():  # slivers of paper between cloth and table are not cloth
                rim = _grown(scene.paper, SLIVERS) & ~_eroded(scene.paper, SLIVERS)
                found &= ~rim | _opened(found, THREADS[2])
            return _filled(found)
    raise InputError("the drape touches the border of the picture; move the camera up, or use a "
                     "ground that fills the picture")


def _touches_border(mask: Mask) -> bool:
    return bool(mask[0].any() or mask[-1].any() or mask[:, 0].any() or mask[:, -1].any())


def _grain(shade: np.ndarray) -> np.ndarray:
    """Texture: mean deviation (H, W) from the surroundings, without that of single edges."""
    fine = np.abs(shade - cv2.GaussianBlur(shade, (0, 0), 2.0))
    return cv2.erode(cv2.blur(fine, (7, 7)), np.ones((7, 7), np.uint8))


def _unlike(logs: np.ndarray, asked: Mask, known: Mask, shading: float) -> np.ndarray:
    """Whether each place that is ``asked`` has other log light (H, W, 3) than all ``known``, by
    more than ``shading`` or by its colour."""
    shade = logs.mean(axis=2)[..., None]
    features = np.dstack([shade / shading, (logs - shade) / GREYNESS])
    examples = features[known]
    tree = cKDTree(examples[:: max(len(examples) // 1000, 1)])
    return tree.query(features[asked], distance_upper_bound=1.0)[0] > 1


def _filled(piece: np.ndarray) -> Mask:
    outer, _ = cv2.findContours(piece.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return cv2.drawContours(np.zeros(piece.shape, np.uint8), outer, -1, 1, cv2.FILLED) > 0


def _disc(size: float) -> np.ndarray:
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (int(size) | 1,) * 2)


def _opened(mask: Mask, size: float) -> Mask:
    return cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, _disc(size)) > 0


def _eroded(mask: Mask, distance: float) -> Mask:
    padded = cv2.copyMakeBorder(mask.astype(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    return cv2.distanceTransform(padded, cv2.DIST_L2, 3)[1:-1, 1:-1] > distance


def _grown(mask: Mask, distance: float) -> Mask:
    return cv2.dilate(mask.astype(np.uint8), _disc(2 * distance + 1)) > 0
