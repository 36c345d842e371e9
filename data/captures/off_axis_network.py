"""The network behind :mod:`data.captures.off_axis`: how an outline differs from the one seen on the
axis. All lengths are over the specimen's size, so that a network serves testers of any size; its
layers are convolutions around the outline, so that it does not depend on where azimuth 0 is.
"""

from typing import NamedTuple

import torch
from torch import nn
from torch.nn.functional import conv1d, gelu, pad

AZIMUTHS = 360
"""Of the outlines that the network has learned, equally spaced from 0 on."""
_COLUMNS = 180  # of its layers
_WIDTH, _KERNEL, _DILATIONS = 32, 5, (1, 2, 4, 8, 16)
_TURN, _STEP = 0.5, 0.2  # rad and sizes for an output of 1, per place beside the axis over height


class Seen(NamedTuple):
    """N outlines as seen, in sizes of their specimens.

    Attributes:
        radius: (N, A) on the plane of the plate, A a multiple of 180.
        border: (N, A) of the flat specimen at the same azimuths.
        plate: (N,) radius of the plate.
        height: (N,) of the camera above the plate.
        lean: (N, 2) place of the camera beside the axis over its height.
    """

    radius: torch.Tensor
    border: torch.Tensor
    plate: torch.Tensor
    height: torch.Tensor
    lean: torch.Tensor


class OffAxisNetwork(nn.Module):
    """Moves an outline along azimuth and radius, in proportion to the camera's place beside the
    axis: none where the camera is on it."""

    def __init__(self) -> None:
        super().__init__()
        self.first, *layers = (
            nn.Conv1d(inputs, _WIDTH, _KERNEL, dilation=step, padding="same",
                      padding_mode="circular")
            for inputs, step in ((7, 1), *((_WIDTH, step) for step in _DILATIONS)))
        self.layers = nn.ModuleList(layers)
        self.last = nn.Conv1d(_WIDTH, 2, 1)
        for value in self.last.parameters():
            nn.init.zeros_(value)

    def forward(self, radius: torch.Tensor, border: torch.Tensor, plate: torch.Tensor,
                height: torch.Tensor, lean: torch.Tensor) -> torch.Tensor:
        """Radii (N, A), in sizes (m/m), of the outlines from the axis, of the parts of
        :class:`Seen`."""
        seen, count = Seen(radius, border, plate, height, lean), radius.shape[1]
        far = lean.norm(dim=1, keepdim=True)
        turn, step = _spread(self._outputs(seen), count).unbind(1)
        place = torch.arange(count) + far * turn * (_TURN * count / (2 * torch.pi))
        return _between(radius, place) + far * step * _STEP

    def _outputs(self, seen: Seen) -> torch.Tensor:
        """(N, 2, _COLUMNS)."""
        azimuth = torch.arange(_COLUMNS) * (2 * torch.pi / _COLUMNS)
        cos, sin = torch.cos(azimuth), torch.sin(azimuth)
        x, y = seen.lean[:, :1], seen.lean[:, 1:]
        radius, border = _pooled(seen.radius), _pooled(seen.border)
        same = [(2 * value - 1)[:, None].expand_as(radius)
                for value in (2 * seen.plate, 1 / seen.height, 2 * seen.lean.norm(dim=1))]
        values = torch.stack([8 * radius - 3, 4 * border - 2, *same, 3 * (x * cos + y * sin),
                              3 * (y * cos - x * sin)], dim=1)
        values = gelu(self.first(values))
        for layer in self.layers:
            values = values + gelu(layer(values))
        return self.last(values)


def _pooled(values: torch.Tensor) -> torch.Tensor:
    """(N, _COLUMNS) of (N, A): means weighted by the distance from each column."""
    step = values.shape[1] // _COLUMNS
    weights = 1 - torch.arange(1 - step, step).abs() / step
    padded = pad(values[:, None], (step - 1, step - 1), mode="circular")
    return conv1d(padded, (weights / weights.sum())[None, None], stride=step)[:, 0]


def _spread(values: torch.Tensor, count: int) -> torch.Tensor:
    """(N, C, ``count``) of (N, C, _COLUMNS), linearly between the columns."""
    place = (torch.arange(count) * (_COLUMNS / count)).expand(*values.shape[:2], -1)
    return _between(values, place)


def _between(values: torch.Tensor, place: torch.Tensor) -> torch.Tensor:
    """``values`` (..., A) around an outline at ``place`` (..., B), in samples, linearly."""
    count, low = values.shape[-1], place.detach().floor()
    part, index = place - low, low.long()
    return (torch.gather(values, -1, index % count) * (1 - part)
            + torch.gather(values, -1, (index + 1) % count) * part)
