"""The total energies of many cloths on meshes of one grid, as functions of shared unknowns."""

import copy
from collections.abc import Sequence

import numpy as np
import torch

from common.errors import InputError
from sim.batched.energies import BatchedEnergy, batch_energies
from sim.batched.energies.edge_frames import BatchedEdgeFrames
from sim.batched.energies.fold_limit import BatchedFoldLimit
from sim.batched.hessians import CachedHessians, Layout
from sim.energies.edge_frames import EdgeFrames
from sim.grid_unknowns import GridUnknowns
from sim.mesh import Mesh
from sim.potential import Terms, framed_energy


class BatchedPotential:
    """Potentials of B cloths over the rows of :class:`sim.grid_unknowns.GridUnknowns`.

    Rows that a sample has no unknown for have no energy and a one on the Hessian's diagonal, so
    that they stay where they are.

    Args:
        samples: the terms of each, their energies in the same order, one of them with frames.
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
        self._unknowns, self._size = unknowns, unknowns.size
        self._layouts: dict[bool, Layout] = {}  # shared with the parts of this one
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
        self._slots = [self._places(energy, self.layout(wide=False)) for energy in self._energies]
        self._frames = BatchedEdgeFrames.stack([_frames(terms) for terms in samples], device)
        self._frame_corners = self._stencil(self._frames.entries)  # (B, 12, M)
        self._frame_rotations = self._stencil(self._frames.rotations)  # (B, M)

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

    def hessians(self, y: torch.Tensor) -> CachedHessians:
        """The Hessians at ``y`` (B, n), not assembled yet."""
        return CachedHessians(self, self.full(y))

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
        part._slots = [None if slots is None else slots[index] for slots in self._slots]
        part._frames = self._frames.take(index)
        for name in ("_rows", "_template", "_force_scale", "_length_scale", "_absent",
                     "regularisation", "_frame_corners", "_frame_rotations"):
            setattr(part, name, getattr(self, name)[index])
        return part

    @property
    def stages(self) -> int:
        """Groups of energies that are made convex one after the other."""
        return int(self._stage[-1]) + 1

    def is_felt(self, q: torch.Tensor) -> torch.Tensor:
        """(B,) whether an energy that couples more than the others, felt seldom, is felt now."""
        return torch.stack([energy.is_felt(q) for energy in self._energies
                            if isinstance(energy, BatchedFoldLimit)]).any(dim=0)

    def layout(self, *, wide: bool) -> Layout:
        """The pattern with, or without, places for all energies."""
        if wide not in self._layouts:
            pattern = self._unknowns.wide_pattern if wide else self._unknowns.pattern
            self._layouts[wide] = Layout.of(pattern, self._rows.device, wide=wide)
        return self._layouts[wide]

    def assemble(
        self, q: torch.Tensor, stage: int, convexity: float, layout: Layout
    ) -> torch.Tensor:
        """CSR data (B, nnz) of one stage, exact (0) or convex (1), at all unknowns (B, Q)."""
        entries = len(layout.pattern.indices)
        total = q.new_zeros(len(q), entries + 1)  # the last one for what is held
        for energy, slots, own in zip(self._energies, self._slots, self._stage, strict=True):
            blocks = energy.hessian(q, convexity) if own == stage else None
            if blocks is not None:
                if layout.wide:
                    slots = self._places(energy, layout)
                if slots is None:  # felt by rounding alone
                    continue
                count = blocks.shape[-1]
                upper = torch.triu_indices(count, count, device=q.device)
                values = blocks.permute(0, 2, 3, 1)[:, upper[0], upper[1]]  # (B, P, N)
                total.scatter_add_(1, slots.flatten(1), values.flatten(1))
        return total[:, :entries]

    def complete(
        self, data: torch.Tensor, index: torch.Tensor, shift: torch.Tensor, layout: Layout
    ) -> None:
        """Add to the diagonals of ``data`` (b, nnz) the shifts (b,) and the ones of absent rows."""
        more = self._absent[index] + shift[:, None] * self.regularisation[index]
        data.index_add_(1, layout.diagonal, more)

    def into_frames(self, q: torch.Tensor, gradient: torch.Tensor) -> torch.Tensor:
        """See :meth:`sim.potential.Potential.into_frames`; at all unknowns (B, Q)."""
        padded = torch.nn.functional.pad(gradient, (0, 1))  # what is held has no force
        torque = padded.gather(1, self._frame_rotations)
        more = self._frames.levers(q) * torque[:, None]
        return padded.scatter_add(1, self._frame_corners.flatten(1), more.flatten(1))[:, :-1]

    def out_of_frames(self, q: torch.Tensor, move: torch.Tensor) -> torch.Tensor:
        """See :meth:`sim.potential.Potential.out_of_frames`; at all unknowns (B, Q)."""
        padded = torch.nn.functional.pad(move, (0, 1))  # what is held stays
        corners = padded.gather(1, self._frame_corners.flatten(1)).view(self._frame_corners.shape)
        turn = (self._frames.levers(q) * corners).sum(1)
        return padded.scatter_add(1, self._frame_rotations, turn)[:, :-1]

    def _spread(self, unknowns: Sequence[np.ndarray]) -> torch.Tensor:
        """Rows (B, n) of all unknowns (Q,) of each sample, infinite for those it has not."""
        source = _stacked(unknowns, self._rows.device)
        rows = source.new_full((len(source), self._size + 1), torch.inf)
        target = torch.where(self._rows >= 0, self._rows, self._size)
        return rows.scatter_(1, target, source)[:, : self._size]

    def _stencil(self, dofs: torch.Tensor) -> torch.Tensor:
        """Rows of unknowns ``dofs`` (B, ...), n for absent and held ones."""
        rows = self._rows.gather(1, dofs.clamp(min=0).flatten(1)).view(dofs.shape)
        return torch.where((dofs >= 0) & (rows >= 0), rows, self._size)

    def _places(self, energy: BatchedEnergy, layout: Layout) -> torch.Tensor | None:
        """(B, K(K+1)/2, N) where blocks' upper triangles go in the CSR data, nnz: nowhere.

        None for an energy that has no place in the pattern.
        """
        if isinstance(energy, BatchedFoldLimit) and not layout.wide:
            return None
        stencil = self._stencil(energy.coupled.mT)
        count, entries = stencil.shape[1], len(layout.keys)
        a, b = torch.triu_indices(count, count, device=stencil.device)
        found = []
        for sample in stencil:  # one by one, for the memory
            low = torch.minimum(sample[a], sample[b])
            high = torch.maximum(sample[a], sample[b])
            key = low * self._size + high
            slots = torch.searchsorted(layout.keys, key).clamp(max=entries - 1)
            absent = high == self._size
            _require_places((layout.keys[slots] == key) | absent)
            found.append(torch.where(absent, entries, slots))
        return torch.stack(found)


def _require_places(found: torch.Tensor) -> None:
    if not found.all():
        raise InputError("an energy reaches further than the grid's pattern")


def _frames(terms: Terms) -> EdgeFrames:
    """The frames of one sample; the batched energies know no Hessians without."""
    energies = [energy for stage in terms.stages for energy in stage]
    energy = framed_energy(energies, terms.free)
    if energy is None:
        raise InputError("these laws cannot be evaluated in a batch: they need the Hessian by the "
                         "edges' rotations; make such drapes one by one (together=False)")
    return energy.frames


def _stacked(arrays: Sequence[np.ndarray], device: torch.device | str) -> torch.Tensor:
    return torch.from_numpy(np.stack(arrays)).to(device)
