"""Noise of a time-of-flight sensor such as that of Azure Kinect or Orbbec Femto.

- Random: a pixel's standard deviation decreases with the returned light, which is proportional to
  cos(incidence)/z²; neighbours are correlated by the sensor's filter.
- Systematic: bias and scale of each capture.
- Missing: at edges, where a pixel sees two surfaces, depth is missing or between them (flying
  pixels); at grazing incidence the returned light is too weak; a few pixels fail anywhere. Missing
  depth is 0, like background.
- Quantisation to millimetres.

Defaults: figures published for Azure Kinect, about 0.6 mm of random error at 0.5 m (the
manufacturer's bounds are 17 mm random and 11 mm + 0.1 % systematic).
"""

import math

import torch
from pydantic import Field, model_validator
from torch.nn.functional import pad

from data.render.remap import EDGE_STEP
from data.render.sensor_noise import Amount, SensorNoise, Share, normal, uniform

REFERENCE_DISTANCE = 0.5  # m, of axial_mm
MIN_COSINE = 0.05  # of the incidence; above 87 degrees a pixel's slope is not resolved


class TimeOfFlight(SensorNoise):
    """Random and systematic errors of depth, and missing pixels.

    Attributes:
        strength: factor of all standard deviations and shares; at 0 pictures are unchanged.
        axial_mm: standard deviation of depth at 0.5 m and normal incidence.
        signal_exponent: the standard deviation is proportional to the returned light to the power
            of minus this: 0.5 for photon noise, 1 for noise of the electronics.
        correlation_px: distance at which the correlation of neighbours is 1/e.
        bias_mm: standard deviation of a capture's bias.
        scale_percent: standard deviation of a capture's scale.
        edge_invalid_least, edge_invalid_most: range of the share of missing edge pixels, uniform
            over captures. Edges are depth steps of more than 20 mm and the ends of the cloth.
        edge_blend: largest weight of the other surface in the remaining edge pixels.
        grazing_deg: incidence above which pixels may be missing.
        grazing_invalid: share of these that are missing.
        hole_percent: missing pixels elsewhere.
        step_mm: quantisation step of depth; 0 for none.
    """

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
        self,
        views: torch.Tensor,
        rows: slice,
        columns: slice,
        intrinsics: torch.Tensor,
        generator: torch.Generator,
    ) -> torch.Tensor:
        """See :meth:`data.render.sensor_noise.SensorNoise.window`."""
        depth = views[..., rows, columns]
        capture = (*views.shape[:-3], 1, 1, 1)
        slope_u, slope_v, edge, other = _surroundings(depth)
        cosine = _cosine(depth, slope_u, slope_v, rows, columns, intrinsics)

        lost = self.edge_invalid_most - self.edge_invalid_least
        lost = self.edge_invalid_least + lost * uniform(capture, views, generator)
        kept = torch.where(edge, 1 - self._share(lost), 1.0)
        kept = torch.where(cosine < math.cos(math.radians(self.grazing_deg)),
                           kept * (1 - self._share(self.grazing_invalid)), kept)
        kept = kept * (1 - self._share(self.hole_percent / 100))
        seen = (depth > 0) & (uniform(depth.shape, views, generator) < kept)

        blend = self._share(self.edge_blend) * uniform(depth.shape, views, generator)
        mixed = torch.where(other > 0, depth + blend * (other - depth), depth)
        signal = cosine.clamp(min=MIN_COSINE) * (REFERENCE_DISTANCE / mixed).square()
        sigma = self.strength * self.axial_mm * 1e-3 * signal**-self.signal_exponent
        error = sigma * correlated_normal(depth.shape, self.correlation_px, views, generator)
        scale, bias = self.strength * normal((2, *capture), views, generator)
        noisy = mixed * (1 + scale * (self.scale_percent / 100)) + bias * (self.bias_mm * 1e-3)
        noisy = noisy + error
        if self.step_mm:
            noisy = (noisy / (self.step_mm * 1e-3)).round() * (self.step_mm * 1e-3)
        return torch.where(seen, noisy.clamp(min=0), 0)

    def _share(self, share: torch.Tensor | float) -> torch.Tensor | float:
        """A share of pixels multiplied by ``strength``, at most 1."""
        share = share * self.strength
        return share.clamp(max=1) if isinstance(share, torch.Tensor) else min(share, 1.0)


def _surroundings(
    depth: torch.Tensor,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Slopes and edges from the four neighbours of each pixel of pictures (..., h, w).

    Pixels outside the picture are unknown and do not make an edge.

    Returns:
        Slopes of the surface, m per column and m per row, from the neighbour that differs less;
        whether the pixel is at an edge; depth of the neighbour across it, 0 for none.
    """
    padded = pad(depth, (1, 1, 1, 1), value=math.nan)
    edge = torch.zeros_like(depth, dtype=torch.bool)
    other, largest = torch.zeros_like(depth), torch.full_like(depth, EDGE_STEP)
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
            other = torch.where(across, neighbour, other)
            largest = torch.where(across, size, largest)
            steps.append(step)
        slope = torch.where(steps[0].abs() < steps[1].abs(), -steps[0], steps[1])
        slopes.append(torch.where(slope.isinf(), 0, slope))
    return *slopes, edge & (depth > 0), other


def _cosine(
    depth: torch.Tensor,
    slope_u: torch.Tensor,
    slope_v: torch.Tensor,
    rows: slice,
    columns: slice,
    intrinsics: torch.Tensor,
) -> torch.Tensor:
    """Cosine of the angle between each pixel's ray and the surface's normal.

    With r = (x, y, 1) the ray and P = z r the surface, the normal P_u × P_v is proportional to
    (-fx z_u, -fy z_v, x fx z_u + y fy z_v + z), and its product with r is z.
    """
    fx, fy, cx, cy = intrinsics.to(depth.dtype)[..., None, None, None, :].unbind(-1)
    x = (torch.arange(columns.start, columns.stop, device=depth.device) - cx) / fx
    y = (torch.arange(rows.start, rows.stop, device=depth.device)[:, None] - cy) / fy
    a, b = fx * slope_u, fy * slope_v
    normal_length = (a.square() + b.square() + (x * a + y * b + depth).square()).sqrt()
    ray_length = (x.square() + y.square() + 1).sqrt()
    return torch.where(depth > 0, depth / (normal_length * ray_length), 1.0)


def correlated_normal(
    shape: tuple[int, ...], correlation: float, like: torch.Tensor, generator: torch.Generator
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
    noise = normal((*shape[:-2], height + 2 * reach, width + 2 * reach), like, generator)
    noise = sum(tap * noise[..., k : k + height, :] for k, tap in enumerate(taps))
    return sum(tap * noise[..., k : k + width] for k, tap in enumerate(taps))
