"""Bending by mid-edge rotations, over batches."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from sim.batched.energies import dihedral, plate_law
from sim.batched.energies.base import ElementBatch, dyads, stack_elements
from sim.energies.midedge import CONVEX_FLOOR, MidEdgeBending

_HINGES = ((1, 2, 0, 3), (2, 0, 1, 4), (0, 1, 2, 5))
"""Corners of the hinge on each edge of a triangle among its own and those across its edges."""
_OWN = tuple((h[2], h[1], h[0]) for h in _HINGES)
"""The triangle itself: opposite corner, end and start of the edge."""
_MOST = 16384  # matrices: cuSOLVER's batched eigenvalues refuse much more than 32 000


@dataclass(frozen=True)
class BatchedMidEdge(ElementBatch):
    """Batched :class:`sim.energies.midedge.MidEdgeBending`.

    Attributes:
        share, sign: (B, 3, N) so that phi = share theta + sign zeta on each edge.
        maps: (B, 3, 3, N) 1/m, curvature by angle phi.
        areas: (B, N) m².
        law: (B, 15, 1) constants of the plate law.
    """

    share: Tensor
    sign: Tensor
    maps: Tensor
    areas: Tensor
    law: Tensor

    @classmethod
    def stack(
        cls, energies: Sequence[MidEdgeBending], device: torch.device | str = "cpu"
    ) -> "BatchedMidEdge":
        places = []
        for energy in energies:
            # Beyond a free edge stands the triangle itself, folded over: a sound hinge, whose
            # angle has no share.
            dofs = energy.dofs.copy()
            absent = dofs < 0
            dofs[:, 9:18][absent[:, 9:18]] = dofs[:, :9][absent[:, 9:18]]
            dofs[:, 18:][absent[:, 18:]] = 0
            places.append(dofs)
        return cls(
            entries=stack_elements([energy.dofs for energy in energies], device, fill=-1),
            places=stack_elements(places, device),
            share=stack_elements([energy.share for energy in energies], device, fill=0.0),
            sign=stack_elements([energy.sign for energy in energies], device, fill=0.0),
            maps=stack_elements([energy.maps for energy in energies], device, fill=0.0),
            areas=stack_elements([energy.areas for energy in energies], device, fill=0.0),
            law=stack_elements([energy.law[None] for energy in energies], device),
        )

    def value(self, q: Tensor) -> Tensor:
        hinges, rotations = self._hinges(q)
        return (self.areas * plate_law.energy(self._curvatures(hinges, rotations), self.law)).sum(1)

    def gradient(self, q: Tensor) -> Tensor:
        hinges, rotations = self._hinges(q)
        stress, _ = plate_law.derivatives(self._curvatures(hinges, rotations), self.law)
        moment = self._moments(stress)
        torque = (moment * self.share)[:, :, None, None]
        start, end, own, far = (torque * dihedral.gradient(dihedral.frames(hinges))).unbind(2)
        own = own + start.roll(1, 1) + end.roll(2, 1)  # edge i runs from corner i+1 to i+2
        parts = [own.flatten(1, 2), far.flatten(1, 2), self.sign * moment]
        return torch.cat(parts, dim=1).mT

    @property
    def coupled(self) -> Tensor:
        return torch.cat([self.entries[:, :9], self.entries[:, 18:]], dim=1).mT

    def hessian(self, q: Tensor, convexity: float) -> Tensor:
        # d²E = K_ij dphi_i dphi_j + m_i d²phi_i: a tangent part, convex when the law is, and the
        # turning of the hinges under their torque, indefinite and dropped in full convexity.
        hinges, rotations = self._hinges(q)
        stress, tangent = plate_law.derivatives(self._curvatures(hinges, rotations), self.law)
        if convexity == 1.0:
            self._convexify(tangent)
        # K = area mapsᵀ tangent maps; the tangent is symmetric.
        stiffness = dyads(self.maps, dyads(tangent, self.areas[:, None, None] * self.maps))
        frames = dihedral.frames(hinges[:, :, :3])
        rows = self._angle_rows(frames)
        block = dyads(rows, dyads(stiffness, rows))
        if convexity == 0.0:
            factors = dihedral.second_factors(frames, self._torques(stress, q.shape[1]))
            groups = block.unflatten(2, (4, 3)).unflatten(1, (4, 3))
            for i, corners in enumerate(_OWN):
                dihedral.add_dyads(groups, frames.normal[:, i, 0], factors[:, i, 0], corners)
        return block.permute(0, 3, 1, 2)

    def _hinges(self, q: Tensor) -> tuple[Tensor, Tensor]:
        """Corners (B, 3, 4, 3, N) of the hinges on the three edges, and rotations (B, 3, N)."""
        unknowns = self.unknowns(q)
        corners = unknowns[:, :18].unflatten(1, (6, 3))
        hinges = [torch.stack([corners[:, c] for c in hinge], dim=1) for hinge in _HINGES]
        return torch.stack(hinges, dim=1), unknowns[:, 18:]

    def _curvatures(self, hinges: Tensor, rotations: Tensor) -> Tensor:
        """(B, 3, N) shape operators (Sxx, Syy, Sxy), 1/m."""
        phi = self.share * dihedral.angles(hinges) + self.sign * rotations
        return (self.maps * phi[:, None]).sum(2)

    def _moments(self, stress: Tensor) -> Tensor:
        """(B, 3, N) derivatives of the energy by the angles phi, J/rad."""
        return self.areas[:, None] * (self.maps * stress[:, :, None]).sum(1)

    def _torques(self, stress: Tensor, unknowns: int) -> Tensor:
        """(B, 3, N) derivatives of the energy by the edges' dihedral angles, J/rad.

        Both triangles' together. ``unknowns``: Q.
        """
        own = self._moments(stress) * self.share
        rotation = self.entries[:, 18:]
        place = torch.where(rotation >= 0, rotation, unknowns).flatten(1)
        total = own.new_zeros(len(own), unknowns + 1).scatter_add_(1, place, own.flatten(1))
        return torch.where(rotation >= 0, total.gather(1, place).view(own.shape), own)

    def _angle_rows(self, frames: dihedral.Frames) -> Tensor:
        """(B, 3, 12, N) derivatives of phi by moves in the frames of the edges."""
        gradient = (self.share != 0)[:, :, None, None] * dihedral.gradient(frames)
        rows = gradient.new_zeros(*self.share.shape[:2], 4, *gradient.shape[-2:])
        for i, hinge in enumerate(_HINGES):
            for c, corner in enumerate(hinge[:3]):
                rows[:, i, corner] = gradient[:, i, c]
            rows[:, i, 3, i] = self.sign[:, i]
        return rows.flatten(2, 3)

    def _convexify(self, tangent: Tensor) -> None:
        """Raise the eigenvalues of tangents (B, 3, 3, N) below the floor to it, in place.

        The floor is positive: the rotations of the edges have no other stiffness.
        """
        law = self.law
        floor = CONVEX_FLOOR * torch.stack([law[:, 0], law[:, 1], 4.0 * law[:, 3]]).amin(0)
        # Pivots of what lies above the floor: most matrices need no eigenvectors.
        first = tangent[:, 0, 0] - floor
        second = (tangent[:, 1, 1] - floor) * first - tangent[:, 0, 1] ** 2
        cross = tangent[:, 1, 2] * first - tangent[:, 0, 1] * tangent[:, 0, 2]
        third = ((tangent[:, 2, 2] - floor) * first - tangent[:, 0, 2] ** 2) * second - cross**2
        above = (first > 0) & (second > 0) & (third > 0)
        # What is not finite spoils its own sample; eigenvalues of it would stop all.
        sample, element = (~above & tangent.isfinite().all(1).all(1)).nonzero(as_tuple=True)
        matrices = tangent.permute(0, 3, 1, 2)
        for some in torch.arange(len(sample), device=sample.device).split(_MOST):
            place = sample[some], element[some]
            values, vectors = torch.linalg.eigh(matrices[place])
            lift = (floor[sample[some]] - values).clamp(min=0.0)
            matrices[place] += (vectors * lift[:, None]) @ vectors.mT
