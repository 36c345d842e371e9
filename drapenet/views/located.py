"""Views of a drape with the camera's pose and the turns of the table, estimated from the views.

The pose is that of the flat top of the drape; turns and centre are refined by the overlap of views.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from common.types import Points, Turns, Views
from data.captures.capture import Capture
from data.render.cameras import Camera, Intrinsics
from drapenet.views.turns import register
from sim.rig import Rig

DEPTH_STEP = 4e-3  # m, of the coarsest depth format
INNER_SHARE = 0.7  # of the plate's radius, within which the cloth is flat
_MAX_POINTS = 6000  # used to find the initial plane
_PITCHES = np.radians([25.0, 32.0, 38.0, 44.0, 50.0])
"""rad, initial guesses of the camera's pitch."""


@dataclass(frozen=True)
class LocatedViews:
    """Views of a drape on the plate of ``rig``.

    Attributes:
        camera: with its pose relative to the plate; world x is parallel to the picture's rows.
        turns: estimated; stated_turns: those of the capture.
        centre: (2,) m, of the plate in the camera's world axes, from the overlap of the views.
    """

    views: Views
    camera: Camera
    rig: Rig
    turns: Turns
    stated_turns: Turns
    centre: np.ndarray

    @classmethod
    def of(cls, capture: Capture) -> "LocatedViews":
        """The views of a capture."""
        return locate(capture.views, capture.intrinsics, capture.rig, capture.turns)

    @classmethod
    def registered(
        cls, views: Views, camera: Camera, rig: Rig, turns: Turns
    ) -> "LocatedViews":
        """Views of a posed camera; their turns are estimated, starting from the stated ones."""
        clouds = [camera.cloth_points(view) for view in views]
        refined, centre = register(clouds, turns, rig)
        return cls(views, camera, rig, refined, turns, centre)

    @classmethod
    def exact(cls, views: Views, camera: Camera, rig: Rig, turns: Turns) -> "LocatedViews":
        """Views whose pose and turns are known, such as rendered ones."""
        turns = np.asarray(turns, dtype=float)
        return cls(views, camera, rig, turns, turns, np.zeros(2))

    @cached_property
    def clouds(self) -> list[Points]:
        """Points of the cloth in each view, in the camera's world axes."""
        return [self.camera.cloth_points(view) for view in self.views]


def locate(views: Views, intrinsics: Intrinsics, rig: Rig, turns: Turns) -> LocatedViews:
    """Estimate the pose of the camera and the turns of the table from views with stated turns."""
    return LocatedViews.registered(views, locate_camera(views, intrinsics, rig), rig, turns)


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
