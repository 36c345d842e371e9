"""Geometric segmentation of the cloth in frames of a full scene.

    plate and table -> reach of the cloth -> removal of the column -> masks

Cloth is nearly inextensible: no point of it is farther from the plate's rim than the overhang. This
region contains the cloth and the column under the plate.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from common.errors import InputError
from common.findings import Finding
from common.types import DepthImage, Mask, Masks, Metres, Views
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
    """The segmented cloth of frames."""

    frames: Views
    masks: Masks  # cloth, including pixels without depth
    views: Views  # depth of the cloth
    plate: Plate
    column: Metres | None = None  # radius, if it is visible
    warnings: tuple[Finding, ...] = ()


@dataclass(frozen=True)
class _Scene:
    """Points of all pixels of the frames, about the plate of ``rig``."""

    frames: Views
    rig: Rig
    solid: Masks  # pixels that show a surface
    radius: np.ndarray  # (K, H, W) m, from the plate's axis
    height: np.ndarray  # (K, H, W) m, above the plate
    over: np.ndarray  # (K, H, W) m, above the table; infinite if none is visible

    @property
    def within_reach(self) -> Masks:
        """Whether cloth can reach the points."""
        beyond = np.maximum(self.radius - self.rig.plate_radius, 0.0)
        return (self.height < _PLATE_TOLERANCE) & (
            np.hypot(beyond, self.height) < self.rig.overhang + _REACH_TOLERANCE)

    def on_plate(self, margin: Metres = 0.0) -> Masks:
        """Whether the points lie on the plate, or up to ``margin`` beyond its rim."""
        return (self.radius < self.rig.plate_radius + margin) & (
            np.abs(self.height) < _PLATE_TOLERANCE)


def shows_scene(frame: DepthImage, intrinsics: Intrinsics, rig: Rig) -> bool:
    """Whether a frame shows more than cloth: depth fills the picture or its border, or many points
    are farther away from the median point than the size of the specimen.
    """
    visible = frame > 0
    # Depth in a wrong unit is reported by data.captures.capture.
    if not visible.any() or not SCENE_DEPTHS[0] < np.median(frame[visible]) < SCENE_DEPTHS[1]:
        return False
    border = np.concatenate([visible[0], visible[-1], visible[:, 0], visible[:, -1]])
    if visible.mean() > MAX_CLOTH_SHARE or border.mean() > _MAX_BORDER_SHARE:
        return True
    points = intrinsics.back_project(frame)[visible]
    distance = np.linalg.norm(points - np.median(points, axis=0), axis=1)
    # A small distant piece is reported by data.captures.capture.
    return bool((distance > 2 * rig.reach).mean() > _MAX_FAR_SHARE)


def cut_out(
    frames: Views, intrinsics: Intrinsics, rig: Rig, background: DepthImage | None = None
) -> CutOut | None:
    """Segment the cloth in frames of one static camera; None if they show only cloth.

    ``background``: the same scene with the tester but without cloth.
    """
    whole = [shows_scene(frame, intrinsics, rig) for frame in frames]
    if not any(whole):
        return None
    if not all(whole):
        raise InputError(f"view {whole.index(True)} shows the whole scene (has no background) but "
                         f"view {whole.index(False)} is cut out; give all views of one kind")
    points = intrinsics.back_project(frames)
    plate = find_plate(points[frames > 0], rig)
    if plate is None:
        raise InputError(
            f"no plate of {1e3 * rig.plate_diameter:g} mm diameter with cloth on it was found in "
            f"the frames (median depth {np.median(frames[frames > 0]):.3g} m); check tester, "
            "depth_unit_m and intrinsics, or set every pixel that is not cloth to 0")
    scene = _scene(frames, points, plate, rig)
    warnings = [] if plate.table is not None else [Finding("table_unseen")]
    cloth, column = scene.solid & scene.within_reach & (scene.over > _TABLE_TOLERANCE), None
    if background is None:
        column = _column_radius(scene)
        if column is not None:
            cloth &= ~_column(cloth, scene, column)
            if column > rig.plate_radius - 2 * _COLUMN_MARGIN[1]:
                warnings.append(Finding("column_wide"))
    else:
        same = _unchanged(cloth, scene, background)
        warnings += _background_warnings(scene, background, cloth, same)
        cloth &= ~_without_cloth_below(same, cloth)
    masks = np.empty_like(cloth)
    for k, on_plate in enumerate(cloth & scene.on_plate()):
        cloth[k], apart = _one_piece(cloth[k], on_plate)
        masks[k] = _completed(cloth[k], scene.solid[k])
        if apart:
            warnings.append(Finding("pieces_left_out", {"view": k, "value": int(apart)}))
    views = np.where(cloth & masks, frames, np.float32(0.0))
    return CutOut(frames, masks, views, plate, column, tuple(warnings))


def _scene(frames: Views, points: np.ndarray, plate: Plate, rig: Rig) -> _Scene:
    local = plate.local(points)
    alike = np.abs(neighbours(frames) - frames) < _MAX_STEP * frames / 0.5
    surface = alike.sum(axis=0) >= _MIN_NEIGHBOURS  # no flying pixel between surfaces
    over = np.full(frames.shape, np.inf)
    if plate.table is not None:
        over = points @ plate.table[:3] + plate.table[3]
    return _Scene(frames, rig, (frames > 0) & surface, np.hypot(local[..., 0], local[..., 1]),
                  local[..., 2], over)


def neighbours(pictures: np.ndarray) -> np.ndarray:
    """The eight neighbours (8, ..., H, W) of each pixel of pictures (..., H, W); 0 outside."""
    height, width = pictures.shape[-2:]
    padded = np.pad(pictures, [(0, 0)] * (pictures.ndim - 2) + [(1, 1), (1, 1)])
    return np.stack([padded[..., i : i + height, j : j + width]
                     for i in range(3) for j in range(3) if (i, j) != (1, 1)])


def _unchanged(cloth: Masks, scene: _Scene, background: DepthImage) -> Masks:
    """Candidates for ``cloth`` that have the depth of the empty scene."""
    # On the plate and at its rim, cloth is only its thickness nearer than the background.
    frames = scene.frames
    unchanged = (background > 0) & (background - frames < _MIN_CHANGE * frames / 0.5)
    return cloth & unchanged & ~scene.on_plate(_REACH_TOLERANCE)


def _background_warnings(
    scene: _Scene, background: DepthImage, cloth: Masks, same: Masks
) -> list[Finding]:
    """Warnings if the background does not belong to the frames; ``same``: :func:`_unchanged`."""
    warnings = []
    share = float((same.sum(axis=(1, 2)) / np.maximum(cloth.sum(axis=(1, 2)), 1)).max())
    if share > _MAX_SAME_SHARE:
        warnings.append(Finding("background_with_cloth",
                                {"value": share, "limit": _MAX_SAME_SHARE}))
    static = scene.solid & (background > 0) & ~scene.within_reach
    moved = np.abs(scene.frames - background) > 3 * _MIN_CHANGE * scene.frames / 0.5
    if static.any() and moved[static].mean() > _MAX_MOVED_SHARE:
        warnings.append(Finding("background_moved"))
    return warnings


def _column_radius(scene: _Scene) -> Metres | None:
    """Radius of the column, from surface points inside the plate's rim or below the cloth."""
    radius, height, rim = scene.radius, scene.height, scene.rig.plate_radius
    low = scene.rig.overhang + _REACH_TOLERANCE
    inside = (height < -_COLUMN_BELOW) & (radius < rim - _COLUMN_MARGIN[1]) & (height > -low)
    below = (height < -low) & (height > -low - 0.1) & (radius < rim + 2 * _COLUMN_MARGIN[1])
    standing = scene.solid & (scene.over > 2 * _TABLE_TOLERANCE)
    radii = radius[(inside | below) & standing]
    if len(radii) < _MIN_COLUMN_PIXELS:
        return None
    low_quarter, middle, high_quarter = np.quantile(radii, [0.25, 0.5, 0.75])
    return float(middle) if high_quarter - low_quarter < 2 * _MAX_COLUMN_SPREAD else None


def _column(cloth: Masks, scene: _Scene, column: Metres) -> Masks:
    """Candidates for ``cloth`` that are column: near it, without cloth below."""
    margin = np.clip((scene.rig.plate_radius - column) / 2, *_COLUMN_MARGIN)
    near = (scene.radius < column + margin) & (scene.height < -_COLUMN_BELOW)
    return _without_cloth_below(cloth & near, cloth)


def _without_cloth_below(column: Masks, cloth: Masks) -> Masks:
    """Candidates for ``column`` without cloth below, as cloth that touches the column has."""
    rest = np.flip(cloth & ~column, axis=1)
    return column & ~np.flip(np.maximum.accumulate(rest, axis=1), axis=1)


def _one_piece(cloth: Mask, on_plate: Mask) -> tuple[Mask, int]:
    """The part of ``cloth`` connected to the plate, and the pixels of larger other pieces."""
    pieces, count = ndimage.label(ndimage.binary_dilation(cloth))
    if count < 2 or not on_plate.any():
        return cloth, 0
    main = np.bincount(pieces[on_plate]).argmax()
    kept = cloth & (pieces == main)
    sizes = np.bincount(pieces[cloth], minlength=count + 1)
    sizes[main] = 0
    return kept, int(sizes[sizes > _MAX_SPECK_SHARE * kept.sum()].sum())


def _completed(cloth: Mask, solid: Mask) -> Mask:
    """The mask of ``cloth``, holes filled, other pixels than ``solid`` as most neighbours."""
    votes = [ndimage.gaussian_filter(part.astype(np.float32), _VOTE_SIGMA, truncate=2.0)
             for part in (cloth, solid & ~cloth)]
    mask = cloth | (~solid & (votes[0] > votes[1]))
    holes, count = ndimage.label(ndimage.binary_fill_holes(mask) & ~mask)
    if count:
        surface = ndimage.sum_labels(solid, holes, np.arange(1, count + 1))
        sizes = np.bincount(holes.ravel())[1:]
        small = (sizes < _MAX_HOLE_SHARE * mask.sum()) & (surface == 0)
        mask |= np.isin(holes, 1 + np.flatnonzero(small))
    return mask
