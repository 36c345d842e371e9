"""What a depth sensor adds to a perfect picture.

The model of Feng et al. 2022, section 5.2.2, which refers to Barron & Malik 2013 and
Bohg et al. 2014: a structured-light sensor looks up each pixel a fraction of a pixel beside its
place, and measures disparity, with noise, in steps of 1/8 pixel. Both references describe the same
steps: in eighths of a pixel the disparity is d = K/z, K = 8 f b = 351.3 m for the first Kinect
(focal length f in pixels, baseline b in metres). At 0.53 m a step is 0.8 mm. Depth is never rounded
to whole centimetres first, as some implementations do: it would destroy a drape.

Added to it: a small affine change of each picture, as in the paper, and the coarse 8-bit steps of
the published captures on a part of the samples, so that both formats are familiar to the network.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np

from data.configs import read_option
from data.remap import remap_depth
from sim.errors import InputError

EIGHTHS_OF_DISPARITY = 351.3  # m, K above
EIGHT_BIT_STEP = 1 / 255  # m per count in the published captures


@dataclass(frozen=True)
class SensorNoise:
    """Random changes of depth pictures; calling it returns changed copies.

    Attributes:
        strength: multiplies all standard deviations below; at 0 nothing is random or rounded.
        shift_px: standard deviation of a pixel's look-up, in columns and in rows.
        shift_correlation_px: length over which neighbours share their shift. At 1 each pixel has
            its own, which frays silhouettes; those of the published captures are not frayed.
        disparity_px: standard deviation of the disparity; as given, 1/6 of its step of 1/8 px.
        affine_scale_percent: standard deviation of each picture's stretch and shear.
        affine_turn_deg: standard deviation of its turn about the middle.
        affine_shift_px: standard deviation of its shift.
        eight_bit_probability: part of the captures that get the published captures' 8-bit steps.
    """

    strength: float = 1.0
    shift_px: float = 0.25
    shift_correlation_px: float = 6.0
    disparity_px: float = 0.0208
    affine_scale_percent: float = 0.5
    affine_turn_deg: float = 0.3
    affine_shift_px: float = 0.5
    eight_bit_probability: float = 0.5

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not isinstance(value, (int, float)) or not 0 <= value < np.inf:
                raise InputError(f"sensor.{field.name} must be a finite number, not below 0")
        if self.eight_bit_probability > 1:
            raise InputError("sensor.eight_bit_probability must lie between 0 and 1")
        if self.shift_correlation_px < 1:
            raise InputError("sensor.shift_correlation_px must be at least 1 pixel")

    @classmethod
    def load(cls, name: str = "smooth") -> "SensorNoise":
        """Read ``configs/sensor/NAME.yaml``; InputError when there is no such file."""
        return cls.from_config(read_option("sensor", name))

    @classmethod
    def from_config(cls, config: Mapping) -> "SensorNoise":
        """Build from the mapping of a sensor file (Hydra's group ``sensor`` gives the same)."""
        unknown = set(config) - {field.name for field in fields(cls)}
        if unknown:
            raise InputError(f"unknown sensor setting '{min(unknown)}'; see configs/sensor")
        return cls(**config)

    def __call__(self, views: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Noisy copies of the pictures of one capture.

        Args:
            views: (..., H, W) z-depth in metres, background 0; focal lengths as in the rig, since
                shifts are in pixels.
            rng: source of all randomness.

        Returns:
            (..., H, W) float32 metres, background 0.
        """
        views = np.asarray(views, dtype=np.float32)
        coarse = rng.random() < self.eight_bit_probability
        if self.strength == 0:
            return views.copy()
        noisy = np.zeros_like(views)
        rows, columns = self._window(views)
        u, v = self._look_up(views.shape, rows, columns, rng)
        seen = remap_depth(views, u, v)
        cloth = seen > 0
        depth = seen[cloth]
        disparity = EIGHTHS_OF_DISPARITY / depth
        sigma = 8 * self.disparity_px * self.strength
        disparity += np.float32(sigma) * rng.standard_normal(depth.shape, dtype=np.float32)
        depth = EIGHTHS_OF_DISPARITY / np.rint(disparity)
        if coarse:
            depth = np.rint(depth / EIGHT_BIT_STEP) * EIGHT_BIT_STEP
        seen[cloth] = depth
        noisy[..., rows, columns] = seen
        return noisy

    def _window(self, views: np.ndarray) -> tuple[slice, slice]:
        """Rows and columns that cloth may reach after the change: the rest stays background."""
        height, width = views.shape[-2:]
        cloth = (views > 0).reshape(-1, height, width).any(axis=0)
        size = max(height, width)
        reach = 4 * self.strength * (
            self.shift_px
            + self.affine_shift_px
            + size * (self.affine_scale_percent / 100 + np.radians(self.affine_turn_deg))
        )
        slices = []
        for axis in (1, 0):
            indices = np.flatnonzero(cloth.any(axis=axis))
            first, last = (indices[0], indices[-1]) if len(indices) else (0, -1)
            slices.append(slice(max(0, int(first - reach)), int(last + reach) + 2))
        rows, columns = slices
        return slice(rows.start, min(rows.stop, height)), slice(
            columns.start, min(columns.stop, width)
        )

    def _look_up(
        self, shape: tuple[int, ...], rows: slice, columns: slice, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        """Where each pixel of the window looks: u and v, (..., h, w) float32."""
        height, width = shape[-2:]
        batch = (*shape[:-2], 1, 1)
        strain = self.strength * self.affine_scale_percent / 100
        turn = self.strength * np.radians(self.affine_turn_deg) * rng.standard_normal(batch)
        stretch_u, stretch_v, shear = strain * rng.standard_normal((3, *batch))
        shift_u, shift_v = self.strength * self.affine_shift_px * rng.standard_normal((2, *batch))
        x = np.arange(columns.start, columns.stop) - (width - 1) / 2
        y = (np.arange(rows.start, rows.stop) - (height - 1) / 2)[:, None]
        u = x * (1 + stretch_u) + y * (shear - turn) + shift_u + (width - 1) / 2
        v = y * (1 + stretch_v) + x * (shear + turn) + shift_v + (height - 1) / 2
        along_v = _interpolation(u.shape[-2], self.shift_correlation_px)
        along_u = _interpolation(u.shape[-1], self.shift_correlation_px)
        knots = (2, *shape[:-2], along_v.shape[1], along_u.shape[1])
        wobble = along_v @ rng.standard_normal(knots, dtype=np.float32) @ along_u.T
        wobble *= np.float32(self.strength * self.shift_px)
        return u.astype(np.float32) + wobble[0], v.astype(np.float32) + wobble[1]


def _interpolation(length: int, spacing: float) -> np.ndarray:
    """Matrix (length, knots) that makes pixels of unit variance from independent normal knots."""
    place = np.arange(length) / spacing
    weights = np.maximum(1 - np.abs(place[:, None] - np.arange(int(place[-1]) + 2)), 0)
    return (weights / np.linalg.norm(weights, axis=1, keepdims=True)).astype(np.float32)
