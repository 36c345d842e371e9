"""Noise of a structured-light sensor.

The model of Feng et al. 2022, section 5.2.2, which refers to Barron & Malik 2013 and
Bohg et al. 2014: pixels are displaced by fractions of a pixel, and the disparity is noisy and
quantised to 1/8 pixel. Both references describe the same steps: in eighths of a pixel the disparity
is d = K/z, K = 8 f b = 351.3 m for the first Kinect (focal length f in pixels, baseline b in
metres). At 0.53 m a step is 0.8 mm. Depth is not rounded to centimetres first, as in certain
implementations, because that would destroy the shape of a drape.

In addition: a small affine transform of each picture, as in the paper, and the 8-bit quantisation
of the published captures for a part of the samples, so that the network is trained on both formats.
"""

import math

import torch
from pydantic import Field

from data.render.remap import remap_depth
from data.render.sensor_noise import Amount, SensorNoise, Share, normal, uniform

EIGHTHS_OF_DISPARITY = 351.3  # m, K above
EIGHT_BIT_STEP = 1 / 255  # m per count in the published captures


class StructuredLight(SensorNoise):
    """Random displacement of pixels, and noisy, quantised disparity; pixels are those of the rig.

    Attributes:
        strength: factor of all standard deviations below; at 0 pictures are unchanged.
        shift_px: standard deviation of a pixel's displacement, in columns and in rows.
        shift_correlation_px: correlation length of the displacement. At 1 pixels are independent,
            which frays silhouettes; those of the published captures are not frayed.
        disparity_px: standard deviation of the disparity; by default 1/6 of its step of 1/8 px.
        affine_scale_percent: standard deviation of each picture's stretch and shear.
        affine_turn_deg: standard deviation of its rotation about the centre.
        affine_shift_px: standard deviation of its translation.
        eight_bit_probability: share of captures with the 8-bit steps of the published captures.
    """

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
        self,
        views: torch.Tensor,
        rows: slice,
        columns: slice,
        intrinsics: torch.Tensor,
        generator: torch.Generator,
    ) -> torch.Tensor:
        """See :meth:`data.render.sensor_noise.SensorNoise.window`; the intrinsics are not
        needed."""
        coarse = uniform((*views.shape[:-3], 1, 1, 1), views, generator)
        u, v = self._look_up(views, rows, columns, generator)
        # Background, depth 0, has infinite disparity and remains background.
        disparity = EIGHTHS_OF_DISPARITY / remap_depth(views, u, v)
        sigma = 8 * self.disparity_px * self.strength
        disparity += sigma * normal(disparity.shape, views, generator)
        depth = EIGHTHS_OF_DISPARITY / disparity.round()
        steps = (depth / EIGHT_BIT_STEP).round() * EIGHT_BIT_STEP
        return torch.where(coarse < self.eight_bit_probability, steps, depth)

    def _look_up(
        self, views: torch.Tensor, rows: slice, columns: slice, generator: torch.Generator
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Displaced coordinates u and v (..., K, h, w) of each pixel of the window."""
        height, width = views.shape[-2:]
        six = normal((6, *views.shape[:-2], 1, 1), views, generator) * self.strength
        turn, stretch_u, stretch_v, shear, shift_u, shift_v = six
        turn = turn * math.radians(self.affine_turn_deg)
        stretch_u, stretch_v, shear = (
            part * (self.affine_scale_percent / 100) for part in (stretch_u, stretch_v, shear))
        shift_u, shift_v = shift_u * self.affine_shift_px, shift_v * self.affine_shift_px
        column = torch.arange(columns.start, columns.stop, device=views.device)
        row = torch.arange(rows.start, rows.stop, device=views.device)[:, None]
        x, y = column - (width - 1) / 2, row - (height - 1) / 2
        along_v = _interpolation(len(row), self.shift_correlation_px).to(views.device)
        along_u = _interpolation(len(column), self.shift_correlation_px).to(views.device)
        knots = (2, *views.shape[:-2], along_v.shape[1], along_u.shape[1])
        wobble = along_v @ normal(knots, views, generator) @ along_u.T
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
