"""Synthetic captures of a drape with random camera, pose, turntable and sensor.

    drape -> set-up -> views without noise -> sensor -> cut-out

``configs/setup`` states the distribution of set-ups.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any

import cv2
import numpy as np
from pydantic import AfterValidator, Field, create_model

from common.configs import Key, Share, keys_of, limits, read_option, si, up_to
from common.documents import Schema
from common.types import Faces, Points, Radians, Turns, Views
from data.captures.description import MAX_VIEWS
from data.render.cameras import Camera, Intrinsics, camera_pose, nominal_camera, size_ratio
from sim.rig import SQUARE_RIG, Rig

REFERENCE_DISTANCE = 0.527
"""m, at which offsets parallel to the picture are stated, for specimens of 300 mm."""
_CROSS = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))  # a pixel and its four neighbours


@dataclass(frozen=True)
class SyntheticCapture:
    """A capture as a user has it, with the true orientation and sensor, which a user does not know.
    """

    views: Views
    intrinsics: Intrinsics  # nominal, as the turns
    turns: Turns
    orientation: Radians  # direction of the warp in the first view
    sensor: str  # name of its file in configs/sensor


def _adding_up(shares: Any) -> Any:
    total = sum(shares.values() if isinstance(shares, dict) else shares)
    if abs(total - 1) >= 1e-6:
        raise ValueError(f"the shares add up to {total:g}; they must add up to 1")
    return shares


_ADD_UP = AfterValidator(_adding_up)
_Pair = tuple[float, float]


@dataclass(frozen=True)
class Setups:
    """Distribution of set-ups; SI units and radians, see ``configs/setup``."""

    views: Annotated[tuple[float, ...],
                     Key("", Annotated[list[Share], Field(max_length=MAX_VIEWS), _ADD_UP])]
    distance: Annotated[_Pair, Key("mm", limits(1, 100_000))]
    pitch: Annotated[_Pair, Key("deg", limits(-90, 90))]
    fill: Annotated[_Pair, Key("", limits(0.01, 100))]
    above: Annotated[_Pair, Key("mm", limits(-200, 200))]
    aside: Annotated[_Pair, Key("mm", limits(-200, 200))]
    roll: Annotated[float, Key("deg", up_to(90))]
    focal: Annotated[float, Key("percent", up_to(50))]
    turn: Annotated[float, Key("deg", up_to(90))]
    sensors: Annotated[dict[str, Share], Field(max_length=100), _ADD_UP]
    border: Annotated[int, Key("px", Annotated[int, Field(ge=0, le=100)])]
    holes: Annotated[int, Field(ge=0, le=1000)]
    hem_share: Share
    hem: Annotated[float, Key("mm", up_to(1000))]
    orientation: _Pair = (0.0, 2 * np.pi)

    @classmethod
    def load(cls, name: str = "real") -> "Setups":
        """Read ``configs/setup/NAME.yaml``; InputError if it does not exist."""
        return cls.from_config(read_option("setup", name))

    @classmethod
    def from_config(cls, config: Mapping) -> "Setups":
        """Build from the mapping of such a file."""
        return cls(**si(_File.of(config, "setup").model_dump()))

    def capture(
        self, positions: Points, faces: Faces, rng: np.random.Generator, *, rig: Rig = SQUARE_RIG
    ) -> SyntheticCapture:
        """Simulate a capture of a drape on the tester ``rig``."""
        camera = self.camera(rng, rig)
        count = 1 + int(rng.choice(len(self.views), p=self.views))
        turns = np.arange(count) * (2 * np.pi / count)
        wrong = rng.normal(0.0, self.turn, count)
        wrong[0] = 0.0
        orientation = float(rng.uniform(*self.orientation))
        # Numba and PyTorch, which a reader of set-ups need not load.
        from data.render.raster import rasterise
        from data.render.sensors import load_sensor

        views = rasterise(positions, faces, camera,
                          (orientation + turns + wrong).tolist())
        name = str(rng.choice(list(self.sensors), p=list(self.sensors.values())))
        noisy = load_sensor(name)(views, camera, int(rng.integers(2**63)))
        self._cut_out(noisy, views, camera, rng)
        scale = 1 + self.focal * rng.standard_normal()
        stated = replace(camera.intrinsics, fx=camera.fx * scale, fy=camera.fy * scale)
        return SyntheticCapture(noisy, stated, turns, orientation, name)

    def camera(self, rng: np.random.Generator, rig: Rig) -> Camera:
        """Draw a camera with random pose in front of ``rig``."""
        nominal, size = nominal_camera(rig), size_ratio(rig)
        distance = rng.uniform(*self.distance)
        ratio = distance / REFERENCE_DISTANCE
        # The nominal distance is in proportion to the size of the specimen.
        offset = size * ratio
        pose = camera_pose(
            distance=distance, pitch=rng.uniform(*self.pitch),
            above=offset * rng.uniform(*self.above), aside=offset * rng.uniform(*self.aside),
            roll=self.roll * rng.standard_normal())
        focal = nominal.fx / size * ratio * rng.uniform(*self.fill)
        return replace(nominal, fx=focal, fy=focal, world_to_camera=pose)

    def _cut_out(self, noisy: Views, views: Views, camera: Camera,
                 rng: np.random.Generator) -> None:
        """Remove, in place, parts of the cloth, as an imperfect cut-out does."""
        border = int(rng.integers(self.border + 1))
        lowest = self.hem * rng.random() if rng.random() < self.hem_share else None
        for view, clean in zip(noisy, views, strict=True):
            cloth = view > 0
            if border:
                inner = cv2.erode(cloth.view(np.uint8), _CROSS, iterations=border,
                                  borderType=cv2.BORDER_CONSTANT, borderValue=0)
                view[cloth & ~inner.view(bool)] = 0.0
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


class _SetupFile(Schema):
    remedy = "see configs/setup/real.yaml"


_KEYS: dict[str, Any] = {key: (kind, ...) for key, kind in
                         keys_of(Setups, without=["orientation"]).items()}
_File = create_model("_File", __base__=_SetupFile, **_KEYS)
"""``configs/setup/NAME.yaml``, where the keys are documented."""
