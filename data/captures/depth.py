"""Depth pictures: values that are no measurements, gaps between points, lens distortion."""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy import ndimage

from common.errors import InputError
from common.types import DepthImage
from data.render.cameras import Intrinsics

MAX_DEPTH = 100.0  # m; larger values have another unit or are invalid
SATURATED = 65535  # counts, written by cameras where depth is missing
_UNMEASURED = 65_000.0  # m or mm; from here on constants for missing depth: 65504, 65535, 1e10
_MIN_BACKGROUND = 0.01  # share of pixels with the largest value, beyond MAX_DEPTH, of a background
_MAX_STEP = 0.016  # share of the depth, between neighbouring pixels of a surface
_MIN_BESIDE = 0.7  # share of a picture's points with a neighbour, in rows and columns
_NEGLIGIBLE = 1e-3  # coefficient of lens distortion
_MODELS = {"plumb_bob": (4, 5), "rational_polynomial": (8, 12, 14)}  # numbers of coefficients


def unsaturated(counts: np.ndarray) -> np.ndarray:
    """Counts (H, W), 0 where saturated."""
    return np.where(counts >= SATURATED, 0, counts)


def measured(depth: np.ndarray) -> np.ndarray:
    """Depth (...,), m, 0 where it is not finite or positive, or a constant for missing depth."""
    depth = np.where(np.isfinite(depth) & (depth > 0) & (depth < _UNMEASURED), depth, 0)
    background = depth == max(depth.max(initial=0), MAX_DEPTH)
    if _MIN_BACKGROUND < background.mean() < (depth > 0).mean():
        depth = np.where(background, 0, depth)
    return depth.astype(np.float32)


def median_depth(frames: np.ndarray) -> np.ndarray:
    """Median (H, W) float32 of frames (N, H, W) per pixel, without zeros (missing depth)."""
    values = np.ma.masked_equal(frames.astype(np.float32), 0.0)
    return np.ma.filled(np.ma.median(values, axis=0), 0.0)


@dataclass(frozen=True)
class Lens:
    """A lens that distorts pictures, with OpenCV's coefficients."""

    coefficients: tuple[float, ...]

    @classmethod
    def of(cls, model: str, coefficients: np.ndarray) -> "Lens | None":
        """The lens of a model that ROS names and its coefficients (N,); None without distortion."""
        if not (largest := np.abs(coefficients).max(initial=0)) > _NEGLIGIBLE:
            return None
        if len(coefficients) not in _MODELS.get(model, ()):
            raise InputError(f"the lens model {model[:40]!r} with {len(coefficients)} coefficients "
                             f"up to {largest:.3g} is not one of {', '.join(_MODELS)}; record "
                             "undistorted depth")
        return cls(tuple(map(float, coefficients)))

    def undistorted(self, picture: np.ndarray, camera: Intrinsics) -> np.ndarray:
        """A picture (H, W) of depth, or uint8 grey, as ``camera`` without distortion shows it."""
        matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])
        maps = cv2.initUndistortRectifyMap(matrix, np.array(self.coefficients), None, matrix,
                                           picture.shape[::-1], cv2.CV_32FC1)
        smooth, nearest = (cv2.remap(picture, *maps, way)
                           for way in (cv2.INTER_LINEAR, cv2.INTER_NEAREST))
        if picture.dtype == np.uint8:
            return smooth
        # Depth is interpolated on a surface, not across its border or into holes.
        step = cv2.morphologyEx(picture, cv2.MORPH_GRADIENT, np.ones((3, 3)))
        flat = cv2.remap(step, *maps, cv2.INTER_NEAREST) < 2 * _MAX_STEP * nearest
        return np.where(flat, smooth, nearest)


def between_points(depth: DepthImage) -> tuple[DepthImage, float]:
    """Depth of the nearest point in the gaps of a picture whose points are sparser than its pixels,
    and their spacing, pixels: of depth aligned to a larger picture, and of thinned clouds.
    """
    points = depth > 0
    beside = min((points & np.roll(points, 1, axis)).sum() for axis in (0, 1))
    if beside >= _MIN_BESIDE * points.sum():
        return depth, 1.0
    rows, columns = ndimage.distance_transform_edt(
        ~points, return_distances=False, return_indices=True)
    areas = np.bincount((rows * depth.shape[1] + columns).ravel(), minlength=depth.size)
    spacing = float(np.sqrt(np.median(areas[points.ravel()])))
    # Closing does not widen the border of the points.
    surface = ndimage.binary_closing(points, np.ones([2 * round(spacing) + 1] * 2))
    return np.where(surface, depth[rows, columns], np.float32(0)), spacing
