"""Cholesky factorisation of many sparse matrices of one pattern at once, in plain PyTorch.

    P A Pᵀ = L Lᵀ,  A x = b  by  L y = P b,  Lᵀ (P x) = y

P is the order of elimination of :mod:`sim.linear.nested_dissection`; L is kept as the dense pieces
of the groups of :mod:`sim.linear.fronts`. Every operation takes the fronts of one group, or of one
depth, in all samples together, so that the number of calls depends neither on the batch nor, much,
on the mesh, and nothing waits for the device on the way. A sample's numbers never meet another's: a
matrix that is not positive definite spoils its own sample alone. NVIDIA's cuDSS (nvmath-python)
factorises batches too, but needs a GPU, and does not say which of the samples are definite.
"""

import math
from collections.abc import Sequence

import numpy as np
import torch

from common.errors import InputError
from sim.linear.fronts import Flow, Group, plan_fronts
from sim.linear.nested_dissection import dissect
from sim.linear.pattern import SparsePattern

_LEAF = 60
"""Unknowns of the regions that are not dissected any more."""
_GROUP_COST = 2e6
"""Floating point operations of padding that one stack of fronts less is worth."""


class FrontalSolver:
    """Factorises batches of matrices of one pattern; all memory is kept for the next batch.

    The batch may have another size each time, as when finished samples leave it.

    Args:
        pattern: of the upper triangle.
        places: (n, 2) where each unknown lies on the flat specimen, m.
        device: of all tensors.

    Attributes:
        fronts: layout and counts.
        definite: (B,) bool, which of the last matrices have a factor.

    Raises:
        InputError: not one finite place per unknown.
    """

    def __init__(
        self, pattern: SparsePattern, places: np.ndarray, *, device: torch.device | str = "cpu"
    ) -> None:
        places = np.asarray(places, dtype=np.float64)
        if places.shape != (pattern.size, 2) or not np.isfinite(places).all():
            raise InputError(f"{pattern.size} unknowns need places ({pattern.size}, 2), all "
                             f"finite, got {places.shape}")
        tree = dissect(pattern.indptr, pattern.indices, places, leaf=_LEAF)
        # As tensors name it: a device "cuda" is not equal to theirs, "cuda:0".
        self._device = torch.empty(0, device=device).device
        self.fronts = plan_fronts(pattern, tree, group_cost=_GROUP_COST, device=self._device)
        self._size, self._entries = pattern.size, len(pattern.indices)
        self.definite = torch.empty(0, dtype=torch.bool, device=self._device)
        self._memory: dict[object, torch.Tensor] = {}
        self._factors: list[list[tuple[torch.Tensor, torch.Tensor]]] = []

    @property
    def nbytes(self) -> int:
        """Memory kept, without the index lists."""
        return sum(buffer.nbytes for buffer in self._memory.values())

    def factorise(self, data: torch.Tensor) -> torch.Tensor:
        """Factor the matrices with the CSR data (B, nnz) of the upper triangle.

        Returns:
            (B,) bool, on the device: whether each matrix is positive definite. One with a NaN or
            an infinite entry is not.

        Raises:
            InputError: another shape, type or device.
        """
        self._check("matrices", data, (len(data), self._entries))
        self.definite = torch.ones(len(data), dtype=torch.bool, device=self._device)
        panels = self._buffer("panels", (len(data), self.fronts.panel_size)).zero_()
        panels.index_fill_(1, self.fronts.ones, 1.0)
        self._add(panels, data, self.fronts.values)
        self._factors = [self._eliminate(number, group, panels)
                         for number, group in enumerate(self.fronts.groups)]
        return self.definite

    def solve(self, rhs: torch.Tensor) -> torch.Tensor:
        """Solutions (B, n) of A x = ``rhs`` (B, n) with the last factors, NaN without a factor.

        Raises:
            InputError: another shape, type or device than that of the last factors.
        """
        samples = len(self.definite)
        self._check("right-hand sides", rhs, (samples, self._size))
        # The row n stands for padding: zero on the way in, and it stays so.
        x = torch.cat([rhs, rhs.new_zeros(samples, 1)], dim=1)
        steps = list(zip(self.fronts.groups, self._factors, strict=True))
        for group, (lower, rows) in steps:
            y = torch.linalg.solve_triangular(lower, _take(x, group.own, group), upper=False)
            x.scatter_(1, _each(group.own, x), y.flatten(1))
            change = (rows @ y).neg_().flatten(1)
            for flow in group.carried:
                self._add(x, change, flow)
        for group, (lower, rows) in reversed(steps):
            y = _take(x, group.own, group) - rows.mT @ _take(x, group.later, group)
            found = torch.linalg.solve_triangular(lower.mT, y, upper=True)
            x.scatter_(1, _each(group.own, x), found.flatten(1))
        return torch.where(self.definite[:, None], x[:, :-1], torch.nan)

    def _eliminate(
        self, number: int, group: Group, panels: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Factor a group's panels and change those of later groups.

        Returns:
            The pieces of L: (B, c, p, p), lower triangular, and (B, c, u, p) below.
        """
        corner, below = group.panels(panels)
        lower = self._buffer((number, "lower"), corner.shape).copy_(corner)
        rows = self._buffer((number, "rows"), below.shape)
        # LAPACK's matrices are column-major: to it, this lower triangle is an upper one.
        info = torch.empty(lower.shape[:2], dtype=torch.int32, device=self._device)
        torch.linalg.cholesky_ex(lower.mT, upper=True, out=(lower.mT, info))
        diagonal = lower.diagonal(dim1=-2, dim2=-1)
        sound = (diagonal > 0.0) & (diagonal < torch.inf)  # nor NaN
        self.definite &= (info == 0).all(dim=1) & sound.flatten(1).all(dim=1)
        torch.linalg.solve_triangular(lower, below.mT, upper=False, out=rows.mT)
        flat = rows.flatten(0, 1)
        update = self._buffer("update", (len(flat), group.others, group.others))
        update.baddbmm_(flat, flat.mT, beta=0.0, alpha=-1.0)
        for flow in group.updates:
            self._add(panels, update.view(len(panels), -1), flow)
        return lower, rows

    def _add(self, target: torch.Tensor, source: torch.Tensor, flow: Flow) -> None:
        """Add entries of the source (B, ...) to the target (B, ...)."""
        take, put = (_each(index, source) for index in flow)
        part = torch.gather(source, 1, take, out=self._buffer("part", tuple(take.shape)))
        target.scatter_add_(1, put, part)

    def _buffer(self, name: object, shape: Sequence[int]) -> torch.Tensor:
        """A tensor in memory that is kept: fresh memory costs more than the arithmetic."""
        count = math.prod(shape)
        kept = self._memory.get(name)
        if kept is None or len(kept) < count:
            kept = self._memory[name] = torch.empty(
                count, dtype=torch.float64, device=self._device)
        return kept[:count].view(shape)

    def _check(self, name: str, tensor: torch.Tensor, shape: tuple[int, int]) -> None:
        if tensor.shape != shape or tensor.dtype != torch.float64 or tensor.device != self._device:
            raise InputError(f"{name} must be {shape} float64 on {self._device}, not "
                             f"{tuple(tensor.shape)} {tensor.dtype} on {tensor.device}")


def _take(x: torch.Tensor, index: torch.Tensor, group: Group) -> torch.Tensor:
    """Entries (c k,) of x (B, n + 1) as columns (B, c, k, 1)."""
    return x.gather(1, _each(index, x)).view(len(x), group.count, -1, 1)


def _each(index: torch.Tensor, samples: torch.Tensor) -> torch.Tensor:
    """The index (M,) for every sample, (B, M)."""
    return index.expand(len(samples), -1)
