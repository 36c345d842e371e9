"""Cutting the cloth out of frames of a whole scene, by geometry alone.

    plate and table -> what cloth on the plate can reach -> less the column -> silhouettes

No cloth is longer than it is flat: from the plate's rim no point of it is farther than the
overhang. That leaves the cloth and the column that carries the plate. What the sensor did not see
goes to the surface that surrounds it, in the mask alone: no depth is invented.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from common.errors import InputError
from data.cameras import Intrinsics
from data.plate import Plate, find_plate
from data.reading import neighbours
from sim.scene import Rig

MOST_CLOTH = 0.9  # of a picture's pixels
SCENE = (0.1, 10.0)  # m, the usual depth of a scene
_MOST_BORDER = 0.4  # of the pixels at the picture's border
_OUTSIDE = 0.15  # of a frame's points
_SLACK = 0.010  # m, by which cloth may lie off the plate's centre, be larger, and depth be wrong
_ABOVE = 0.010  # m above the plate, for noise and thick cloth
_OVER_TABLE = 8e-3  # m, of the table's own noise
_STEP = 8e-3  # m at 0.5 m: neighbours on one surface differ by less
_ALIKE = 2  # of eight neighbours that a point of a surface has at least
_VOTE = 1.0  # pixels, over which neighbours decide what an unseen pixel shows
_HOLE = 0.01  # of the cloth's pixels: largest hole in it that is filled
_SPECK = 0.003  # of the cloth's pixels: smaller pieces are left out
_COLUMN_BELOW = 0.015  # m below the plate, where its column is looked for
_COLUMN_LEAST = 30  # pixels of all frames
_COLUMN_SPREAD = 4e-3  # m, of a round column's radius
_COLUMN_NEAR = 1.5e-3, 4e-3  # m beyond the column's radius that still count as column
_CHANGED = 4e-3  # m at 0.5 m, nearer than the empty scene: cloth
_SAME = 0.5  # share of the would-be cloth that the empty scene shows, too: it is not empty
_MOVED = 0.3  # share of the still scene that differs from its picture: the camera has moved


@dataclass(frozen=True)
class CutOut:
    """What in frames is cloth.

    Attributes:
        frames: (K, H, W) m, as given.
        masks: (K, H, W) bool, cloth, also where the sensor saw no depth of it.
        views: (K, H, W) float32 m, depth of the cloth, 0 elsewhere and where it is not known.
        plate: None where the frames were cut out already and show none.
        column: m, radius of the column under the plate; None where none is seen.
        doubts: one line each.
    """

    frames: np.ndarray
    masks: np.ndarray
    views: np.ndarray
    plate: Plate | None
    column: float | None
    doubts: tuple[str, ...]


def is_raw(frame: np.ndarray, intrinsics: Intrinsics, rig: Rig) -> bool:
    """Whether a frame (H, W), m, shows more than cloth: fills the picture or its border, or shows
    much that is farther away than cloth is large.
    """
    seen = frame > 0
    # Depth in a wrong unit is the reader's to report.
    if not seen.any() or not SCENE[0] < np.median(frame[seen]) < SCENE[1]:
        return False
    border = np.concatenate([seen[0], seen[-1], seen[:, 0], seen[:, -1]])
    if seen.mean() > MOST_CLOTH or border.mean() > _MOST_BORDER:
        return True
    points = intrinsics.back_project(frame)[seen]
    size = 2 * rig.reach
    away = np.linalg.norm(points - np.median(points, axis=0), axis=1)
    # A far piece that somebody forgot to cut away is the reader's to report.
    return bool((away > size).mean() > _OUTSIDE)


def cut_out(
    frames: np.ndarray, intrinsics: Intrinsics, rig: Rig, background: np.ndarray | None = None
) -> CutOut:
    """Find the cloth in frames (K, H, W), z-depth in m, 0 where the sensor saw nothing.

    Frames that are cut out already stay as they are.

    Args:
        intrinsics: of the frames, all of one camera that stood still.
        rig: with a plate.
        background: (H, W) m, the same scene with the tester but without cloth.

    Raises:
        InputError: no plate of the rig with cloth on it in the frames, or frames of both kinds.
    """
    frames = np.asarray(frames, dtype=np.float32)
    raw = [is_raw(frame, intrinsics, rig) for frame in frames]
    if any(raw) and not all(raw):
        raise InputError(f"view {raw.index(True)} shows the whole scene (has no background) but "
                         f"view {raw.index(False)} is cut out; give all views of one kind")
    points = intrinsics.back_project(frames)
    seen = frames > 0
    plate = find_plate(points[seen], rig) if seen.any() else None
    if not all(raw):
        return CutOut(frames, seen, frames, plate, None, ())
    if plate is None:
        median = np.median(frames[seen]) if seen.any() else 0.0
        raise InputError(
            f"no plate of {1e3 * rig.plate_diameter:g} mm diameter with cloth on it was found in "
            f"the frames (median depth {median:.3g} m); check rig, depth_unit_m and intrinsics, or "
            "set every pixel that is not cloth to 0")
    doubts = [] if plate.table is not None else [
        "no table is seen below the plate; look with python -m data.capture whether only cloth is "
        "cut out"]
    local = plate.local(points)
    radius, height = np.hypot(local[..., 0], local[..., 1]), local[..., 2]
    solid = seen & _on_surface(frames)
    cloth = solid & _within_reach(radius, height, rig)
    standing = solid
    if plate.table is not None:
        over = points @ plate.table[:3] + plate.table[3]
        cloth &= over > _OVER_TABLE
        standing = solid & (over > 2 * _OVER_TABLE)
    column = None
    if background is None:
        column = _column_radius(radius[standing], height[standing], rig)
        if column is not None:
            cloth &= ~_column(cloth, radius, height, column, rig)
            if column > rig.plate_radius - 2 * _COLUMN_NEAR[1]:
                doubts.append("the column is nearly as wide as the plate: where cloth touches it "
                              "the hem may be wrong; look at it with python -m data.capture")
    else:
        # Where cloth lies on the plate, and bends down at its side, it is little nearer.
        top = (radius < rig.plate_radius + _SLACK) & (np.abs(height) < _ABOVE)
        near = (background > 0) & (background - frames < _CHANGED * frames / 0.5)
        same = cloth & near & ~top
        still = solid & (background > 0) & ~_within_reach(radius, height, rig)
        doubts += _doubts_of_background(frames, background, cloth, same, still)
        cloth &= ~_without_cloth_below(same, cloth)
    masks = np.empty_like(cloth)
    for k in range(len(frames)):
        on_plate = cloth[k] & (radius[k] < rig.plate_radius) & (np.abs(height[k]) < _ABOVE)
        kept, apart = _one_piece(cloth[k], on_plate)
        if apart:
            doubts.append(f"view {k}: {apart} pixels within the cloth's reach are apart from it "
                          "and left out; look at them with python -m data.capture")
        cloth[k] = kept
        masks[k] = _completed(kept, solid[k])
    views = np.where(cloth & masks, frames, np.float32(0.0))
    return CutOut(frames, masks, views, plate, column, tuple(doubts))


def _doubts_of_background(
    frames: np.ndarray, background: np.ndarray, cloth: np.ndarray, same: np.ndarray,
    still: np.ndarray,
) -> list[str]:
    """What speaks against ``background`` (H, W), m, beside frames (K, H, W), m.

    Of their pixels, (K, H, W) bool: would-be ``cloth``, those of it that show the ``same`` as the
    background, and those out of the cloth's reach, which should be ``still``.
    """
    doubts = []
    share = (same.sum(axis=(1, 2)) / np.maximum(cloth.sum(axis=(1, 2)), 1)).max()
    if share > _SAME:
        doubts.append(f"background.png shows {share:.0%} of what a view has within the cloth's "
                      f"reach (limit {_SAME:.0%}): take it without cloth, and every view with it")
    moved = np.abs(frames - background) > 3 * _CHANGED * frames / 0.5
    if still.any() and moved[still].mean() > _MOVED:
        doubts.append("background.png does not fit the frames: the camera or the scene has "
                      "moved between them; take it again")
    return doubts


def _within_reach(radius: np.ndarray, height: np.ndarray, rig: Rig) -> np.ndarray:
    """Where cloth that the plate holds can be; ``radius`` from its axis, ``height`` above it, m."""
    beyond = np.maximum(radius - rig.plate_radius, 0.0)
    return (np.hypot(beyond, height) < rig.overhang + _SLACK) & (height < _ABOVE)


def _on_surface(frames: np.ndarray) -> np.ndarray:
    """(K, H, W) bool, pixels with neighbours at about their depth: not between two surfaces."""
    alike = np.abs(neighbours(frames) - frames) < _STEP * frames / 0.5
    return alike.sum(axis=0) >= _ALIKE


def _column_radius(radius: np.ndarray, height: np.ndarray, rig: Rig) -> float | None:
    """m, of the column, from points on surfaces: inside the plate's rim, or below all cloth."""
    low = rig.overhang + _SLACK
    inside = (height < -_COLUMN_BELOW) & (radius < rig.plate_radius - _COLUMN_NEAR[1])
    below = (height < -low) & (height > -low - 0.1) & (
        radius < rig.plate_radius + 2 * _COLUMN_NEAR[1])
    found = radius[(inside & (height > -low)) | below]
    if len(found) < _COLUMN_LEAST:
        return None
    low_quarter, middle, high_quarter = np.quantile(found, [0.25, 0.5, 0.75])
    return float(middle) if high_quarter - low_quarter < 2 * _COLUMN_SPREAD else None


def _column(
    cloth: np.ndarray, radius: np.ndarray, height: np.ndarray, column: float, rig: Rig
) -> np.ndarray:
    """(K, H, W) bool, what of the would-be ``cloth`` is column: has no cloth below it."""
    near = np.clip((rig.plate_radius - column) / 2, *_COLUMN_NEAR)
    return _without_cloth_below(
        cloth & (radius < column + near) & (height < -_COLUMN_BELOW), cloth)


def _without_cloth_below(like: np.ndarray, cloth: np.ndarray) -> np.ndarray:
    """(K, H, W) bool, the would-be ``cloth`` that looks ``like`` column and has no other cloth
    below it in the picture: cloth that touches the column hangs on beyond it.
    """
    other = np.flip(cloth & ~like, axis=1)
    return like & ~np.flip(np.maximum.accumulate(other, axis=1), axis=1)


def _one_piece(cloth: np.ndarray, on_plate: np.ndarray) -> tuple[np.ndarray, int]:
    """``cloth`` (H, W) without what is not connected to the plate in the picture, and how many
    pixels of larger pieces that were.
    """
    pieces, count = ndimage.label(ndimage.binary_dilation(cloth))
    if count < 2 or not on_plate.any():
        return cloth, 0
    main = np.bincount(pieces[on_plate]).argmax()
    kept = cloth & (pieces == main)
    sizes = np.bincount(pieces[cloth], minlength=count + 1)
    sizes[main] = 0
    return kept, int(sizes[sizes > _SPECK * kept.sum()].sum())


def _completed(cloth: np.ndarray, solid: np.ndarray) -> np.ndarray:
    """The mask (H, W) of ``cloth``: unseen pixels go with most of those around, holes are filled.

    ``solid``: where the sensor saw a surface.
    """
    votes = [ndimage.gaussian_filter(part.astype(np.float32), _VOTE, truncate=2.0)
             for part in (cloth, solid & ~cloth)]
    mask = cloth | (~solid & (votes[0] > votes[1]))
    holes, count = ndimage.label(ndimage.binary_fill_holes(mask) & ~mask)
    if count:
        seen = ndimage.sum_labels(solid, holes, np.arange(1, count + 1))
        sizes = np.bincount(holes.ravel())[1:]
        small = (sizes < _HOLE * mask.sum()) & (seen == 0)
        mask |= np.isin(holes, 1 + np.flatnonzero(small))
    return mask
