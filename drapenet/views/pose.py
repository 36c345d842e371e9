"""Camera pose relative to the plate, estimated from the views of a capture."""

import numpy as np

from data.render.cameras import Camera, Intrinsics
from data.render.setups import Setups
from sim.rig import Rig

DEPTH_STEP = 4e-3  # m, of the coarsest depth format
INNER_SHARE = 0.7  # of the plate's radius, within which the cloth is flat
_MAX_POINTS = 6000  # used to find the initial plane
_PITCHES = np.radians([25.0, 32.0, 38.0, 44.0, 50.0])
"""rad, initial guesses of the camera's pitch."""
TILT, SHIFT = np.radians(2.0), 0.020
"""rad and m, tolerances of the pose beyond the range trained on: the errors of the estimate."""


def locate_camera(views: np.ndarray, intrinsics: Intrinsics, rig: Rig) -> Camera:
    """Estimate the camera's pose relative to the plate from the flat top of the drape.

    The plate's plane is fitted to the highest points; its centre is the centroid of the points
    on it. The centroid is taken over all views, which makes it symmetric for any drape.

    Args:
        views: (K, H, W) z-depth, m, background 0.
        intrinsics: of these images.

    Returns:
        A camera whose world x axis is parallel to the image rows.
    """
    points = np.concatenate([intrinsics.back_project(view)[view > 0] for view in views])
    few = points[:: max(1, len(points) // _MAX_POINTS)]
    starts = [_plate(few, np.array([0.0, -np.cos(pitch), -np.sin(pitch)]), rig.plate_radius,
                     rounds=4)
              for pitch in _PITCHES]
    # The plate is the plane that holds the largest area of points.
    normal = max(starts, key=lambda plate: plate[2])[0]
    normal, centre, _ = _plate(few, normal, rig.plate_radius, rounds=6)
    normal, centre, _ = _plate(points, normal, rig.plate_radius, rounds=2, centre=centre)
    east = np.array([1.0, 0.0, 0.0]) - normal[0] * normal
    east /= max(np.linalg.norm(east), 1e-12)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([east, np.cross(normal, east), normal], axis=1)
    pose[:3, 3] = centre
    return Camera(**vars(intrinsics) | {"world_to_camera": pose})


def _plate(
    points: np.ndarray, normal: np.ndarray, radius: float, *, rounds: int,
    centre: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, float]:
    """Normal and centre of the plate in points (N, 3), camera axes, and the weight of its points.

    Args:
        normal: initial guess, up. centre: initial guess; None: centroid of the highest points.
    """
    height = points @ normal
    on_plate = height > np.quantile(height, 0.995) - 3 * DEPTH_STEP
    inner = on_plate
    if centre is None:
        centre = points[on_plate].mean(axis=0)
    else:
        inner = (np.linalg.norm(points - centre, axis=1) < INNER_SHARE * radius) & on_plate
    weight = 0.0
    for _ in range(rounds):
        if inner.sum() < 3:
            break  # too few points for a plane: not a drape on a plate
        middle = points[inner].mean(axis=0)
        offsets = points[inner] - middle
        normal = np.linalg.eigh(offsets.T @ offsets)[1][:, 0]
        normal *= -np.sign(normal @ middle)  # up is towards the camera
        above = (points - middle) @ normal
        on_plate = (np.abs(above) < DEPTH_STEP / 2) & (
            np.linalg.norm(points - centre, axis=1) < 2 * radius)
        if not on_plate.any():
            break
        # Pixels are denser where the plate is nearer; on a plane, z³ compensates for that.
        weights = points[on_plate, 2] ** 3
        centre = weights @ points[on_plate] / weights.sum()
        weight = float(weights.sum())
        # Near the rim the cloth bends down, and more of it is visible in front: a bias.
        near = np.linalg.norm(points - centre, axis=1) < INNER_SHARE * radius
        inner = near & (above > -DEPTH_STEP)
    return normal, centre, weight


def camera_doubts(camera: Camera, setups: Setups) -> list[str]:
    """One line for each property of ``camera`` outside the ``setups`` that the network was
    trained on.
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
                      "are upright, their intrinsics, and the camera's position")
    if not near - SHIFT < distance < far + SHIFT:
        doubts.append(f"the plate is {1e3 * distance:.0f} mm away (limits "
                      f"{1e3 * near:.0f} to {1e3 * far:.0f} mm): check the depth unit, the "
                      "intrinsics and the camera's position")
    return doubts
