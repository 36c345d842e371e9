"""Pinhole cameras, and the camera rig of a drape tester with its random variation.

Pixels. Column ``u`` increases to the right, row ``v`` downwards, and the *centre* of the pixel in
column i and row j is at (u, v) = (i, j), as in OpenCV and in the intrinsics that depth sensors
report. The centre of a picture is therefore ((width - 1)/2, (height - 1)/2).

Axes. Camera axes are x right, y down, z forward along the optical axis; depth is the z of a
point in these axes (z-depth), not the length of the ray. World axes are z up, with the origin at
the centre of the plate's top face. The camera is on the -y side and looks towards +y, so that
world +x is to the right in the picture and the direction at 90 degrees points away from it.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.special import ndtr, ndtri

from common.configs import read_config
from common.errors import InputError, one_line
from common.units import si
from sim.rig import DISC_RIG, SQUARE_RIG, Rig

_MEASURED = {"square": SQUARE_RIG, "disc": DISC_RIG}
"""Rigs with a file in ``configs/camera``, by the specimen's shape."""

# Jitter has a truncated normal distribution, so that the specimen is always in the picture.
JITTER_LIMIT_SIGMAS = 2.0


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
            raise InputError(
                f"intrinsics fx={self.fx} fy={self.fy} cx={self.cx} cy={self.cy} are not usable; "
                "give finite pixels and positive focal lengths"
            )
        if not all(isinstance(size, (int, np.integer)) for size in (self.width, self.height)):
            raise InputError(f"the picture size {self.width}x{self.height} must be two whole "
                             "numbers of pixels")
        # A principal point near the edge indicates intrinsics of another picture size.
        for centre, size in ((self.cx, self.width), (self.cy, self.height)):
            if not 0.1 * size < centre < 0.9 * size:
                raise InputError(
                    f"principal point ({self.cx:g}, {self.cy:g}) is not in the inner part of the "
                    f"{self.width}x{self.height} picture; give the intrinsics of this picture size"
                )

    def directions(self) -> np.ndarray:
        """Ray through every pixel centre in camera axes, scaled to z = 1: (height, width, 3).

        With this scale the ray parameter of an intersection is its z-depth.
        """
        x = (np.arange(self.width) - self.cx) / self.fx
        y = (np.arange(self.height) - self.cy) / self.fy
        rays = np.ones((self.height, self.width, 3))
        rays[..., 0] = x[None, :]
        rays[..., 1] = y[:, None]
        return rays

    def back_project(self, depth: np.ndarray) -> np.ndarray:
        """Points (..., height, width, 3) in camera axes, metres, from z-depth (..., height, width).

        Background (depth 0) gives the camera's position.
        """
        return self.directions() * np.asarray(depth, dtype=float)[..., None]


@dataclass(frozen=True)
class Camera(Intrinsics):
    """A pinhole camera with a pose.

    Attributes:
        world_to_camera: (4, 4) float64, rigid; metres.
    """

    world_to_camera: np.ndarray

    @property
    def intrinsics(self) -> Intrinsics:
        """The intrinsics without the pose."""
        return Intrinsics(**{f.name: getattr(self, f.name) for f in fields(Intrinsics)})

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pixels (N, 2) as (u, v), and z-depth (N,) m, of world points (N, 3) m."""
        local = points @ self.world_to_camera[:3, :3].T + self.world_to_camera[:3, 3]
        depth = local[:, 2]
        u = self.fx * local[:, 0] / depth + self.cx
        v = self.fy * local[:, 1] / depth + self.cy
        return np.stack([u, v], axis=1), depth

    def cloth_points(self, view: np.ndarray) -> np.ndarray:
        """World points (N, 3), m, of the cloth in a view (height, width), z-depth, background 0."""
        rotation, shift = self.world_to_camera[:3, :3], self.world_to_camera[:3, 3]
        return (self.back_project(view)[view > 0] - shift) @ rotation

    def resized(self, width: int, height: int) -> "Camera":
        """The camera with another pixel grid (the corners of the picture are unchanged)."""
        sx, sy = width / self.width, height / self.height
        return Camera(self.fx * sx, self.fy * sy, (self.cx + 0.5) * sx - 0.5,
                      (self.cy + 0.5) * sy - 0.5, width, height, self.world_to_camera)


@dataclass(frozen=True)
class Pose:
    """Camera pose relative to the plate's centre: metres and radians.

    Attributes:
        distance: from the optical centre to the plate's centre.
        pitch: of the optical axis below the horizontal.
        above: offset of the plate's centre above the optical axis, parallel to the picture.
        aside: offset of the plate's centre to the right of the optical axis, likewise.
        roll: rotation of the picture's content, clockwise positive.
    """

    distance: float
    pitch: float
    above: float
    aside: float
    roll: float

    def __post_init__(self) -> None:
        if not all(math.isfinite(getattr(self, f.name)) for f in fields(self)):
            raise InputError("the camera's pose must be given in finite numbers")
        if self.distance <= 0:
            raise InputError(f"the camera's distance_mm={1e3 * self.distance:g} must be positive")

    def world_to_camera(self) -> np.ndarray:
        """(4, 4) rigid transform from world axes to camera axes."""
        c, s = math.cos(self.pitch), math.sin(self.pitch)
        level = np.array([[1.0, 0.0, 0.0], [0.0, -s, -c], [0.0, c, -s]])  # rows: right, down, axis
        c, s = math.cos(self.roll), math.sin(self.roll)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        across = self.above**2 + self.aside**2
        if across >= self.distance**2:
            raise InputError(f"the camera's distance, {1e3 * self.distance:g} mm, must exceed the "
                             f"plate's offset from the optical axis, {1e3 * math.sqrt(across):.4g} "
                             "mm; increase distance_mm")
        transform = np.eye(4)
        transform[:3, :3] = turn @ level
        transform[:3, 3] = self.aside, -self.above, math.sqrt(self.distance**2 - across)
        return transform


JITTERED = ("focal", "principal", *(field.name for field in fields(Pose)))
"""What differs from one set-up of a rig to the next."""


@dataclass(frozen=True)
class CameraRig:
    """Nominal camera of a drape tester, and how much real set-ups vary around it.

    Loaded from ``configs/camera``, where lengths are in mm and angles in degrees.

    Attributes:
        jitter: standard deviations of what differs from one set-up to the next, by
            :data:`JITTERED`: ``focal`` is relative, ``principal`` in pixels, the rest in metres
            and radians.
    """

    intrinsics: Intrinsics
    pose: Pose
    jitter: dict[str, float]

    def __post_init__(self) -> None:
        if not all(0 <= value < math.inf for value in self.jitter.values()):
            raise InputError("the rig's jitter must be given in finite numbers, none below 0")

    @classmethod
    def load(cls, rig: Rig = SQUARE_RIG) -> "CameraRig":
        """The camera of a rig: that in ``configs/camera`` for the specimen's shape, with all
        lengths in proportion to the specimen's reach, so that pictures of all sizes look alike.
        """
        measured = _MEASURED[rig.specimen]
        camera = cls.from_config(read_config(f"camera/{measured.name}"))
        scale = rig.reach / measured.reach
        lengths = ("distance", "above", "aside")
        return replace(
            camera,
            pose=replace(camera.pose, **{key: scale * getattr(camera.pose, key)
                                         for key in lengths}),
            jitter=camera.jitter | {key: scale * camera.jitter[key] for key in lengths})

    @classmethod
    def from_config(cls, config: Mapping) -> "CameraRig":
        """Build from the mapping of such a file.

        Raises:
            InputError: an entry is missing or invalid.
        """
        try:
            camera, jitter = si(config["camera"]), si(config["jitter"])
            intrinsics, pose = ({field.name: camera[field.name] for field in fields(kind)}
                                for kind in (Intrinsics, Pose))
            return cls(Intrinsics(**intrinsics), Pose(**pose),
                       {name: jitter[name] for name in JITTERED})
        except (KeyError, TypeError) as error:
            raise InputError(
                f"rig configuration is incomplete ({one_line(error)}); "
                f"see configs/camera/{SQUARE_RIG.name}.yaml"
            ) from None

    def nominal(self) -> Camera:
        """The camera without jitter."""
        return self._camera(np.zeros(len(JITTERED) + 1))

    def sample(self, rng: np.random.Generator) -> Camera:
        """Camera of a randomly varied set-up, shared by the views of a capture.

        Every deviate is normal, truncated at ``JITTER_LIMIT_SIGMAS``. The number of random numbers
        drawn is fixed.
        """
        tail = ndtr(-JITTER_LIMIT_SIGMAS)
        return self._camera(ndtri(tail + (1 - 2 * tail) * rng.random(len(JITTERED) + 1)))

    def _camera(self, deviates: np.ndarray) -> Camera:
        focal, shift_x, shift_y, *moved = deviates.tolist()
        nominal, sigma = self.intrinsics, self.jitter
        pose = Pose(*(getattr(self.pose, field.name) + sigma[field.name] * deviate
                      for field, deviate in zip(fields(Pose), moved, strict=True)))
        scale = 1 + sigma["focal"] * focal
        return Camera(nominal.fx * scale, nominal.fy * scale,
                      nominal.cx + sigma["principal"] * shift_x,
                      nominal.cy + sigma["principal"] * shift_y, nominal.width, nominal.height,
                      pose.world_to_camera())
