"""Cholesky factorisation of many sparse matrices of one pattern at once, in plain PyTorch.

    P A Pᵀ = L Lᵀ,  A x = b  by  L y = P b,  Lᵀ (P x) = y

P is the order of elimination of :mod:`sim.linear.nested_dissection`; L is kept as dense pieces,
those of the groups of :mod:`sim.linear.fronts`. Every operation takes the fronts of one group in
all samples together, so that the number of calls depends neither on the batch nor, much, on the
mesh, and nothing waits for the device on the way. A sample's numbers never meet another's: a matrix
that is not positive definite spoils its own sample alone. NVIDIA's cuDSS (through nvmath-python)
factorises uniform batches too, but needs a GPU, and a verdict for each sample is not documented.
"""

import math
from collections.abc import Sequence

import numpy as np
import torch

from common.errors import InputError
from sim.linear.fronts import Flow, Group, plan_fronts
from sim.linear.nested_dissection import dissect
from sim.linear.pattern import SparsePattern

_LEAF = 60  # unknowns in the regions that are not dissected any more
_GROUP_COST = 1e6  # floating point operations of padding that one stack of fronts less is worth


class FrontalSolver:
    """Factorises batches of matrices of one pattern.

    The batch may have another size each time, as when finished samples leave it. All memory is
    kept for the next batch: of a cloth with 29 247 unknowns 64 MB a sample, and 52 MB of index
    lists for all samples.

    Args:
        pattern: of the upper triangles.
        places: (n, 2) where each unknown lies on the flat specimen, m.
        device: of all tensors.

    Attributes:
        fronts: layout and counts.

    Raises:
        InputError: not one finite place per unknown.
    """

    def __init__(
        self, pattern: SparsePattern, places: np.ndarray, *, device: torch.device | str = "cpu"
    ) -> None:
        places = np.asarray(places, dtype=np.float64)
        if places.shape != (pattern.size, 2) or not np.isfinite(places).all():
            raise InputError(f"places must be finite numbers of shape ({pattern.size}, 2), one row "
                             f"for each unknown, not {places.shape}")
        tree = dissect(pattern, places, leaf=_LEAF)
        # As tensors name it: a device "cuda" is not equal to theirs, "cuda:0".
        self._device = torch.empty(0, device=device).device
        self.fronts = plan_fronts(pattern, tree, group_cost=_GROUP_COST, device=self._device)
        self._pattern = pattern
        self._definite = torch.empty(0, dtype=torch.bool, device=self._device)
        self._memory: dict[object, torch.Tensor] = {}
        self._factors: list[tuple[torch.Tensor, torch.Tensor]] = []

    @property
    def nbytes(self) -> int:
        """Memory kept for batches, without the index lists."""
        return sum(buffer.nbytes for buffer in self._memory.values())

    def factorise(self, data: torch.Tensor) -> torch.Tensor:
        """Factor the matrices with the CSR data (B, nnz) of the upper triangle.

        Returns:
            (B,) bool, on the device: whether each matrix is positive definite. One with a NaN or
            an infinite entry is not.

        Raises:
            InputError: another shape, type or device.
        """
        self._check("matrices", data, (len(data), len(self._pattern.indices)))
        self._definite = torch.ones(len(data), dtype=torch.bool, device=self._device)
        panels = self._buffer("panels", (len(data), self.fronts.panel_size)).zero_()
        panels.index_fill_(1, self.fronts.ones, 1.0)
        self._add(panels, data, self.fronts.values)
        self._factors = [self._eliminate(number, group, panels)
                         for number, group in enumerate(self.fronts.groups)]
        return self._definite

    def solve(self, rhs: torch.Tensor) -> torch.Tensor:
        """Solutions (B, n) of A x = ``rhs`` (B, n) with the last factors, NaN without a factor.

        Raises:
            InputError: another shape, type or device than that of the last factors.
        """
        samples = len(self._definite)
        self._check("right-hand sides", rhs, (samples, self._pattern.size))
        # The row n stands for padding: zero on the way in, and it stays so.
        x = torch.cat([rhs, rhs.new_zeros(samples, 1)], dim=1)
        steps = list(zip(self.fronts.groups, self._factors, strict=True))
        for group, (lower, rows) in steps:
            own = group.own.expand(samples, -1)
            y = torch.linalg.solve_triangular(lower, _columns(x, own, group), upper=False)
            x.scatter_(1, own, y.flatten(1))
            self._add(x, (rows @ y).neg_().flatten(1), group.carried)
        for group, (lower, rows) in reversed(steps):
            own, later = group.own.expand(samples, -1), group.later.expand(samples, -1)
            y = _columns(x, own, group) - rows.mT @ _columns(x, later, group)
            x.scatter_(1, own, torch.linalg.solve_triangular(lower.mT, y, upper=True).flatten(1))
        return torch.where(self._definite[:, None], x[:, :-1], torch.nan)

    def _eliminate(
        self, number: int, group: Group, panels: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Pieces of L, (B, c, p, p) and (B, c, u, p) below; the panels of later groups change."""
        corner, below = group.panels(panels)
        lower = self._buffer((number, "lower"), corner.shape).copy_(corner)
        rows = self._buffer((number, "rows"), below.shape)
        # LAPACK's matrices are column-major: to it, this lower triangle is an upper one.
        info = torch.empty(lower.shape[:2], dtype=torch.int32, device=self._device)
        torch.linalg.cholesky_ex(lower.mT, upper=True, out=(lower.mT, info))
        diagonal = lower.diagonal(dim1=-2, dim2=-1)
        sound = (diagonal > 0.0) & (diagonal < torch.inf)  # nor NaN
        self._definite &= (info == 0).all(dim=1) & sound.flatten(1).all(dim=1)
        torch.linalg.solve_triangular(lower, below.mT, upper=False, out=rows.mT)
        flat = rows.flatten(0, 1)
        update = self._buffer("update", (len(flat), group.others, group.others))
        update.baddbmm_(flat, flat.mT, beta=0.0, alpha=-1.0)
        self._add(panels, update.view(len(panels), -1), group.updates)
        return lower, rows

    def _add(self, target: torch.Tensor, source: torch.Tensor, flows: list[Flow]) -> None:
        """Add entries of the source (B, ...) to the target (B, ...)."""
        for flow in flows:
            take, put = (index.expand(len(source), -1) for index in flow)
            part = torch.gather(source, 1, take, out=self._buffer("part", take.shape))
            target.scatter_add_(1, put, part)

    def _buffer(self, name: object, shape: Sequence[int]) -> torch.Tensor:
        """A tensor in memory that is kept: fresh memory costs more than the arithmetic."""
        count = math.prod(shape)
        kept = self._memory.get(name)
        if kept is None or len(kept) < count:
            kept = torch.empty(count, dtype=torch.float64, device=self._device)
            self._memory[name] = kept
        return kept[:count].view(shape)

    def _check(self, name: str, tensor: torch.Tensor, shape: tuple[int, int]) -> None:
        if tensor.shape != shape or tensor.dtype != torch.float64 or tensor.device != self._device:
            raise InputError(f"{name} must be {shape} float64 on {self._device}, not "
                             f"{tuple(tensor.shape)} {tensor.dtype} on {tensor.device}")


def _columns(x: torch.Tensor, index: torch.Tensor, group: Group) -> torch.Tensor:
    """Entries (B, c k) of x (B, n + 1) as a column for each front, (B, c, k, 1)."""
    return x.gather(1, index).view(len(x), group.count, -1, 1)
