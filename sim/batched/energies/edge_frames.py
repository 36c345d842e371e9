"""The frames of edges in which triangles couple with themselves alone, over batches."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from sim.batched.energies import dihedral
from sim.batched.energies.base import ElementBatch, stack_elements
from sim.energies.edge_frames import EdgeFrames


@dataclass(frozen=True)
class BatchedEdgeFrames(ElementBatch):
    """Batched :class:`sim.energies.edge_frames.EdgeFrames`; an element is an edge.

    Attributes:
        rotations: (B, N) int64, the edges' rotations among a sample's unknowns, -1: none.
    """

    rotations: Tensor

    @classmethod
    def stack(
        cls, samples: Sequence[EdgeFrames], device: torch.device | str = "cpu"
    ) -> "BatchedEdgeFrames":
        dofs = [frames.dofs for frames in samples]
        return cls(
            entries=stack_elements(dofs, device, fill=-1),
            places=stack_elements(dofs, device),
            rotations=stack_elements([frames.rotations for frames in samples], device, fill=-1),
        )

    def levers(self, q: Tensor) -> Tensor:
        """(B, 12, N) derivatives of zeta by the coordinates where xi is kept, 1/m."""
        frames = dihedral.frames(self.corners(q))
        return 0.5 * dihedral.gradient(frames, second=-1.0).flatten(1, 2)
