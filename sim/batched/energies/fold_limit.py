"""Keeps hinges from folding through themselves, over batches."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from sim.batched.energies import dihedral
from sim.batched.energies.base import ElementBatch, dyads, stack_elements, stack_places
from sim.energies.fold_limit import LEAST_ROOM, LIMIT_START, FoldLimit

_SIDES = ((2, 1, 0), (3, 1, 0))  # triangles of a hinge: opposite corner, end and start of the edge


@dataclass(frozen=True)
class BatchedFoldLimit(ElementBatch):
    """Batched :class:`sim.energies.fold_limit.FoldLimit`.

    Attributes:
        scale: (B, N) J.
    """

    scale: Tensor

    @classmethod
    def stack(
        cls, energies: Sequence[FoldLimit], device: torch.device | str = "cpu"
    ) -> "BatchedFoldLimit":
        scale = stack_elements([energy.scale for energy in energies], device, fill=0.0)
        return cls(**stack_places(energies, device), scale=scale)

    def angles(self, q: Tensor) -> Tensor:
        """(B, N) dihedral angles, rad."""
        return dihedral.angles(self.corners(q))

    def value(self, q: Tensor) -> Tensor:
        return (self.scale * _barrier(self.angles(q).abs())[0]).sum(1)

    def gradient(self, q: Tensor) -> Tensor:
        result = torch.zeros_like(self.places, dtype=q.dtype)
        place, frames, slope, _ = self._bent(q)
        rows = (slope * dihedral.gradient(frames)).flatten(0, 1)
        result.mT[place] = rows.mT
        return result.mT

    def is_felt(self, q: Tensor) -> Tensor:
        """(B,) bool, whether :meth:`hessian` is not zero."""
        return (self.angles(q).abs() > LIMIT_START).any(1)

    def hessian(self, q: Tensor, convexity: float) -> Tensor | None:
        place, frames, slope, bend = self._bent(q)
        if not len(bend):
            return None
        rows = dihedral.gradient(frames).flatten(0, 1)[None, None]
        blocks = dyads(rows, bend * rows)
        if convexity == 0.0:
            factors = dihedral.second_factors(frames, slope)
            groups = blocks.view(4, 3, 4, 3, -1)
            for side, corners in enumerate(_SIDES):
                dihedral.add_dyads(groups, frames.normal[side], factors[side], corners)
        samples, size, count = self.places.shape
        result = q.new_zeros(samples, size, size, count).permute(0, 3, 1, 2)
        result[place] = blocks[0].permute(2, 0, 1)
        return result

    def allows(self, old: Tensor, new: Tensor) -> Tensor:
        """False where a hinge would jump past pi or take most of its way there in one step."""
        before, after = self.angles(old), self.angles(new)
        room = (math.pi - before.abs()).clamp(max=math.pi - LIMIT_START)
        enough = math.pi - after.abs() >= LEAST_ROOM * room
        return (((after - before).abs() < math.pi) & enough).all(1)

    def _bent(self, q: Tensor) -> tuple[tuple[Tensor, Tensor], dihedral.Frames, Tensor, Tensor]:
        """Of the hinges beyond the limit's start: sample and element, frames, derivatives (M,)."""
        corners = self.corners(q)
        angle = dihedral.angles(corners)
        place = (angle.abs() > LIMIT_START).nonzero(as_tuple=True)
        frames = dihedral.frames(corners.permute(0, 3, 1, 2)[place].permute(1, 2, 0))
        angle, scale = angle[place], self.scale[place]
        _, slope, bend = _barrier(angle.abs())
        return place, frames, slope * scale * angle.sign(), bend * scale


def _barrier(angle: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Barrier per unit of scale and its first two derivatives; 0 below LIMIT_START."""
    angle = angle.clamp(min=LIMIT_START)
    over, left = angle - LIMIT_START, math.pi - angle
    logarithm = (left / (math.pi - LIMIT_START)).log()
    return (
        -(over**2) * logarithm,
        over**2 / left - 2.0 * over * logarithm,
        4.0 * over / left + over**2 / left**2 - 2.0 * logarithm,
    )
