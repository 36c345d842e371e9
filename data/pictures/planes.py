"""Homographies between pictures and planes that they show."""

import cv2
import numpy as np


def mapped(points: np.ndarray, homography: np.ndarray) -> np.ndarray:
    """Points (N, 2), m or pixels, mapped by a homography (3, 3)."""
    return cv2.perspectiveTransform(np.asarray(points, np.float64)[:, None], homography)[:, 0]


def on_grid(places: np.ndarray, homography: np.ndarray) -> np.ndarray:
    """The same of places (H, W, 2)."""
    return mapped(places.reshape(-1, 2), homography).reshape(places.shape)


def behind(places: np.ndarray, eye: np.ndarray, height: float | np.ndarray) -> np.ndarray:
    """Places (..., 2) on the ground that an ``eye`` (3,) over it sees behind ``places`` (..., 2) at
    a ``height`` (... or 1), m."""
    return eye[:2] + (places - eye[:2]) * (eye[2] / (eye[2] - height))


def shifted(offset: np.ndarray) -> np.ndarray:
    """Homography (3, 3) that moves points by an offset (2,)."""
    return np.array([[1, 0, offset[0]], [0, 1, offset[1]], [0, 0, 1]])


def upright(to_metres: np.ndarray, pixel: np.ndarray) -> tuple[np.ndarray, float]:
    """A homography (3, 3) turned such that at a ``pixel`` (2,) x is to the right and y up in the
    picture, and the angle, rad, between line of sight and vertical there, by the ratio of its
    scales."""
    points = mapped(pixel + np.array([[0, 0], [1, 0], [0, 1]]), to_metres)
    right, down = points[1:] - points[0]
    flip = 1.0 if right[0] * down[1] < right[1] * down[0] else -1.0
    cos, sin = right * [1, flip] / np.linalg.norm(right)
    turn = np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
    scales = np.linalg.svd(np.stack([right, down]), compute_uv=False)
    return turn @ np.diag([1, flip, 1]) @ to_metres, float(np.arccos(scales[1] / scales[0]))
