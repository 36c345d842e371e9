"""The total energies of many cloths on meshes of one grid, as functions of shared unknowns."""

import copy
from collections.abc import Sequence

import numpy as np
import torch

from sim.batched.energies import batch_energies
from sim.batched.objective import on_device, part_of
from sim.errors import InputError
from sim.grid_unknowns import GridUnknowns
from sim.mesh import Mesh
from sim.potential import Terms, stage_shares

_AT_A_TIME = {"cpu": 2, "cuda": 64}  # samples whose element blocks are in memory


class BatchedPotential:
    """Potentials of B cloths over the rows of :class:`sim.grid_unknowns.GridUnknowns`.

    Rows that a sample has no unknown for have no energy and a one on the Hessian's diagonal, so
    that they stay where they are.

    Args:
        samples: the terms of each, their energies in the same order.
        meshes: of the samples, triangulations of the grid.
        unknowns: the shared numbering; some sample may lack any row, none may need another.
        device: of all tensors.

    Raises:
        InputError: terms or meshes that do not fit.
    """

    def __init__(
        self,
        samples: Sequence[Terms],
        meshes: Sequence[Mesh],
        unknowns: GridUnknowns,
        device: torch.device | str = "cpu",
    ) -> None:
        stages = samples[0].stages
        self._stage = np.repeat(np.arange(len(stages)), [len(stage) for stage in stages])
        self._energies = batch_energies(
            [[energy for stage in terms.stages for energy in stage] for terms in samples], device
        )
        pattern = unknowns.pattern
        self._size, self._entries = unknowns.size, len(pattern.indices)
        self._diagonal = torch.from_numpy(pattern.diagonal.astype(np.int64)).to(device)
        row = np.stack([
            unknowns.rows(mesh, terms.free) for terms, mesh in zip(samples, meshes, strict=True)
        ])
        self._rows = torch.from_numpy(row).to(device)  # (B, Q)
        self._template = _stacked([terms.template for terms in samples], device)
        self._force_scale = self._spread([terms.force_scale for terms in samples])
        self._length_scale = self._spread([terms.length_scale for terms in samples])
        self._absent = self._length_scale.isinf().double()
        self.regularisation = torch.where(
            self._absent > 0, 0.0, self._force_scale / self._length_scale
        )
        self._stencils = [self._stencil(energy.dofs.mT) for energy in self._energies]
        keys = _keys(pattern.indptr, pattern.indices).to(device)
        self._slots = [self._find_slots(stencil, keys) for stencil in self._stencils]

    def start(self, q: Sequence[np.ndarray]) -> torch.Tensor:
        """Rows (B, n) of all unknowns (Q,) of each sample, zero for those it has not."""
        rows = self._spread(q)
        return torch.where(self._absent > 0, 0.0, rows)

    def full(self, y: torch.Tensor) -> torch.Tensor:
        """All unknowns (B, Q) of the samples' meshes from the rows (B, n)."""
        return torch.where(self._rows >= 0, y.gather(1, self._rows.clamp(min=0)), self._template)

    def value(self, y: torch.Tensor) -> torch.Tensor:
        """(B,) energies, J."""
        q = self.full(y)
        return sum(energy.value(q) for energy in self._energies)

    def gradient(self, y: torch.Tensor) -> torch.Tensor:
        """(B, n) derivatives of the energies."""
        q = self.full(y)
        total = y.new_zeros(len(y), self._size + 1)  # the last column for what is held
        for energy, stencil in zip(self._energies, self._stencils, strict=True):
            parts = energy.gradient(q).mT.flatten(1)
            total.scatter_add_(1, stencil.flatten(1), parts)
        return total[:, : self._size]

    def hessians(self, y: torch.Tensor) -> "CachedHessians":
        """The Hessians at ``y`` (B, n), not assembled yet."""
        return CachedHessians(self, y)

    def allows(self, old: torch.Tensor, new: torch.Tensor) -> torch.Tensor:
        """(B,) whether every energy allows the step between points (B, n)."""
        old, new = self.full(old), self.full(new)
        return torch.stack([energy.allows(old, new) for energy in self._energies]).all(dim=0)

    def residual(self, gradient: torch.Tensor) -> torch.Tensor:
        """(B,) largest entries of gradients (B, n) in units of the force scales."""
        return (gradient / self._force_scale).abs().amax(dim=1)

    def step_length(self, step: torch.Tensor) -> torch.Tensor:
        """(B,) largest entries of steps (B, n) in units of the length scales."""
        return (step / self._length_scale).abs().amax(dim=1)

    def take(self, index: torch.Tensor) -> "BatchedPotential":
        """The potentials of the samples ``index`` (b,) int64 alone."""
        part = copy.copy(self)
        part._energies = [energy.take(index) for energy in self._energies]
        part._stencils = [stencil[index] for stencil in self._stencils]
        part._slots = [slots[index] for slots in self._slots]
        for name in ("_rows", "_template", "_force_scale", "_length_scale", "_absent",
                     "regularisation"):
            setattr(part, name, getattr(self, name)[index])
        return part

    @property
    def stages(self) -> int:
        """Groups of energies that are made convex one after the other."""
        return int(self._stage[-1]) + 1

    def assemble(self, q: torch.Tensor, stage: int, convexity: float) -> torch.Tensor:
        """CSR data (B, nnz) of one stage, exact (0) or convex (1), at all unknowns (B, Q)."""
        total = q.new_zeros(len(q), self._entries + 1)  # the last one for what is held
        for energy, slots, own in zip(self._energies, self._slots, self._stage, strict=True):
            blocks = energy.hessian(q, convexity) if own == stage else None
            if blocks is not None:
                count = blocks.shape[-1]
                upper = torch.triu_indices(count, count, device=q.device)
                entries = blocks.permute(0, 2, 3, 1)[:, upper[0], upper[1]]  # (B, P, N)
                total.scatter_add_(1, slots.flatten(1), entries.flatten(1))
        return total[:, : self._entries]

    def complete(self, data: torch.Tensor, index: torch.Tensor, shift: torch.Tensor) -> None:
        """Add to the diagonals of ``data`` (b, nnz) the shifts (b,) and the ones of absent rows."""
        more = self._absent[index] + shift[:, None] * self.regularisation[index]
        data.index_add_(1, self._diagonal, more)

    def _spread(self, unknowns: Sequence[np.ndarray]) -> torch.Tensor:
        """Rows (B, n) of all unknowns (Q,) of each sample, infinite for those it has not."""
        source = _stacked(unknowns, self._rows.device)
        rows = source.new_full((len(source), self._size + 1), torch.inf)
        target = torch.where(self._rows >= 0, self._rows, self._size)
        return rows.scatter_(1, target, source)[:, : self._size]

    def _stencil(self, dofs: torch.Tensor) -> torch.Tensor:
        """(B, K, N) rows of elements' unknowns ``dofs`` (B, K, N), n for absent and held ones."""
        rows = self._rows.gather(1, dofs.clamp(min=0).flatten(1)).view(dofs.shape)
        return torch.where((dofs >= 0) & (rows >= 0), rows, self._size)

    def _find_slots(self, stencil: torch.Tensor, keys: torch.Tensor) -> torch.Tensor:
        """(B, K(K+1)/2, N) where blocks' upper triangles go in the CSR data, nnz: nowhere."""
        count = stencil.shape[1]
        a, b = torch.triu_indices(count, count, device=stencil.device)
        found = []
        for sample in stencil:  # one by one, for the memory
            low = torch.minimum(sample[a], sample[b])
            high = torch.maximum(sample[a], sample[b])
            key = low * self._size + high
            slots = torch.searchsorted(keys, key).clamp(max=self._entries - 1)
            absent = high == self._size
            if not ((keys[slots] == key) | absent).all():
                raise InputError("an energy reaches further than the grid's pattern")
            found.append(torch.where(absent, self._entries, slots))
        return torch.stack(found)


class CachedHessians:
    """Hessians of a batch at one point; what has been assembled is kept for other convexities."""

    def __init__(self, potential: BatchedPotential, y: torch.Tensor) -> None:
        self._potential, self._q = potential, potential.full(y)
        self._data: dict[tuple[int, float], torch.Tensor] = {}
        self._known: dict[tuple[int, float], np.ndarray] = {}

    def data(self, index: np.ndarray, convexity: np.ndarray, shift: np.ndarray) -> torch.Tensor:
        """See :meth:`sim.batched.objective.Hessians.data`."""
        shares = np.array([stage_shares(c, self._potential.stages) for c in convexity])
        at = on_device(index, self._q)
        total = None
        for stage in range(self._potential.stages):
            for end, weight in ((0.0, 1.0 - shares[:, stage]), (1.0, shares[:, stage])):
                needed = weight > 0.0
                if not needed.any():
                    continue
                part = self._end(stage, end, index[needed])[at]
                if not (weight == 1.0).all():
                    part *= on_device(weight, part)[:, None]
                total = part if total is None else total.add_(part)
        self._potential.complete(total, at, on_device(shift, total))
        return total

    def _end(self, stage: int, convexity: float, index: np.ndarray) -> torch.Tensor:
        """(B, nnz) one stage, exact (0) or convex (1), assembled for the samples ``index``."""
        key = stage, convexity
        if key not in self._data:
            self._data[key] = self._q.new_zeros(len(self._q), self._potential._entries)
            self._known[key] = np.zeros(len(self._q), dtype=bool)
        missing = index[~self._known[key][index]]
        many = _AT_A_TIME[self._q.device.type]
        for first in range(0, len(missing), many):
            index = missing[first : first + many]
            some, part = on_device(index, self._q), part_of(self._potential, index, self._q)
            self._data[key][some] = part.assemble(self._q[some], stage, convexity)
        self._known[key][missing] = True
        return self._data[key]


def _keys(indptr: np.ndarray, indices: np.ndarray) -> torch.Tensor:
    """(nnz,) ascending numbers of the pattern's entries: row times size, plus column."""
    size = len(indptr) - 1
    rows = np.repeat(np.arange(size), np.diff(indptr))
    return torch.from_numpy(rows * size + indices)


def _stacked(arrays: Sequence[np.ndarray], device: torch.device | str) -> torch.Tensor:
    return torch.from_numpy(np.stack(arrays)).to(device)
