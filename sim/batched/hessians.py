"""The Hessians of many cloths at one point, assembled as far as they are asked for."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch

from sim.batched.objective import on_device, on_host, part_of
from sim.linear import SparsePattern
from sim.potential import stage_shares

if TYPE_CHECKING:
    from sim.batched.potential import BatchedPotential

_AT_A_TIME = {"cpu": 2, "cuda": 64}  # samples whose element blocks are in memory


@dataclass(frozen=True)
class Layout:
    """A pattern on the device.

    Attributes:
        pattern: itself.
        wide: whether it has places for energies that are felt seldom.
        diagonal: (n,) where the diagonal is in the CSR data.
        keys: (nnz,) see :func:`_keys`.
    """

    pattern: SparsePattern
    wide: bool
    diagonal: torch.Tensor
    keys: torch.Tensor

    @classmethod
    def of(
        cls, pattern: SparsePattern, device: torch.device | str, *, wide: bool
    ) -> "Layout":
        return cls(
            pattern=pattern,
            wide=wide,
            diagonal=torch.from_numpy(pattern.diagonal.astype(np.int64)).to(device),
            keys=_keys(pattern.indptr, pattern.indices).to(device),
        )


class CachedHessians:
    """Hessians of a batch at one point; what has been assembled is kept for other convexities.

    All but those in the wide pattern, which are few.

    Args:
        potential: of B samples.
        q: (B, Q) all unknowns of the samples' meshes.
    """

    def __init__(self, potential: "BatchedPotential", q: torch.Tensor) -> None:
        self._potential, self._q = potential, q
        self._wide = on_host(potential.is_felt(self._q))
        self._data: dict[tuple[int, float], torch.Tensor] = {}
        self._known: dict[tuple[int, float], np.ndarray] = {}

    def systems(
        self, index: np.ndarray, convexity: np.ndarray, shift: np.ndarray
    ) -> Iterator[tuple[np.ndarray, SparsePattern, torch.Tensor]]:
        """See :meth:`sim.batched.objective.Hessians.systems`."""
        for wide in (False, True):
            which = np.flatnonzero(self._wide[index] == wide)
            if len(which):
                layout = self._potential.layout(wide=wide)
                data = self._sum(index[which], convexity[which], shift[which], layout)
                yield which, layout.pattern, data

    def into_frames(self, index: np.ndarray, gradient: torch.Tensor) -> torch.Tensor:
        """(b, n) derivatives by moves in the frames of the samples ``index`` (b,)."""
        return self._part(index).into_frames(self._at(index), gradient)

    def out_of_frames(self, index: np.ndarray, move: torch.Tensor) -> torch.Tensor:
        """(b, n) moves of the unknowns of the samples ``index`` (b,)."""
        return self._part(index).out_of_frames(self._at(index), move)

    def _sum(
        self, index: np.ndarray, convexity: np.ndarray, shift: np.ndarray, layout: Layout
    ) -> torch.Tensor:
        """CSR data (b, nnz) of samples of one pattern."""
        shares = np.array([stage_shares(c, self._potential.stages) for c in convexity])
        total = None
        for stage in range(self._potential.stages):
            for end, weight in ((0.0, 1.0 - shares[:, stage]), (1.0, shares[:, stage])):
                needed = weight > 0.0
                if not needed.any():
                    continue
                if layout.wide:
                    part = torch.cat([self._assembled(stage, end, some, layout)
                                      for some in self._portions(index)])
                else:
                    part = self._end(stage, end, index[needed])[on_device(index, self._q)]
                if not (weight == 1.0).all():
                    part *= on_device(weight, part)[:, None]
                total = part if total is None else total.add_(part)
        at = on_device(index, self._q)
        self._potential.complete(total, at, on_device(shift, total), layout)
        return total

    def _end(self, stage: int, convexity: float, index: np.ndarray) -> torch.Tensor:
        """(B, nnz) one stage, exact (0) or convex (1), assembled for the samples ``index``."""
        key = stage, convexity
        layout = self._potential.layout(wide=False)
        if key not in self._data:
            self._data[key] = self._q.new_zeros(len(self._q), len(layout.keys))
            self._known[key] = np.zeros(len(self._q), dtype=bool)
        missing = index[~self._known[key][index]]
        for some in self._portions(missing):
            self._data[key][on_device(some, self._q)] = self._assembled(
                stage, convexity, some, layout)
        self._known[key][missing] = True
        return self._data[key]

    def _assembled(
        self, stage: int, convexity: float, index: np.ndarray, layout: Layout
    ) -> torch.Tensor:
        """(b, nnz) one stage, exact (0) or convex (1), of the samples ``index`` (b,)."""
        return self._part(index).assemble(self._at(index), stage, convexity, layout)

    def _portions(self, index: np.ndarray) -> list[np.ndarray]:
        """Samples whose element blocks have room in memory together."""
        many = _AT_A_TIME[self._q.device.type]
        return [index[first : first + many] for first in range(0, len(index), many)]

    def _part(self, index: np.ndarray) -> "BatchedPotential":
        return part_of(self._potential, index, self._q)

    def _at(self, index: np.ndarray) -> torch.Tensor:
        return self._q[on_device(index, self._q)]


def _keys(indptr: np.ndarray, indices: np.ndarray) -> torch.Tensor:
    """(nnz,) ascending numbers of the pattern's entries: row times size, plus column."""
    size = len(indptr) - 1
    rows = np.repeat(np.arange(size), np.diff(indptr))
    return torch.from_numpy(rows * size + indices)
