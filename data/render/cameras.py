"""Pinhole cameras, and the nominal camera of a drape tester.

The centre of the pixel in column i and row j is at (u, v) = (i, j), as in OpenCV and in the
intrinsics of depth sensors. Camera axes are x right, y down, z forward; z is the depth. World axes
are z up, with the origin at the centre of the plate's top face. The camera is on the -y side and
looks towards +y: +x is to the right in the picture, the direction at 90 degrees points away.
"""

import math
from dataclasses import dataclass, fields
from functools import cache

import numpy as np

from common.configs import read_config, si
from common.errors import InputError
from common.findings import Finding
from common.types import DepthImage, Metres, Pixels, Points, Pose, Radians, Turns
from sim.rig import DISC_RIG, SQUARE_RIG, Rig

VIEWS = 4
QUARTERS: Turns = np.arange(VIEWS) * math.pi / 2
"""Turns of the table in four views, rad."""
_MAX_OFF_MIDDLE = 0.1  # of the picture's width and height; the Azure Kinect's is 9 % off


@dataclass(frozen=True)
class Intrinsics:
    """Focal lengths and principal point in pixels, and the picture's size.

    A point (x, y, z) in camera axes falls on u = fx x/z + cx, v = fy y/z + cy.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int

    def __post_init__(self) -> None:
        numbers = (self.fx, self.fy, self.cx, self.cy)
        if not all(math.isfinite(value) for value in numbers) or min(self.fx, self.fy) <= 0:
            raise InputError(f"intrinsics fx={self.fx} fy={self.fy} cx={self.cx} cy={self.cy} are "
                             "not usable; give finite pixels and positive focal lengths")
        # A principal point near the edge indicates intrinsics of another picture size.
        for centre, size in ((self.cx, self.width), (self.cy, self.height)):
            if not 0.1 * size < centre < 0.9 * size:
                raise InputError(f"principal point ({self.cx:g}, {self.cy:g}) is not in the inner "
                                 f"part of the {self.width}x{self.height} picture; give the "
                                 "intrinsics of this picture size")

    @property
    def questions(self) -> tuple[Finding, ...]:
        """A warning of a principal point that few pictures have."""
        off = max(abs((self.cx + 0.5) / self.width - 0.5), abs((self.cy + 0.5) / self.height - 0.5))
        return (Finding("principal_point_off", {
            "value": off, "limit": _MAX_OFF_MIDDLE, "cx": self.cx, "cy": self.cy,
            "width": self.width, "height": self.height}),) * (off > _MAX_OFF_MIDDLE)

    def posed(self, world_to_camera: Pose) -> "Camera":
        """The camera with a pose."""
        return Camera(self.fx, self.fy, self.cx, self.cy, self.width, self.height, world_to_camera)

    def directions(self) -> np.ndarray:
        """Ray through every pixel centre in camera axes, scaled to z = 1: (height, width, 3).

        With this scale the ray parameter of an intersection is its z-depth.
        """
        rays = np.ones((self.height, self.width, 3))
        rays[..., 0] = (np.arange(self.width) - self.cx) / self.fx
        rays[..., 1] = ((np.arange(self.height) - self.cy) / self.fy)[:, None]
        return rays

    def points(self, depth: DepthImage) -> Points:
        """Points in camera axes, of the pixels with depth."""
        rows, columns = np.nonzero(depth > 0)
        z = depth[rows, columns].astype(float)
        return np.column_stack([(columns - self.cx) / self.fx * z, (rows - self.cy) / self.fy * z,
                                z])

    def back_project(self, depth: np.ndarray) -> np.ndarray:
        """Points (..., height, width, 3) in camera axes, m, from z-depth (..., height, width)."""
        return self.directions() * np.asarray(depth, dtype=float)[..., None]


@dataclass(frozen=True)
class Camera(Intrinsics):
    """A pinhole camera with a pose."""

    world_to_camera: Pose

    @property
    def intrinsics(self) -> Intrinsics:
        """The intrinsics without the pose."""
        return Intrinsics(**{f.name: getattr(self, f.name) for f in fields(Intrinsics)})

    def project(self, points: Points) -> tuple[Pixels, np.ndarray]:
        """Pixels (u, v) and z-depth (N,) of world points."""
        local = points @ self.world_to_camera[:3, :3].T + self.world_to_camera[:3, 3]
        depth = local[:, 2]
        u = self.fx * local[:, 0] / depth + self.cx
        v = self.fy * local[:, 1] / depth + self.cy
        return np.stack([u, v], axis=1), depth

    def cloth_points(self, view: DepthImage) -> Points:
        """World points of the cloth in a view."""
        rotation, shift = self.world_to_camera[:3, :3], self.world_to_camera[:3, 3]
        return (self.points(view) - shift) @ rotation

    def resized(self, width: int, height: int) -> "Camera":
        """The camera with another pixel grid (the corners of the picture are unchanged)."""
        sx, sy = width / self.width, height / self.height
        return Camera(self.fx * sx, self.fy * sy, (self.cx + 0.5) * sx - 0.5,
                      (self.cy + 0.5) * sy - 0.5, width, height, self.world_to_camera)


def camera_pose(
    *, distance: Metres, pitch: Radians, above: Metres = 0.0, aside: Metres = 0.0,
    roll: Radians = 0.0
) -> Pose:
    """Transform from world to camera axes.

    Args:
        distance: from the optical centre to the plate's centre.
        pitch: of the optical axis below the horizontal.
        above, aside: of the plate's centre from the optical axis, parallel to the picture: up,
            right.
        roll: of the picture's content, clockwise.
    """
    c, s = math.cos(pitch), math.sin(pitch)
    level = np.array([[1.0, 0.0, 0.0], [0.0, -s, -c], [0.0, c, -s]])  # rows: right, down, axis
    c, s = math.cos(roll), math.sin(roll)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    transform = np.eye(4)
    transform[:3, :3] = turn @ level
    transform[:3, 3] = aside, -above, math.sqrt(distance**2 - above**2 - aside**2)
    return transform


def size_ratio(rig: Rig) -> float:
    """Reach of the specimen over that of the tester of its kind that ``configs/camera.yaml`` states
    the camera of; distances of cameras follow it."""
    return rig.reach / (DISC_RIG if rig.specimen == "disc" else SQUARE_RIG).reach


def nominal_camera(rig: Rig = SQUARE_RIG) -> Camera:
    """The camera of ``configs/camera.yaml``, with all lengths in proportion to the specimen."""
    settings = _settings().copy()
    intrinsics = Intrinsics(**{f.name: settings.pop(f.name) for f in fields(Intrinsics)})
    for name in ("distance", "above", "aside"):
        settings[name] *= size_ratio(rig)
    return intrinsics.posed(camera_pose(**settings))


@cache
def _settings() -> dict:
    """The content of ``configs/camera.yaml``."""
    return si(read_config("camera"))
