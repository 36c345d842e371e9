"""Noise models of depth sensors, with the settings of ``configs/sensor``.

Structured light (Feng et al. 2022, section 5.2.2, which refers to Barron & Malik 2013 and Bohg et
al. 2014): pixels are displaced by fractions of a pixel, and the disparity is noisy and quantised to
1/8 pixel. In eighths of a pixel it is d = K/z, K = 8 f b = 351.3 m for the first Kinect (focal
length f in pixels, baseline b in metres). Depth is not rounded to centimetres first, which would
destroy a drape's shape. In addition: a small affine transform of each picture, and the 8-bit steps
of the published captures for a part of them.

Time of flight, such as Azure Kinect or Orbbec Femto: the random error grows as the returned light,
proportional to cos(incidence)/z², weakens; each capture has a bias and a scale; depth is missing or
mixed at edges, at grazing incidence, and in a few pixels anywhere.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from functools import cache
from typing import Annotated

import numpy as np
import torch
from pydantic import Field, model_validator
from torch.nn.functional import pad

from common.configs import Share, read_option
from common.documents import Schema
from common.errors import InputError
from data.render.cameras import Intrinsics

Amount = Annotated[float, Field(ge=0)]

EIGHTHS_OF_DISPARITY = 351.3  # m, K above
EIGHT_BIT_STEP = 1 / 255  # m per count in the published captures
REFERENCE_DISTANCE = 0.5  # m, of axial_mm
MIN_COSINE = 0.05  # of the incidence; above 87 degrees a pixel's slope is not resolved
EDGE_STEP = 0.02
"""m, between neighbours on different folds: about twice the difference on the steepest cloth that
the rig's pictures resolve."""


class Sensor(Schema, ABC):
    """Noise model; calling it returns noisy copies of depth pictures."""

    remedy = "see configs/sensor"
    strength: Amount = 1.0

    def __call__(self, views: np.ndarray, intrinsics: Intrinsics, seed: int) -> np.ndarray:
        """Noisy copies of pictures (..., K, H, W), z-depth, m, background 0: K of each capture."""
        depth = torch.from_numpy(np.array(views, dtype=np.float32))
        if self.strength:
            rows, columns = cloth_window(depth, self.reach(max(depth.shape[-2:])))
            noisy = torch.zeros_like(depth)
            if rows.stop:
                noisy[..., rows, columns] = self.window(
                    depth, rows, columns, intrinsics, torch.Generator().manual_seed(seed))
            depth = noisy
        return depth.numpy()

    @abstractmethod
    def reach(self, size: int) -> float:
        """Largest displacement of the silhouette, pixels, in pictures of ``size`` pixels."""

    @abstractmethod
    def window(
        self, views: torch.Tensor, rows: slice, columns: slice, intrinsics: Intrinsics,
        generator: torch.Generator,
    ) -> torch.Tensor:
        """Noisy pictures (..., K, h, w) in the window outside which all is background."""


def cloth_window(views: torch.Tensor, reach: float) -> tuple[slice, slice]:
    """Rows and columns of the cloth of all pictures (..., H, W), and ``reach`` pixels around it."""
    cloth = (views > 0).flatten(0, -3).any(0)
    slices = []
    for axis in (1, 0):
        indices = cloth.any(axis).nonzero().flatten().tolist() or [0, -1 - math.ceil(reach)]
        first, last = indices[0] - math.ceil(reach), indices[-1] + math.ceil(reach)
        slices.append(slice(max(0, first), max(0, min(last + 1, cloth.shape[1 - axis]))))
    return slices[0], slices[1]


class StructuredLight(Sensor):
    """Displaced pixels and noisy, quantised disparity; see ``configs/sensor/smooth.yaml``."""

    shift_px: Amount = 0.25
    shift_correlation_px: float = Field(6.0, ge=1)
    disparity_px: Amount = 0.0208
    affine_scale_percent: Amount = 0.5
    affine_turn_deg: Amount = 0.3
    affine_shift_px: Amount = 0.5
    eight_bit_probability: Share = 0.5

    def reach(self, size: int) -> float:
        """Four standard deviations of all displacements together, pixels."""
        strain = self.affine_scale_percent / 100 + math.radians(self.affine_turn_deg)
        return 4 * self.strength * (self.shift_px + self.affine_shift_px + size * strain)

    def window(
        self, views: torch.Tensor, rows: slice, columns: slice, intrinsics: Intrinsics,
        generator: torch.Generator,
    ) -> torch.Tensor:
        coarse = torch.rand((*views.shape[:-3], 1, 1, 1), generator=generator)
        u, v = self._displaced(views, rows, columns, generator)
        # Background, depth 0, has infinite disparity and remains background.
        disparity = EIGHTHS_OF_DISPARITY / remap_depth(views, u, v)
        sigma = 8 * self.disparity_px * self.strength
        disparity += sigma * torch.randn(disparity.shape, generator=generator)
        depth = EIGHTHS_OF_DISPARITY / disparity.round()
        steps = (depth / EIGHT_BIT_STEP).round() * EIGHT_BIT_STEP
        return torch.where(coarse < self.eight_bit_probability, steps, depth)

    def _displaced(
        self, views: torch.Tensor, rows: slice, columns: slice, generator: torch.Generator
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Displaced coordinates u and v (..., K, h, w) of each pixel of the window."""
        height, width = views.shape[-2:]
        six = torch.randn((6, *views.shape[:-2], 1, 1), generator=generator) * self.strength
        turn, stretch_u, stretch_v, shear, shift_u, shift_v = six
        turn = turn * math.radians(self.affine_turn_deg)
        stretch_u, stretch_v, shear = (
            part * (self.affine_scale_percent / 100) for part in (stretch_u, stretch_v, shear))
        shift_u, shift_v = shift_u * self.affine_shift_px, shift_v * self.affine_shift_px
        column = torch.arange(columns.start, columns.stop)
        row = torch.arange(rows.start, rows.stop)[:, None]
        x, y = column - (width - 1) / 2, row - (height - 1) / 2
        along_v = _interpolation(len(row), self.shift_correlation_px)
        along_u = _interpolation(len(column), self.shift_correlation_px)
        knots = (2, *views.shape[:-2], along_v.shape[1], along_u.shape[1])
        wobble = along_v @ torch.randn(knots, generator=generator) @ along_u.T
        wobble *= self.strength * self.shift_px
        # The small terms are added first, which rounds less than adding each to the column.
        u = column + (wobble[0] + (x * stretch_u + y * (shear - turn) + shift_u))
        v = row + (wobble[1] + (y * stretch_v + x * (shear + turn) + shift_v))
        return u, v


def _interpolation(length: int, spacing: float) -> torch.Tensor:
    """Matrix (length, knots) that interpolates independent normal knots to unit variance."""
    place = torch.arange(length, dtype=torch.float64) / spacing
    knots = torch.arange(int(place[-1]) + 2)
    weights = (1 - (place[:, None] - knots).abs()).clamp(min=0)
    return (weights / weights.norm(dim=1, keepdim=True)).float()


def remap_depth(depth: torch.Tensor, u: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
    """Depth (..., h, w) of pictures (..., H, W), m, at the coordinates (u, v): bilinear on a
    surface, nearest at its silhouette; outside of a picture is background.

    The pixel nearest to (u, v) decides between cloth and background. Of the four pixels around
    (u, v), those within ``EDGE_STEP`` of its depth are interpolated with normalised weights.
    """
    height, width = depth.shape[-2:]
    pictures = depth.shape[:-2]
    shape = torch.broadcast_shapes((*pictures, 1, 1), u.shape, v.shape)
    # Outside a picture is background: one ring of padding, to which coordinates are clamped.
    flat = pad(depth, (1, 1, 1, 1)).flatten()
    stride = width + 2
    u = u.float().clamp(-1, width) + 1
    v = v.float().clamp(-1, height) + 1
    # Index of the first pixel of each picture in the flattened array.
    start = torch.arange(pictures.numel(), dtype=torch.int32)
    start = start.view(*pictures, 1, 1) * ((height + 2) * stride)
    nearest = (start + v.round().int() * stride + u.round().int()).expand(shape)
    centre = flat.index_select(0, nearest.flatten())
    # Most of a picture is background: interpolate only the cloth.
    cloth = centre.nonzero()[:, 0]

    centre = centre.index_select(0, cloth)
    u, v, start = (part.expand(shape).flatten().index_select(0, cloth) for part in (u, v, start))
    left, above = u.floor(), v.floor()
    right_weight, below_weight = u - left, v - above
    corner = start + above.int() * stride + left.int()
    total, weights = torch.zeros_like(centre), torch.zeros_like(centre)
    for step, weight in (
        (0, (1 - right_weight) * (1 - below_weight)),
        (1, right_weight * (1 - below_weight)),
        (stride, (1 - right_weight) * below_weight),
        (stride + 1, right_weight * below_weight),
    ):
        # With a weight of zero the index may exceed the array.
        value = flat.index_select(0, (corner + step).clamp(max=len(flat) - 1))
        weight = torch.where((value - centre).abs() < EDGE_STEP, weight, 0)
        total += weight * value
        weights += weight
    result = torch.zeros(shape.numel(), dtype=torch.float32)
    result[cloth] = total / weights
    return result.view(shape)


class TimeOfFlight(Sensor):
    """Errors of depth, and missing pixels; see ``configs/sensor/tof.yaml``."""

    axial_mm: Amount = 0.6
    signal_exponent: Amount = 0.5
    correlation_px: float = Field(1.25, ge=0.5, le=20)
    bias_mm: Amount = 3.0
    scale_percent: Amount = 0.3
    edge_invalid_least: Share = 0.3
    edge_invalid_most: Share = 0.6
    edge_blend: Share = 0.5
    grazing_deg: float = Field(80.0, ge=0, le=90)
    grazing_invalid: Share = 0.5
    hole_percent: float = Field(0.1, ge=0, le=100)
    step_mm: Amount = 1.0

    @model_validator(mode="after")
    def _in_order(self) -> "TimeOfFlight":
        if self.edge_invalid_least > self.edge_invalid_most:
            raise ValueError("edge_invalid_least must not exceed edge_invalid_most")
        return self

    def reach(self, size: int) -> float:
        """One pixel, so that the window contains all neighbours of cloth."""
        return 1.0

    def window(
        self, views: torch.Tensor, rows: slice, columns: slice, intrinsics: Intrinsics,
        generator: torch.Generator,
    ) -> torch.Tensor:
        depth = views[..., rows, columns]
        capture = (*views.shape[:-3], 1, 1, 1)
        slope_u, slope_v, edge, opposite = _surroundings(depth)
        cosine = _cosine(depth, slope_u, slope_v, rows, columns, intrinsics)

        lost = self.edge_invalid_most - self.edge_invalid_least
        lost = self.edge_invalid_least + lost * torch.rand(capture, generator=generator)
        kept = torch.where(edge, 1 - self._share(lost), 1.0)
        kept = torch.where(cosine < math.cos(math.radians(self.grazing_deg)),
                           kept * (1 - self._share(self.grazing_invalid)), kept)
        kept = kept * (1 - self._share(self.hole_percent / 100))
        measured = (depth > 0) & (torch.rand(depth.shape, generator=generator) < kept)

        blend = self._share(self.edge_blend) * torch.rand(depth.shape, generator=generator)
        mixed = torch.where(opposite > 0, depth + blend * (opposite - depth), depth)
        signal = cosine.clamp(min=MIN_COSINE) * (REFERENCE_DISTANCE / mixed).square()
        sigma = self.strength * self.axial_mm * 1e-3 * signal**-self.signal_exponent
        error = sigma * correlated_normal(depth.shape, self.correlation_px, generator)
        scale, bias = self.strength * torch.randn((2, *capture), generator=generator)
        noisy = mixed * (1 + scale * (self.scale_percent / 100)) + bias * (self.bias_mm * 1e-3)
        noisy = noisy + error
        if self.step_mm:
            noisy = (noisy / (self.step_mm * 1e-3)).round() * (self.step_mm * 1e-3)
        return torch.where(measured, noisy.clamp(min=0), 0)

    def _share(self, share: torch.Tensor | float) -> torch.Tensor | float:
        """A share of pixels multiplied by ``strength``, at most 1."""
        share = share * self.strength
        return share.clamp(max=1) if isinstance(share, torch.Tensor) else min(share, 1.0)


def _surroundings(
    depth: torch.Tensor,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """From the four neighbours of each pixel: slopes of the surface, m per column and per row, to
    the one that differs less; whether it is at an edge; depth of the neighbour across it, or 0.

    Pixels outside the picture are unknown and do not make an edge.
    """
    padded = pad(depth, (1, 1, 1, 1), value=math.nan)
    edge = torch.zeros_like(depth, dtype=torch.bool)
    opposite, largest = torch.zeros_like(depth), torch.full_like(depth, EDGE_STEP)
    slopes = []
    for before, after in (
        (padded[..., 1:-1, :-2], padded[..., 1:-1, 2:]),
        (padded[..., :-2, 1:-1], padded[..., 2:, 1:-1]),
    ):
        steps = []
        for neighbour in (before, after):
            step = torch.where(neighbour > 0, neighbour - depth, math.inf)
            size = step.abs()
            edge |= (size > EDGE_STEP) & ~neighbour.isnan()
            across = (neighbour > 0) & (size > largest)
            opposite = torch.where(across, neighbour, opposite)
            largest = torch.where(across, size, largest)
            steps.append(step)
        slope = torch.where(steps[0].abs() < steps[1].abs(), -steps[0], steps[1])
        slopes.append(torch.where(slope.isinf(), 0, slope))
    return slopes[0], slopes[1], edge & (depth > 0), opposite


def _cosine(
    depth: torch.Tensor, slope_u: torch.Tensor, slope_v: torch.Tensor, rows: slice,
    columns: slice, intrinsics: Intrinsics,
) -> torch.Tensor:
    """Cosine of the angle between each pixel's ray and the surface's normal.

    With r = (x, y, 1) the ray and P = z r the surface, the normal P_u × P_v is proportional to
    (-fx z_u, -fy z_v, x fx z_u + y fy z_v + z), and its product with r is z.
    """
    fx, fy = intrinsics.fx, intrinsics.fy
    x = (torch.arange(columns.start, columns.stop) - intrinsics.cx) / fx
    y = (torch.arange(rows.start, rows.stop)[:, None] - intrinsics.cy) / fy
    a, b = fx * slope_u, fy * slope_v
    normal_length = (a.square() + b.square() + (x * a + y * b + depth).square()).sqrt()
    ray_length = (x.square() + y.square() + 1).sqrt()
    return torch.where(depth > 0, depth / (normal_length * ray_length), 1.0)


def correlated_normal(
    shape: tuple[int, ...], correlation: float, generator: torch.Generator
) -> torch.Tensor:
    """Normal noise (..., h, w) of unit variance, correlated among neighbours.

    The correlation of pixels at distance d is exp(-d²/correlation²): white noise is filtered along
    rows and columns with the square root of the power spectrum of that function.
    """
    reach = math.ceil(3 * correlation)
    distance = torch.arange(-4 * reach, 4 * reach, dtype=torch.float64).roll(4 * reach)
    power = torch.fft.rfft(torch.exp(-(distance / correlation).square())).real.clamp(min=0)
    taps = torch.fft.irfft(power.sqrt(), n=len(distance)).roll(reach)[: 2 * reach + 1]
    taps = (taps / taps.norm()).tolist()
    height, width = shape[-2:]
    padded = (*shape[:-2], height + 2 * reach, width + 2 * reach)
    noise = torch.randn(padded, generator=generator)
    noise = sum(tap * noise[..., k : k + height, :] for k, tap in enumerate(taps))
    return sum(tap * noise[..., k : k + width] for k, tap in enumerate(taps))


MODELS: dict[str, type[Sensor]] = {
    "structured_light": StructuredLight,  # as in Feng et al. 2022
    "time_of_flight": TimeOfFlight,
}


@cache
def load_sensor(name: str = "smooth") -> Sensor:
    """Read ``configs/sensor/NAME.yaml``; InputError when there is no such file."""
    return sensor_from_config(read_option("sensor", name))


def sensor_from_config(config: Mapping) -> Sensor:
    """Build from the mapping of a sensor file."""
    settings = dict(config)
    name = settings.pop("model", "structured_light")
    if name not in MODELS:
        raise InputError(f"unknown sensor.model '{name}'; known: {', '.join(MODELS)}")
    return MODELS[name].of(settings, "sensor")
