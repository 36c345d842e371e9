"""Checks of depth views of one specimen: size, distance, specks, and what is missing."""

import numpy as np
from scipy import ndimage

from common.errors import InputError, shown
from common.findings import Finding
from common.types import DepthImage, Views
from data.captures.cutout import neighbours
from data.captures.description import MAX_VIEWS
from data.render.cameras import Intrinsics

DISTANCE_RANGE = (0.2, 2.0)  # m, of the cloth; otherwise the depth unit is wrong
CLOTH_SHARE = (0.005, 0.9)  # of a picture's pixels
MIN_AREA = 0.6  # of the median of the views' cloth
MAX_SPECK_SHARE = 0.01  # of the cloth's pixels; smaller separate pieces are removed
OUTLIER_STEP = 0.025  # m, depth difference from the neighbours
MAX_OUTLIER_SHARE = 0.003  # of the cloth's pixels, usual for sensors; more cause a warning
MIN_SPECK_GAP = 3.0  # pixels from the cloth; nearer specks are harmless noise at its edge


def require_sizes(views: Views, intrinsics: Intrinsics | None) -> Intrinsics:
    """The intrinsics; InputError unless the views are of their size."""
    if not isinstance(intrinsics, Intrinsics):
        raise InputError("depth views need the intrinsics of their camera, Intrinsics(fx=..., "
                         f"fy=..., cx=..., cy=..., width=..., height=...), not {shown(intrinsics)}")
    count, *size = np.shape(views)
    if not 1 <= count <= MAX_VIEWS or size != [intrinsics.height, intrinsics.width]:
        raise InputError(f"views have the shape {np.shape(views)}; give 1 to {MAX_VIEWS} of the "
                         f"intrinsics' size, {intrinsics.height} x {intrinsics.width} pixels")
    return intrinsics


def checked_views(views: Views, camera: Intrinsics) -> tuple[Views, tuple[Finding, ...]]:
    """Views without specks, and warnings of them and their camera; InputError for a wrong size or
    distance of the cloth."""
    views, warnings = views.copy(), [*camera.questions]
    for k, view in enumerate(views):
        warnings += _remove_isolated(view, k)
        warnings += _remove_specks(view, k)
        cloth = view > 0
        if not cloth.any():
            raise InputError(f"view {k} shows no cloth: all pixels are background or specks; take "
                             "the view again")
        if cloth.mean() < CLOTH_SHARE[0]:
            raise InputError(
                f"view {k} shows only {cloth.sum()} pixels of cloth, at least "
                f"{CLOTH_SHARE[0] * cloth.size:.0f} are needed; move the camera nearer")
        distance = float(np.median(view[cloth]))
        if not DISTANCE_RANGE[0] <= distance <= DISTANCE_RANGE[1]:
            raise InputError(
                f"view {k}: the cloth is {distance:.4g} m from the camera; it must be "
                f"{DISTANCE_RANGE[0]:g} to {DISTANCE_RANGE[1]:g} m away: check depth_unit_m "
                "(0.001 for millimetres)")
        if cloth.mean() > CLOTH_SHARE[1]:
            raise InputError(
                f"view {k} has no background; set every pixel that is not cloth to 0")
        if np.concatenate([cloth[0], cloth[-1], cloth[:, 0], cloth[:, -1]]).any():
            warnings.append(Finding("border_touched", {"view": k}))
    areas = (views > 0).sum(axis=(1, 2))
    if areas.min() < MIN_AREA * np.median(areas):
        warnings.append(Finding("view_small", {
            "view": int(areas.argmin()), "value": int(areas.min()), "limit": MIN_AREA,
            "median": float(np.median(areas))}))
    return views, tuple(warnings)


def _remove_isolated(view: DepthImage, number: int) -> list[Finding]:
    """Set isolated outliers of a view to background, in place; return warnings.

    Depth also jumps at folds, but there a pixel has two neighbours of similar depth.
    """
    cloth = view > 0
    adjacent = neighbours(view)
    near = ((np.abs(adjacent - view) < OUTLIER_STEP) & (adjacent > 0)).sum(axis=0)
    isolated = cloth & (near < 2) & (ndimage.median_filter(cloth.astype(np.uint8), 3) > 0)
    view[isolated] = 0
    if isolated.sum() <= MAX_OUTLIER_SHARE * cloth.sum():
        return []
    return [Finding("outliers_left_out", {"view": number, "value": int(isolated.sum())})]


def _remove_specks(view: DepthImage, number: int) -> list[Finding]:
    """Set small pieces of a view apart from its cloth to background, in place; return warnings.

    A single distant pixel, as from a time-of-flight sensor, may move the measured hem.
    """
    pieces, count = ndimage.label(view > 0, structure=np.ones((3, 3)))
    if count < 2:
        return []
    sizes = np.bincount(pieces.ravel())[1:]
    cloth = 1 + int(sizes.argmax())
    gap = ndimage.minimum(ndimage.distance_transform_edt(pieces != cloth), pieces,
                          index=np.arange(1, count + 1))
    apart = gap > MIN_SPECK_GAP
    specks = apart & (sizes < MAX_SPECK_SHARE * sizes.max())
    warnings = []
    view[np.isin(pieces, 1 + np.flatnonzero(specks))] = 0
    if (removed := int(sizes[specks].sum())) > MAX_OUTLIER_SHARE * sizes.sum():
        warnings.append(Finding("specks_left_out", {"view": number, "value": removed}))
    if large := int(sizes[apart & ~specks].sum()):
        warnings.append(Finding("pieces_apart", {"view": number, "value": large}))
    return warnings
