"""Geometric segmentation of the cloth in frames of a full scene.

    plate and table -> reach of the cloth -> removal of the column -> masks

Cloth is nearly inextensible: no point of it is farther from the plate's rim than the overhang. This
region contains the cloth and the column under the plate. Pixels without depth get the label of
surrounding pixels in the mask; their depth stays unknown.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from common.errors import InputError
from data.captures.pictures import neighbours
from data.captures.plate import Plate, find_plate
from data.render.cameras import Intrinsics
from sim.rig import Rig

MAX_CLOTH_SHARE = 0.9  # of a picture's pixels
SCENE_DEPTHS = (0.1, 10.0)  # m, plausible median depth of a scene
_MAX_BORDER_SHARE = 0.4  # of the pixels at the picture's border
_MAX_FAR_SHARE = 0.15  # of a frame's points
_REACH_TOLERANCE = 0.010  # m, for offset and size of the specimen and errors of depth
_PLATE_TOLERANCE = 0.010  # m above the plate, for noise and thick cloth
_TABLE_TOLERANCE = 8e-3  # m above the table, for noise
_MAX_STEP = 8e-3  # m at 0.5 m, between neighbouring pixels of a surface
_MIN_NEIGHBOURS = 2  # of eight, at similar depth, of a pixel on a surface
_VOTE_SIGMA = 1.0  # pixels, of the Gaussian window in which neighbours label a pixel without depth
_MAX_HOLE_SHARE = 0.01  # of the cloth's pixels: smaller holes are filled
_MAX_SPECK_SHARE = 0.003  # of the cloth's pixels: smaller pieces are removed without warning
_COLUMN_BELOW = 0.015  # m below the plate, highest point where the column is searched
_MIN_COLUMN_PIXELS = 30  # of all frames
_MAX_COLUMN_SPREAD = 4e-3  # m, of the radius of a round column
_COLUMN_MARGIN = 1.5e-3, 4e-3  # m, limits of the tolerance added to the column's radius
_MIN_CHANGE = 4e-3  # m at 0.5 m, by which cloth is nearer than the empty scene
_MAX_SAME_SHARE = 0.5  # of the candidate cloth; above it the background shows cloth
_MAX_MOVED_SHARE = 0.3  # of the static pixels; above it the camera has moved


@dataclass(frozen=True)
class CutOut:
    """The segmented cloth of frames.

    Attributes:
        frames: (K, H, W) m, as given.
        masks: (K, H, W) bool, cloth, including pixels without depth.
        views: (K, H, W) float32 m, depth of the cloth, 0 elsewhere and where it is unknown.
        plate: None if it was not found in frames that show only cloth.
        column: radius of the column under the plate, m; None if it is not visible.
        warnings: one line each.
    """

    frames: np.ndarray
    masks: np.ndarray
    views: np.ndarray
    plate: Plate | None
    column: float | None
    warnings: tuple[str, ...]


def is_raw(frame: np.ndarray, intrinsics: Intrinsics, rig: Rig) -> bool:
    """Whether a frame (H, W), m, shows more than cloth: depth fills the picture or its border, or
    many points are farther away from the median point than the size of the specimen.
    """
    seen = frame > 0
    # Depth in a wrong unit is reported by data.captures.capture.
    if not seen.any() or not SCENE_DEPTHS[0] < np.median(frame[seen]) < SCENE_DEPTHS[1]:
        return False
    border = np.concatenate([seen[0], seen[-1], seen[:, 0], seen[:, -1]])
    if seen.mean() > MAX_CLOTH_SHARE or border.mean() > _MAX_BORDER_SHARE:
        return True
    points = intrinsics.back_project(frame)[seen]
    size = 2 * rig.reach
    distance = np.linalg.norm(points - np.median(points, axis=0), axis=1)
    # A small distant piece is reported by data.captures.capture.
    return bool((distance > size).mean() > _MAX_FAR_SHARE)


def cut_out(
    frames: np.ndarray, intrinsics: Intrinsics, rig: Rig, background: np.ndarray | None = None
) -> CutOut:
    """Segment the cloth in frames (K, H, W), z-depth in m, 0 where depth is missing.

    Frames that show only cloth are returned unchanged.

    Args:
        intrinsics: of the frames, taken by one static camera.
        rig: with a plate.
        background: (H, W) m, the same scene with the tester but without cloth.

    Raises:
        InputError: no plate of the rig with cloth is found, or only part of the frames show the
            full scene.
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
            f"the frames (median depth {median:.3g} m); check tester, depth_unit_m and intrinsics, "
            "or set every pixel that is not cloth to 0")
    warnings = [] if plate.table is not None else [
        "no table is seen below the plate; look with python -m data.captures.preview whether "
        "only cloth is cut out"]
    local = plate.local(points)
    radius, height = np.hypot(local[..., 0], local[..., 1]), local[..., 2]
    solid = seen & _on_surface(frames)
    cloth = solid & _within_reach(radius, height, rig)
    standing = solid
    if plate.table is not None:
        over = points @ plate.table[:3] + plate.table[3]
        cloth &= over > _TABLE_TOLERANCE
        standing = solid & (over > 2 * _TABLE_TOLERANCE)
    column = None
    if background is None:
        column = _column_radius(radius[standing], height[standing], rig)
        if column is not None:
            cloth &= ~_column(cloth, radius, height, column, rig)
            if column > rig.plate_radius - 2 * _COLUMN_MARGIN[1]:
                warnings.append("the column is nearly as wide as the plate: where cloth touches it "
                              "the hem may be wrong; look at it with "
                              "python -m data.captures.preview")
    else:
        # On the plate and at its rim, cloth is only its thickness nearer than the background.
        top = (radius < rig.plate_radius + _REACH_TOLERANCE) & (np.abs(height) < _PLATE_TOLERANCE)
        unchanged = (background > 0) & (background - frames < _MIN_CHANGE * frames / 0.5)
        same = cloth & unchanged & ~top
        still = solid & (background > 0) & ~_within_reach(radius, height, rig)
        warnings += _background_warnings(frames, background, cloth, same, still)
        cloth &= ~_without_cloth_below(same, cloth)
    masks = np.empty_like(cloth)
    for k in range(len(frames)):
        on_plate = cloth[k] & (radius[k] < rig.plate_radius) & (
            np.abs(height[k]) < _PLATE_TOLERANCE)
        kept, apart = _one_piece(cloth[k], on_plate)
        if apart:
            warnings.append(f"view {k}: {apart} pixels within the cloth's reach are apart from it "
                          "and left out; look at them with python -m data.captures.preview")
        cloth[k] = kept
        masks[k] = _completed(kept, solid[k])
    views = np.where(cloth & masks, frames, np.float32(0.0))
    return CutOut(frames, masks, views, plate, column, tuple(warnings))


def _background_warnings(
    frames: np.ndarray, background: np.ndarray, cloth: np.ndarray, same: np.ndarray,
    still: np.ndarray,
) -> list[str]:
    """Warnings if ``background`` (H, W), m, is inconsistent with frames (K, H, W), m.

    Pixel masks (K, H, W) bool: ``cloth``, candidates; ``same``, candidates with the depth of the
    background; ``still``, pixels outside the cloth's reach, which should be static.
    """
    warnings = []
    share = (same.sum(axis=(1, 2)) / np.maximum(cloth.sum(axis=(1, 2)), 1)).max()
    if share > _MAX_SAME_SHARE:
        warnings.append(f"background.png shows {share:.0%} of what a view has within the cloth's "
                      f"reach (limit {_MAX_SAME_SHARE:.0%}): take it without cloth, and every view "
                      "with it")
    moved = np.abs(frames - background) > 3 * _MIN_CHANGE * frames / 0.5
    if still.any() and moved[still].mean() > _MAX_MOVED_SHARE:
        warnings.append("background.png does not fit the frames: the camera or the scene has "
                      "moved between them; take it again")
    return warnings


def _within_reach(radius: np.ndarray, height: np.ndarray, rig: Rig) -> np.ndarray:
    """Whether cloth can reach points at ``radius`` from the plate's axis, ``height`` above it, m.
    """
    beyond = np.maximum(radius - rig.plate_radius, 0.0)
    return (height < _PLATE_TOLERANCE) & (
        np.hypot(beyond, height) < rig.overhang + _REACH_TOLERANCE)


def _on_surface(frames: np.ndarray) -> np.ndarray:
    """(K, H, W) bool, pixels with neighbours at similar depth: not flying pixels between surfaces.
    """
    alike = np.abs(neighbours(frames) - frames) < _MAX_STEP * frames / 0.5
    return alike.sum(axis=0) >= _MIN_NEIGHBOURS


def _column_radius(radius: np.ndarray, height: np.ndarray, rig: Rig) -> float | None:
    """Radius of the column, m, from surface points inside the plate's rim or below the cloth."""
    low = rig.overhang + _REACH_TOLERANCE
    inside = (height < -_COLUMN_BELOW) & (radius < rig.plate_radius - _COLUMN_MARGIN[1])
    below = (height < -low) & (height > -low - 0.1) & (
        radius < rig.plate_radius + 2 * _COLUMN_MARGIN[1])
    found = radius[(inside & (height > -low)) | below]
    if len(found) < _MIN_COLUMN_PIXELS:
        return None
    low_quarter, middle, high_quarter = np.quantile(found, [0.25, 0.5, 0.75])
    return float(middle) if high_quarter - low_quarter < 2 * _MAX_COLUMN_SPREAD else None


def _column(
    cloth: np.ndarray, radius: np.ndarray, height: np.ndarray, column: float, rig: Rig
) -> np.ndarray:
    """(K, H, W) bool, candidates for ``cloth`` that are column: near it, without cloth below."""
    near = np.clip((rig.plate_radius - column) / 2, *_COLUMN_MARGIN)
    return _without_cloth_below(
        cloth & (radius < column + near) & (height < -_COLUMN_BELOW), cloth)


def _without_cloth_below(like: np.ndarray, cloth: np.ndarray) -> np.ndarray:
    """(K, H, W) bool, those of the candidates ``like`` column that have no other ``cloth`` below
    them in the picture; cloth that touches the column continues below.
    """
    other = np.flip(cloth & ~like, axis=1)
    return like & ~np.flip(np.maximum.accumulate(other, axis=1), axis=1)


def _one_piece(cloth: np.ndarray, on_plate: np.ndarray) -> tuple[np.ndarray, int]:
    """The part of ``cloth`` (H, W) that is connected to the plate in the picture, and the number of
    pixels of larger disconnected pieces.
    """
    pieces, count = ndimage.label(ndimage.binary_dilation(cloth))
    if count < 2 or not on_plate.any():
        return cloth, 0
    main = np.bincount(pieces[on_plate]).argmax()
    kept = cloth & (pieces == main)
    sizes = np.bincount(pieces[cloth], minlength=count + 1)
    sizes[main] = 0
    return kept, int(sizes[sizes > _MAX_SPECK_SHARE * kept.sum()].sum())


def _completed(cloth: np.ndarray, solid: np.ndarray) -> np.ndarray:
    """The mask (H, W) of ``cloth`` with holes filled, and pixels without depth labelled as the
    majority of their neighbours.

    ``solid``: pixels with the depth of a surface.
    """
    votes = [ndimage.gaussian_filter(part.astype(np.float32), _VOTE_SIGMA, truncate=2.0)
             for part in (cloth, solid & ~cloth)]
    mask = cloth | (~solid & (votes[0] > votes[1]))
    holes, count = ndimage.label(ndimage.binary_fill_holes(mask) & ~mask)
    if count:
        seen = ndimage.sum_labels(solid, holes, np.arange(1, count + 1))
        sizes = np.bincount(holes.ravel())[1:]
        small = (sizes < _MAX_HOLE_SHARE * mask.sum()) & (seen == 0)
        mask |= np.isin(holes, 1 + np.flatnonzero(small))
    return mask
