"""Synthetic captures of a drape with random camera, pose, turntable and sensor.

    drape -> set-up -> views without noise -> sensor -> cut-out

``configs/setup`` states the distribution of set-ups.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import torch
from pydantic import Field
from scipy import ndimage

from common.configs import read_option
from common.documents import Schema
from common.errors import InputError
from common.units import si
from data.captures.pictures import MAX_VIEWS
from data.render.cameras import Camera, CameraRig, Intrinsics, Pose
from data.render.rasterise import camera_tensors, render_batch
from data.render.sensor import load_sensor
from data.render.sensor_noise import Share

REFERENCE_DISTANCE = 0.527
"""m, at which offsets parallel to the picture are stated, for specimens of 300 mm."""


@dataclass(frozen=True)
class SyntheticCapture:
    """A capture as a user has it, with the true orientation and sensor, which a user does not know.

    Attributes:
        views: (K, H, W) float32 z-depth, m, background 0.
        intrinsics: nominal, as stated in the capture.
        turns: (K,) rad, nominal turns of the table.
        orientation: true direction of the warp in the first view, rad.
        sensor: name of its file in ``configs/sensor``.
    """

    views: np.ndarray
    intrinsics: Intrinsics
    turns: np.ndarray
    orientation: float
    sensor: str


_Limits = Annotated[list[float], Field(min_length=2, max_length=2)]


class SetupFile(Schema):
    """``configs/setup/NAME.yaml``, where the keys are documented."""

    remedy = "see configs/setup/real.yaml"
    views: list[Share] = Field(max_length=MAX_VIEWS)
    distance_mm: _Limits
    pitch_deg: _Limits
    fill: _Limits
    above_mm: _Limits
    aside_mm: _Limits
    roll_deg: float = Field(ge=0, le=90)
    focal_percent: float = Field(ge=0, le=50)
    turn_deg: float = Field(ge=0, le=90)
    sensors: dict[str, Share] = Field(max_length=100)
    border_px: int = Field(ge=0, le=100)
    holes: int = Field(ge=0, le=1000)
    hem_share: Share
    hem_mm: float = Field(ge=0, le=1000)


@dataclass(frozen=True)
class Setups:
    """Distribution of set-ups; SI units and radians, see ``configs/setup``. ``orientation`` is the
    direction of the warp in the first view.

    Raises:
        InputError: limits in the wrong order, or shares that do not add up to 1.
    """

    views: tuple[float, ...]
    distance: tuple[float, float]
    pitch: tuple[float, float]
    fill: tuple[float, float]
    above: tuple[float, float]
    aside: tuple[float, float]
    roll: float
    focal: float
    turn: float
    sensors: dict[str, float]
    border: int
    holes: int
    hem_share: float
    hem: float
    orientation: tuple[float, float] = (0.0, 2 * np.pi)

    def __post_init__(self) -> None:
        for name in ("distance", "pitch", "fill", "above", "aside", "orientation"):
            low, high = getattr(self, name)
            if not low <= high:
                raise InputError(f"setup: {name} from {low:g} to {high:g}: the smaller one first")
        for name in ("views", "sensors"):
            shares = getattr(self, name)
            shares = list(shares.values()) if isinstance(shares, dict) else shares
            if not (min(shares, default=-1) >= 0 and abs(sum(shares) - 1) < 1e-6):
                raise InputError(f"setup: the shares of {name} add up to {sum(shares):g}; they "
                                 "must add up to 1, and none may be negative")

    @classmethod
    def load(cls, name: str = "real") -> "Setups":
        """Read ``configs/setup/NAME.yaml``; InputError if it does not exist."""
        return cls.from_config(read_option("setup", name))

    @classmethod
    def from_config(cls, config: Mapping) -> "Setups":
        """Build from the mapping of such a file, see :class:`SetupFile`."""
        return cls(**si(SetupFile.of(config, "setup").model_dump()))

    def capture(
        self,
        positions: np.ndarray,
        faces: np.ndarray,
        rng: np.random.Generator,
        *,
        nominal: CameraRig | None = None,
    ) -> SyntheticCapture:
        """Simulate a capture of a drape with vertices (V, 3), m, and triangles (F, 3).

        Args:
            nominal: camera of the rig; None: of the square on its cylinder.
        """
        camera = self.camera(rng, nominal or CameraRig.load())
        count = 1 + int(rng.choice(len(self.views), p=self.views))
        turns = np.arange(count) * (2 * np.pi / count)
        wrong = rng.normal(0.0, self.turn, count)
        wrong[0] = 0.0
        orientation = float(rng.uniform(*self.orientation))
        intrinsics, poses = camera_tensors([camera])
        views = render_batch(
            torch.from_numpy(positions[None]), torch.from_numpy(faces[None].astype(np.int64)),
            angles=torch.from_numpy((orientation + turns + wrong)[None]), intrinsics=intrinsics,
            world_to_camera=poses, height=camera.height, width=camera.width)
        name = str(rng.choice(list(self.sensors), p=list(self.sensors.values())))
        generator = torch.Generator().manual_seed(int(rng.integers(2**63)))
        noisy = load_sensor(name)(views, intrinsics, generator)[0].numpy()
        self._cut_out(noisy, views[0].numpy(), camera, rng)
        scale = 1 + self.focal * rng.standard_normal()
        given = replace(camera.intrinsics, fx=camera.fx * scale, fy=camera.fy * scale)
        return SyntheticCapture(noisy, given, turns, orientation, name)

    def camera(self, rng: np.random.Generator, nominal: CameraRig) -> Camera:
        """Draw a camera with random pose; ``nominal``: of the rig."""
        distance = rng.uniform(*self.distance)
        ratio = distance / REFERENCE_DISTANCE
        # The nominal distance is in proportion to the size of the specimen.
        size = nominal.pose.distance / REFERENCE_DISTANCE
        offset = size * ratio
        pose = Pose(distance, rng.uniform(*self.pitch), offset * rng.uniform(*self.above),
                    offset * rng.uniform(*self.aside), self.roll * rng.standard_normal())
        given = nominal.intrinsics
        focal = given.fx / size * ratio * rng.uniform(*self.fill)
        return Camera(focal, focal, given.cx, given.cy, given.width, given.height,
                      pose.world_to_camera())

    def _cut_out(
        self, noisy: np.ndarray, views: np.ndarray, camera: Camera, rng: np.random.Generator
    ) -> None:
        """Remove, in place, parts of the cloth in views (K, H, W), as an imperfect cut-out does."""
        border = int(rng.integers(self.border + 1))
        lowest = None
        if rng.random() < self.hem_share:
            lowest = self.hem * rng.random()
        for view, clean in zip(noisy, views, strict=True):
            cloth = view > 0
            if border:
                view[cloth & ~ndimage.binary_erosion(cloth, iterations=border)] = 0.0
            if lowest is not None and cloth.any():
                up = camera.world_to_camera[:3, 2]
                height = camera.back_project(clean) @ up
                view[height < height[clean > 0].min() + lowest] = 0.0
            rows, columns = np.nonzero(cloth)
            for _ in range(int(rng.integers(self.holes + 1)) if len(rows) else 0):
                middle = int(rng.integers(len(rows)))
                top, left = rows[middle], columns[middle]
                size = int(rng.integers(2, 7))
                view[top : top + size, left : left + size] = 0.0
