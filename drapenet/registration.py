"""What can be read from a capture without a network: where the camera stood, and the folds."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.signal import find_peaks

from data.cameras import Camera
from data.render import QUARTERS
from data.setups import Setups
from sim.scene import Rig

DEPTH_STEP = 4e-3  # m, of the coarsest depth format
INNER = 0.7  # of the plate's radius, where the cloth lies flat on it
_SAMPLE = 6000  # points that the plate is looked for in
_PITCHES = np.radians([25.0, 32.0, 38.0, 44.0, 50.0])
"""How far cameras may look down: the search for the plate begins with each."""
FOLD_PROMINENCE = 3e-3  # m; smaller ripples of the radius are depth steps, not folds
TILT, SHIFT = np.radians(2.0), 0.020
"""rad and m, how far beyond the cameras trained with one may be found: the errors of finding it."""


def locate_camera(
    views: np.ndarray, nominal: Camera, *, plate_radius: float = Rig().plate_radius
) -> Camera:
    """The camera's pose relative to the plate, from the flat top of the drape.

    The plate's plane is fitted to the highest points, its centre is the centroid of the points
    on it. Pooling all views makes that centroid symmetric, whatever the drape.

    Args:
        views: (K, H, W) z-depth, m, background 0, of the nominal camera's size.
        nominal: its intrinsics are kept.
        plate_radius: m.

    Returns:
        ``nominal`` with the pose found, its world x axis parallel to the picture's rows.
    """
    points = np.concatenate([nominal.back_project(view)[view > 0] for view in views])
    few = points[:: max(1, len(points) // _SAMPLE)]
    starts = [_plate(few, np.array([0.0, -np.cos(pitch), -np.sin(pitch)]), plate_radius, rounds=4)
              for pitch in _PITCHES]
    # On the plate lie more points than on any other plane, counted by their area.
    normal = max(starts, key=lambda plate: plate[2])[0]
    normal, centre, _ = _plate(few, normal, plate_radius, rounds=6)
    normal, centre, _ = _plate(points, normal, plate_radius, rounds=2, centre=centre)
    east = np.array([1.0, 0.0, 0.0]) - normal[0] * normal
    east /= max(np.linalg.norm(east), 1e-12)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([east, np.cross(normal, east), normal], axis=1)
    pose[:3, 3] = centre
    return replace(nominal, world_to_camera=pose)


def _plate(
    points: np.ndarray, normal: np.ndarray, radius: float, *, rounds: int,
    centre: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, float]:
    """Normal and centre of the plate under points (N, 3), camera axes, and how much lies on it.

    Args:
        normal: first guess, up. centre: the same; None takes the highest points'.
    """
    height = points @ normal
    on_plate = height > np.quantile(height, 0.995) - 3 * DEPTH_STEP
    inner = on_plate
    if centre is None:
        centre = points[on_plate].mean(axis=0)
    else:
        inner = (np.linalg.norm(points - centre, axis=1) < INNER * radius) & on_plate
    weight = 0.0
    for _ in range(rounds):
        if inner.sum() < 3:
            break  # no plane through so few: whatever this is, it is not a drape on a plate
        middle = points[inner].mean(axis=0)
        offsets = points[inner] - middle
        normal = np.linalg.eigh(offsets.T @ offsets)[1][:, 0]
        normal *= -np.sign(normal @ middle)  # up is towards the camera
        above = (points - middle) @ normal
        on_plate = (np.abs(above) < DEPTH_STEP / 2) & (
            np.linalg.norm(points - centre, axis=1) < 2 * radius)
        if not on_plate.any():
            break
        # Pixels are denser where the plate is nearer; z³ undoes that on a plane.
        weights = points[on_plate, 2] ** 3
        centre = weights @ points[on_plate] / weights.sum()
        weight = float(weights.sum())
        # Near the rim the cloth bends down already, and more of it is seen in front.
        inner = (np.linalg.norm(points - centre, axis=1) < INNER * radius) & (above > -DEPTH_STEP)
    return normal, centre, weight


def camera_doubts(camera: Camera, setups: Setups) -> list[str]:
    """What to say, a line each, of a ``camera`` found elsewhere than in the ``setups`` that the
    network was trained on.
    """
    up, centre = camera.world_to_camera[:3, 2], camera.world_to_camera[:3, 3]
    pitch = np.arcsin(np.clip(-up[2], -1.0, 1.0))
    distance = float(np.linalg.norm(centre))
    low, high = np.degrees(setups.pitch)
    near, far = setups.distance
    doubts = []
    if not setups.pitch[0] - TILT < pitch < setups.pitch[1] + TILT:
        doubts.append(f"the plate is seen from {np.degrees(pitch):.0f}° above the horizontal "
                      f"(limits {low:.0f}° to {high:.0f}°): check that the pictures "
                      "are upright, their intrinsics, and the camera's place")
    if not near - SHIFT < distance < far + SHIFT:
        doubts.append(f"the plate is {1e3 * distance:.0f} mm away (limits "
                      f"{1e3 * near:.0f} to {1e3 * far:.0f} mm): check the depth unit, the "
                      "intrinsics and the camera's place")
    return doubts


def radius_profile(
    views: np.ndarray, camera: Camera, *, height: float, turns: Sequence[float] = QUARTERS,
    bins: int = 180,
) -> np.ndarray:
    """Distance (bins,), m, of the cloth from the axis around the drape at a height below the plate.

    Each view contributes mostly what faces the camera. NaN where no view saw any cloth.

    Args:
        views: (K, H, W) z-depth, m, background 0.
        camera: of all of them, see :func:`locate_camera`.
        height: m above the plate; a band of 16 mm around it counts.
        turns: (K,) rad, how far the table had turned in each view.
    """
    total, weight = np.zeros(bins), np.zeros(bins)
    for turn, view in zip(turns, views, strict=True):
        points = camera.cloth_points(view)
        band = points[np.abs(points[:, 2] - height) < 0.008]
        azimuth = np.arctan2(band[:, 1], band[:, 0])
        facing = np.maximum(-np.sin(azimuth), 0) ** 4  # the camera stands at -y
        bin_of = np.floor((azimuth - turn) / (2 * np.pi) * bins).astype(int) % bins
        np.add.at(total, bin_of, facing * np.hypot(band[:, 0], band[:, 1]))
        np.add.at(weight, bin_of, facing)
    return np.where(weight > 1e-3, total / np.maximum(weight, 1e-3), np.nan)


def count_folds(profile: np.ndarray) -> int:
    """Number of outward folds of a radius profile (bins,), which may have gaps."""
    known = np.flatnonzero(np.isfinite(profile))
    if len(known) < len(profile) // 2:
        return 0
    filled = np.interp(np.arange(len(profile)), known, profile[known], period=len(profile))
    smooth = gaussian_filter1d(filled, sigma=len(profile) / 90, mode="wrap")
    # Peaks are sought on the circle: begin at the lowest point, so that none is cut in two.
    opened = np.roll(smooth, -int(smooth.argmin()))
    opened = np.append(opened, opened[0])
    return len(find_peaks(opened, prominence=FOLD_PROMINENCE)[0])


def silhouette_overlap(first: np.ndarray, second: np.ndarray) -> float:
    """Mean intersection over union of the cloth in views (K, H, W) and (K, H, W)."""
    a, b = first > 0, second > 0
    union = (a | b).sum(axis=(1, 2))
    return float(np.mean((a & b).sum(axis=(1, 2)) / np.maximum(union, 1)))
