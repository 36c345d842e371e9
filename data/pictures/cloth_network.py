"""The network behind :mod:`data.pictures.cut`: which pixels show the specimen.

A U-Net (Ronneberger et al. 2015) that works on squares of two by two pixels of its picture.
"""

import torch
from torch import nn
from torch.nn.functional import interpolate, max_pool2d, pixel_shuffle, pixel_unshuffle

from data.pictures.cloth_view import COARSE, FINE

_WIDTHS = (16, 24, 48, 96, 128)


def _block(inputs: int, outputs: int) -> nn.Sequential:
    layers: list[nn.Module] = []
    for width in (inputs, outputs):
        layers += [nn.Conv2d(width, outputs, 3, padding=1, bias=False), nn.BatchNorm2d(outputs),
                   nn.ReLU(inplace=True)]
    return nn.Sequential(*layers)


class ClothNetwork(nn.Module):
    """Log odds that pixels show the specimen."""

    def __init__(self) -> None:
        super().__init__()
        inputs = (4 * FINE + COARSE, *_WIDTHS[:-1])
        self.down = nn.ModuleList(map(_block, inputs, _WIDTHS))
        above = [sum(pair) for pair in zip(_WIDTHS[1:], _WIDTHS[:-1], strict=True)]
        self.up = nn.ModuleList(map(_block, above[::-1], _WIDTHS[-2::-1]))
        self.last = nn.Conv2d(_WIDTHS[0], 4, 1)

    def forward(self, fine: torch.Tensor, coarse: torch.Tensor) -> torch.Tensor:
        """(N, S, S) of ``fine`` (N, FINE, S, S) and ``coarse`` (N, COARSE, S/2, S/2)."""
        values, kept = torch.cat([pixel_unshuffle(fine, 2), coarse], dim=1), []
        for level, block in enumerate(self.down):
            values = block(max_pool2d(values, 2) if level else values)
            kept.append(values)
        for block, finer in zip(self.up, kept[-2::-1], strict=True):
            values = block(torch.cat([interpolate(values, scale_factor=2.0), finer], dim=1))
        return pixel_shuffle(self.last(values), 2)[:, 0]
