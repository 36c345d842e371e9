"""What models of a depth sensor share.

They change many captures at once, on the device where the pictures are. All randomness comes from
the generator given: on one device, equal seeds give equal pictures; on another, the numbers differ
but their distribution does not.
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
    """Random changes of depth pictures; calling it returns changed copies.

    Attributes:
        strength: multiplies everything random; at 0 pictures stay as they are.
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
        """Pixels by which cloth may grow in a picture of ``size`` pixels along its longer side."""
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
        """The part of the noisy pictures outside of which all is background, (..., K, h, w)."""


def cloth_window(views: torch.Tensor, reach: float) -> tuple[slice, slice]:
    """Rows and columns of all pictures (..., H, W) within ``reach`` pixels of cloth."""
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
