"""Base class and random numbers of the noise models of depth sensors.

The models process many captures at once, on the device of the pictures. All randomness comes from
the given generator: on one device, equal seeds give equal pictures; on another device the numbers
differ, but not their distribution.
"""

import math
from abc import ABC, abstractmethod
from typing import Annotated

import torch
from pydantic import Field

from common.documents import Schema

Amount = Annotated[float, Field(ge=0)]
Share = Annotated[float, Field(ge=0, le=1)]


class SensorNoise(Schema, ABC):
    """Noise model; calling it returns noisy copies of depth pictures.

    Attributes:
        strength: factor of all random changes; at 0 pictures are unchanged.
    """

    remedy = "see configs/sensor"
    strength: Amount = 1.0

    def __call__(
        self, views: torch.Tensor, intrinsics: torch.Tensor, generator: torch.Generator
    ) -> torch.Tensor:
        """Noisy copies of the pictures of one or many captures.

        Args:
            views: (..., K, H, W) z-depth in metres, background 0: K pictures of each capture.
            intrinsics: (..., 4) fx, fy, cx, cy of each capture, px.
            generator: source of all randomness, on the device of ``views``.

        Returns:
            (..., K, H, W) float32 metres, background 0.
        """
        views = views.float()
        if self.strength == 0:
            return views.clone()
        noisy = torch.zeros_like(views)
        rows, columns = cloth_window(views, self.reach(max(views.shape[-2:])))
        if rows.stop:
            noisy[..., rows, columns] = self.window(views, rows, columns, intrinsics, generator)
        return noisy

    def reach(self, size: int) -> float:
        """Largest displacement of the silhouette, pixels, for pictures of ``size`` pixels (longer
        side).
        """
        return 0.0

    @abstractmethod
    def window(
        self,
        views: torch.Tensor,
        rows: slice,
        columns: slice,
        intrinsics: torch.Tensor,
        generator: torch.Generator,
    ) -> torch.Tensor:
        """Noisy pictures (..., K, h, w) in the window outside which all is background."""


def cloth_window(views: torch.Tensor, reach: float) -> tuple[slice, slice]:
    """Rows and columns that contain the cloth of all pictures (..., H, W) with ``reach`` pixels
    around it.
    """
    cloth = (views > 0).flatten(0, -3).any(0)
    slices = []
    for axis in (1, 0):
        indices = cloth.any(axis).nonzero().flatten().tolist() or [0, -1 - math.ceil(reach)]
        first, last = indices[0] - math.ceil(reach), indices[-1] + math.ceil(reach)
        slices.append(slice(max(0, first), max(0, min(last + 1, cloth.shape[1 - axis]))))
    return slices[0], slices[1]


def normal(shape: tuple[int, ...], like: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
    """Standard normal numbers (*shape), float32, on the device of ``like``."""
    return torch.randn(shape, generator=generator, device=like.device)


def uniform(shape: tuple[int, ...], like: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
    """Numbers (*shape) in [0, 1), float32, on the device of ``like``."""
    return torch.rand(shape, generator=generator, device=like.device)
