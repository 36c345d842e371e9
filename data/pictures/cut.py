"""Cloth cut out of a photograph by a network that has learned rendered pictures
(``python -m data.dataset.cloth``), and the hem to a fraction of a pixel.

The network is given the picture in the plane of the plate, what is printed on a mat as it must
appear there, and the distance from the plate's axis.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from common.errors import InputError
from common.graphs import bundled_graph
from common.types import ColourPicture, Mask, Metres, PixelPath
from data.pictures.edge import border_of, edge_of, normals, sampled, smoothed
from data.pictures.mat import printed_at
from data.pictures.planes import mapped, on_grid
from data.pictures.reading import Photograph, decoded

SIDES = {False: 128, True: 256}  # pixels, of pictures without a mat and over one
AROUND = 1.2  # of the flat specimen's reach, shown
FINE, COARSE = 4, 5  # inputs at each pixel, and at each square of two by two
_FLOOR = 0.02  # of light
_BRIGHT = 0.95  # quantile of the light that becomes 1
_LIGHT = decoded(np.arange(256) / 255.0)
BUNDLED = {SIDES[on_mat]: Path(__file__).resolve().parents[1] / "weights" / f"{name}.safetensors"
           for on_mat, name in ((False, "cloth"), (True, "cloth_on_mat"))}
_MOST_TIMES = 12  # pixels of a photograph that are averaged, along a side
_FINER = 8  # places for each pixel, between which log odds are linear
_AROUND_HEM = 1.0  # pixels, on both sides of it, between which the odds' slope is measured
_NO_ODDS = 9.0  # logarithm of the odds against cloth where there can be none
_LEAST_SLOPE = 0.2  # of log odds a pixel
_PLACES, _CENTRED = 4, 0.03  # tries of the middle, if not known, and how near it must be, of reach
ON_PLATE = 0.95  # of its radius
MIN_COVERED = 0.9  # of the plate
MAX_CUT_OFF = 0.003  # of the hem
SHEER = "; under sheer cloth lay a plain mat, grey or blue, and state its ground"
CONTRAST, EDGE_ERROR = 0.15, 1.0  # of log light across an edge that is seen; pixels


@dataclass(frozen=True)
class Printed:
    """A ``mat`` with a ``ground``, and the homography (3, 3) from the plate's plane to what a
    camera sees behind it on the mat."""

    mat: str
    ground: str
    to_mat: np.ndarray

    def at(self, places: np.ndarray) -> tuple[np.ndarray, Mask]:
        """What is printed (H, W) uint8 behind places (H, W, 2), m, of that plane, and where."""
        return printed_at(self.mat, on_grid(places, self.to_mat), self.ground)


def steps(reach: Metres, side: int) -> np.ndarray:
    """Places (side,), m, of the pixels along x, and upwards along y."""
    return ((np.arange(side) + 0.5) / side * 2 - 1) * AROUND * reach


@dataclass(frozen=True)
class ClothView:
    """Pictures of S x S pixels, of :data:`SIDES`, about the plate's axis, x to the right, y up.

    Attributes:
        picture: (S, S, 3).
        printed: (S, S) uint8, the mat as it would be seen without a drape; 0 beside it.
        on_mat, unseen: where the mat is, covered or not; where there is no picture.
        plate, reach: radii of the plate and of the flat specimen.
        off: (2,) m, place of the middle from the plate's axis; None if that is not known.
    """

    picture: ColourPicture
    printed: np.ndarray
    on_mat: Mask
    unseen: Mask
    plate: Metres
    reach: Metres
    off: np.ndarray | None

    @property
    def side(self) -> int:
        """S."""
        return len(self.picture)

    def channels(self) -> tuple[np.ndarray, np.ndarray]:
        """Inputs (FINE, S, S) and (COARSE, S/2, S/2) of the network, float32."""
        light = _LIGHT[self.picture]
        bright = max(float(np.quantile(light[~self.unseen].max(axis=1), _BRIGHT)), 1e-3)
        logs = np.log(light / bright + _FLOOR)
        logs[self.unseen] = 0.0
        fine = np.stack([*np.moveaxis(logs, 2, 0), self.printed / 255.0]).astype(np.float32)
        known, far = 0.0, np.zeros(self.unseen.shape)
        if self.off is not None:
            along = steps(self.reach, self.side)
            known, far = 1.0, np.hypot(along + self.off[0], (-along + self.off[1])[:, None])
        coarse = [self.on_mat, self.unseen, np.full(self.unseen.shape, known),
                  known * (far / self.plate - 1), known * (far / self.reach - 1)]
        pairs = self.side // 2, 2, self.side // 2, 2
        return fine, np.stack([np.asarray(one, np.float32).reshape(pairs).mean((1, 3))
                               for one in coarse])


@dataclass(frozen=True)
class Cut:
    """The specimen in a photograph.

    Attributes:
        hem: closed line around it, pixels of the photograph, a pixel apart.
        error: (N,) pixels, standard deviation of the hem's points across it.
        scale: pixels for one of the network's.
    """

    hem: PixelPath
    error: np.ndarray
    scale: float


def cut_cloth(
    photograph: Photograph, to_pixels: np.ndarray, *, plate: Metres, reach: Metres, known: bool,
    printed: Printed | None = None
) -> Cut:
    """The cloth of a photograph; InputError where none differs from its ground.

    Args:
        to_pixels: homography (3, 3) from the plate's plane.
        plate, reach: radii of the plate and of the flat specimen.
        known: whether the origin of this plane is the plate's centre.
        printed: what a mat shows behind that plane; None without a mat.
    """
    check = f"check the scale{', plate_height_mm' * (printed is not None)} and the tester"
    size = np.array(photograph.light.shape[1::-1])
    middle = np.zeros(2) if known else mapped((size[None] - 1) / 2, np.linalg.inv(to_pixels))[0]
    ends = mapped(middle + plate * np.array([[-1, 0], [1, 0]]), to_pixels)
    if (wide := np.linalg.norm(ends[1] - ends[0])) > min(size):
        raise InputError(f"the plate has {wide * photograph.factor:.0f} pixels of the file, more "
                         f"than the picture's {min(size) * photograph.factor}; {check}")
    side = SIDES[printed is not None]
    along = steps(reach, side)
    for _ in range(_PLACES):
        view, transparent = _view(photograph, to_pixels, middle, along, plate=plate, reach=reach,
                                  known=known, printed=printed)
        odds, doubt = _log_odds(view)
        odds[transparent] = -_NO_ODDS
        piece = _piece(odds)
        rows, columns = np.nonzero(piece)
        if known or not len(rows):
            break
        off = np.array([along[columns].mean(), -along[rows].mean()])
        if np.linalg.norm(off) < _CENTRED * reach:
            break
        middle = middle + off
    far = np.hypot(along, along[:, None])
    covered = float(piece[far < ON_PLATE * plate].mean())
    if covered < MIN_COVERED:
        raise InputError(
            f"cloth differs from its ground on {covered:.0%} of the plate, at least "
            f"{MIN_COVERED:.0%} is needed: if it is as light as its ground or its shadow, use a "
            "ground of another colour; check the scale, the tester and the plate's place"
            + SHEER * (printed is not None))
    hem, error = _hem(odds, doubt, piece)
    inside = np.clip(np.rint(hem).astype(int), 2, side - 3)
    border = (np.abs(hem - (side - 1) / 2) > side / 2 - 2).any(axis=1)
    border |= cv2.dilate(view.unseen.astype(np.uint8), np.ones((3, 3)))[inside[:, 1],
                                                                        inside[:, 0]] > 0
    if border.mean() > MAX_CUT_OFF:
        raise InputError("the drape reaches beyond the border of the picture, or beyond a specimen "
                         "of the stated size; take it again with the whole hem in the picture, and "
                         f"{check}")
    pixel = along[1] - along[0]
    places = middle + along[0] * np.array([1, -1]) + pixel * hem * [1, -1]
    line = mapped(places, to_pixels)
    length, before = (np.linalg.norm(np.diff(one, axis=0), axis=1).sum() for one in (line, hem))
    even = np.linspace(0, len(line), round(length), endpoint=False)
    x, y, error = (np.interp(even, np.arange(len(line)), values, period=len(line))
                   for values in (*line.T, error * length / before))
    return Cut(np.column_stack([x, y]), error, length / before)


def outline_of_cloth(
    photograph: Photograph, to_pixels: np.ndarray, *, unsure: Mask | None = None, **place: Any
) -> Cut:
    """The hem to a fraction of a pixel: that of :func:`cut_cloth`, whose arguments these are, moved
    to the edge in the picture that is near to it; ``unsure``: (H, W) where edges may be others."""
    cut = cut_cloth(photograph, to_pixels, **place)
    line, contrast = edge_of(smoothed(photograph.light), cut.hem, cut.error, unsure,
                             scale=cut.scale)
    return replace(cut, hem=line, error=np.where(
        contrast > CONTRAST, np.minimum(EDGE_ERROR, cut.error), cut.error))


def _view(
    photograph: Photograph, to_pixels: np.ndarray, middle: np.ndarray, along: np.ndarray, *,
    plate: Metres, reach: Metres, known: bool, printed: Printed | None
) -> tuple[ClothView, Mask]:
    """The view of a photograph ``along`` places (S,) about a ``middle`` (2,), m, of the plate's
    plane; and what an editor has made transparent in it."""
    side, pixel = len(along), along[1] - along[0]
    step = np.diff(mapped(middle + np.array([[0, 0], [pixel, 0]]), to_pixels), axis=0)
    times = int(np.clip(np.ceil(np.linalg.norm(step)), 1, _MOST_TIMES))
    first = along[0] - pixel * (1 - 1 / times) / 2
    fine = np.array([[pixel / times, 0, middle[0] + first],
                     [0, -pixel / times, middle[1] - first], [0, 0, 1.0]])

    def warped(picture: np.ndarray, border: int) -> np.ndarray:
        seen = cv2.warpPerspective(
            picture, to_pixels @ fine, (side * times,) * 2, borderMode=border,
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
        return cv2.resize(seen, (side, side), interpolation=cv2.INTER_AREA)

    shown = np.full(photograph.light.shape[:2], 255, np.uint8)
    if photograph.missing is not None:
        shown[photograph.missing] = 0
    unseen = warped(shown, cv2.BORDER_CONSTANT) < 250
    if printed is None:
        print_there, on_mat = np.zeros((side, side), np.uint8), np.zeros((side, side), bool)
    else:
        print_there, on_mat = printed.at(middle + np.dstack(np.meshgrid(along, -along)))
    transparent = warped(np.uint8(255) * photograph.transparent, cv2.BORDER_CONSTANT) > 127
    return ClothView(warped(photograph.colour, cv2.BORDER_REPLICATE), print_there, on_mat, unseen,
                     plate, reach, middle if known else None), transparent


def _log_odds(view: ClothView) -> tuple[np.ndarray, np.ndarray]:
    """Logarithm (S, S) of the odds that pixels show the specimen, mean of a view turned and
    mirrored in all eight ways, and its standard deviation between them."""
    def turned(values: np.ndarray, way: int) -> np.ndarray:
        return np.rot90(values[..., ::-1] if way > 3 else values, way, (-2, -1))

    def back(values: np.ndarray, way: int) -> np.ndarray:
        upright = np.rot90(values, -way, (-2, -1))
        return upright[..., ::-1] if way > 3 else upright

    fine, coarse = (np.stack([turned(one, way) for way in range(8)]) for one in view.channels())
    odds, = bundled_graph(BUNDLED[view.side])(fine=fine, coarse=coarse)
    found = np.stack([back(one, way) for way, one in enumerate(odds)])
    return found.mean(0), found.std(0)


def _piece(odds: np.ndarray) -> Mask:
    """The largest piece of the cloth, filled."""
    outer, _ = cv2.findContours((odds > 0).astype(np.uint8), cv2.RETR_EXTERNAL,
                                cv2.CHAIN_APPROX_NONE)
    piece = np.zeros(odds.shape, np.uint8)
    if outer:
        cv2.drawContours(piece, [max(outer, key=cv2.contourArea)], -1, 1, cv2.FILLED)
    return piece > 0


def _hem(odds: np.ndarray, doubt: np.ndarray, piece: Mask) -> tuple[PixelPath, np.ndarray]:
    """The line on which odds are even, in pixels of the view, and its error (N,), pixels: that of
    the logistic distribution of an edge whose place has these odds, and of their ``doubt``."""
    around = cv2.dilate(piece.astype(np.uint8), np.ones((3, 3))) > 0
    fine = cv2.resize(np.where(around, odds, -_NO_ODDS), None, fx=_FINER,
                      fy=_FINER, interpolation=cv2.INTER_LINEAR)
    line = (border_of(fine > 0, _FINER / 2) + 0.5) / _FINER - 0.5
    normal = normals(line)
    across = sampled(odds.astype(np.float32),
                     line[:, None] + _AROUND_HEM * np.array([[1], [0], [-1]]) * normal[:, None])
    slope = np.maximum((across[:, 2] - across[:, 0]) / (2 * _AROUND_HEM), _LEAST_SLOPE)
    moved = np.clip(across[:, 1] / slope, -1, 1)
    unsure = sampled(doubt.astype(np.float32), line[:, None])[:, 0]
    return (line + moved[:, None] * normal,
            np.hypot(np.pi / np.sqrt(3), unsure) / slope)
