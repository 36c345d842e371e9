"""What every energy of a batch offers, and how it keeps its elements.

Tensors have the samples on their first axis and the elements on their last, so that operations
run along contiguous memory whatever small axes lie between: a vector of each element is
(B, 3, N). The public faces of dofs, gradients and Hessians are views of these with the axes in the
order of :class:`sim.energies.base.Energy`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Protocol, TypeVar

import numpy as np
import torch
from torch import Tensor

from sim.energies.base import Energy


class BatchedEnergy(Protocol):
    """A sum over elements for each of B samples; see :class:`sim.energies.base.Energy`.

    The unknowns ``q`` (B, Q) float64 hold each sample's own, on the device of the energy. No number
    of a sample depends on another sample.

    Attributes:
        dofs: (B, N, K) int64, the entries of a sample's ``q`` each of its elements depends on; -1
            marks an absent one, whose gradient and Hessian entries are zero. Samples with
            fewer elements are filled up with elements that have no dofs and no energy.
    """

    @property
    def dofs(self) -> Tensor: ...

    def value(self, q: Tensor) -> Tensor:
        """(B,) energies, J."""

    def gradient(self, q: Tensor) -> Tensor:
        """(B, N, K) derivatives of each element's energy by its unknowns."""

    @property
    def coupled(self) -> Tensor:
        """(B, N, M) int64, the entries that Hessian blocks have; mostly the dofs."""

    def hessian(self, q: Tensor, convexity: float) -> Tensor | None:
        """(B, N, M, M) blocks of the Hessian, or None where all are zero.

        By moves in the frames of the edges, where the energy depends on their rotations: see
        :class:`sim.energies.base.FramedEnergy`. ``convexity``: 0.0 for the exact ones, 1.0 for
        positive semi-definite ones.
        """

    def allows(self, old: Tensor, new: Tensor) -> Tensor:
        """(B,) bool, whether the steps from ``old`` to ``new`` stay on one branch of the energy."""

    def take(self, index: Tensor) -> "BatchedEnergy":
        """The energy of the samples ``index`` (b,) int64."""


Self = TypeVar("Self", bound="ElementBatch")


@dataclass(frozen=True)
class ElementBatch:
    """What the batched energies have in common: all their fields are tensors, a sample a row.

    Attributes:
        entries: (B, K, N) int64, the dofs with the elements last.
        places: (B, K, N) int64, where elements read their unknowns: the dofs, and for absent ones
            some others that make a sound element. It must be the constants that silence these.
    """

    entries: Tensor
    places: Tensor

    @property
    def dofs(self) -> Tensor:
        return self.entries.mT

    @property
    def coupled(self) -> Tensor:
        return self.dofs

    def allows(self, old: Tensor, new: Tensor) -> Tensor:
        return torch.ones(len(old), dtype=torch.bool, device=old.device)

    def take(self: Self, index: Tensor) -> Self:
        return replace(self, **{f.name: getattr(self, f.name)[index] for f in fields(self)})

    def unknowns(self, q: Tensor) -> Tensor:
        """(B, K, N) those of each element."""
        return q.gather(1, self.places.flatten(1)).view(self.places.shape)

    def corners(self, q: Tensor) -> Tensor:
        """(B, K/3, 3, N) the unknowns as points."""
        return self.unknowns(q).unflatten(1, (-1, 3))


def stack_places(energies: Sequence[Energy], device: torch.device | str) -> dict[str, Tensor]:
    """The fields of :class:`ElementBatch` for elements without absent dofs."""
    dofs = [energy.dofs for energy in energies]
    return {
        "entries": stack_elements(dofs, device, fill=-1),
        "places": stack_elements(dofs, device),
    }


def stack_elements(
    arrays: Sequence[np.ndarray], device: torch.device | str, *, fill: float | None = None
) -> Tensor:
    """One tensor (B, ..., N) of the samples' arrays (N_b, ...), N the largest N_b.

    Shorter ones end with ``fill`` or, without it, with copies of their first element.
    """
    count = max(len(array) for array in arrays)
    rows = []
    for array in arrays:
        first = array[:1] if len(array) else np.zeros((1, *array.shape[1:]), array.dtype)
        filler = np.repeat(first, count - len(array), axis=0)
        if fill is not None:
            filler[...] = fill
        rows.append(np.moveaxis(np.concatenate([array, filler]), 0, -1))
    return torch.from_numpy(np.stack(rows)).contiguous().to(device)


def stack_numbers(numbers: Sequence[float], device: torch.device | str) -> Tensor:
    """One number of each sample, (B, 1)."""
    return torch.tensor(np.asarray(numbers, dtype=np.float64)[:, None], device=device)


def dyads(left: Tensor, right: Tensor) -> Tensor:
    """(B, I, J, N) sums over k of the dyads of left (B, K, I, N) and right (B, K, J, N)."""
    total = left[:, 0, :, None] * right[:, 0, None]
    for k in range(1, left.shape[1]):
        total.addcmul_(left[:, k, :, None], right[:, k, None])
    return total


def cross(a: Tensor, b: Tensor) -> Tensor:
    """Vector products (..., 3, N)."""
    # Several times as fast as torch.linalg.cross, which does not vectorise along other axes.
    ax, ay, az = a.unbind(-2)
    bx, by, bz = b.unbind(-2)
    return torch.stack((ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx), dim=-2)


def dot(a: Tensor, b: Tensor) -> Tensor:
    """Scalar products (..., N) of vectors (..., 3, N)."""
    return (a * b).sum(-2)
