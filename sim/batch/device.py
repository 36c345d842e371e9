"""Energies, gradients, Hessians and factors of many cloths on one topology, on one device."""

from collections.abc import Sequence
from functools import partial

import numpy as np
import torch
from torch import Tensor

from sim import reference
from sim.batch.hessians import derivatives, triangle_blocks
from sim.cloth import Cloth
from sim.linear.multifrontal import FrontalSolver

_PORTION = {"cpu": 2, "cuda": 16}  # samples whose element blocks are in memory together


class DeviceCloths:
    """The cloths of one topology that are minimised together.

    Args:
        cloths: held and free alike, on meshes of the same faces; of the default laws.
        device: of all tensors.
    """

    def __init__(self, cloths: Sequence[Cloth], device: torch.device) -> None:
        self._cloths, self.device = cloths, device
        first = cloths[0]
        mesh, potential = first.scene.mesh, first.potential
        self._all = reference.cloths_of(cloths, device)
        self._vertices, self._edges = len(mesh.rest), len(mesh.edges)
        self.pattern = potential.pattern
        row = potential.all_unknowns(np.arange(1, potential.size + 1)).astype(np.int64) - 1
        self._free = self._on(np.flatnonzero(row >= 0))
        corner = 3 * mesh.faces[first.scene.active][:, :, None] + np.arange(3)
        turns = 3 * self._vertices + mesh.face_edges[first.scene.active]
        places = {
            "triangles": np.concatenate([corner.reshape(-1, 9), turns], axis=1),
            "vertices": 3 * np.arange(self._vertices)[:, None] + np.arange(3),
            "edges": (3 * mesh.edges[:, :, None] + np.arange(3)).reshape(-1, 6),
        }
        # Points of no free vertex have no place in the pattern.
        self._slots = {name: self._on(self.pattern.slots(row[dofs]).astype(np.int64))
                       for name, dofs in places.items()}
        place = np.concatenate([np.repeat(mesh.rest, 3, axis=0),
                                mesh.rest[mesh.edges].mean(axis=1)])
        self._solver = FrontalSolver(self.pattern, place[row >= 0], device=device)

    def values(self, asked: Sequence[tuple[int, np.ndarray]]) -> list[float]:
        """Energies, J, of cloths (by number) at states (3 V + 3 E,)."""
        cloths, x, n = self._at(asked)
        with torch.no_grad():
            return reference.energy(cloths, x, n).tolist()

    def gradients(self, asked: Sequence[tuple[int, np.ndarray]]) -> list[np.ndarray]:
        """Derivatives (n,) by steps from states."""
        cloths, x, n = self._at(asked)
        move = torch.zeros_like(x, requires_grad=True)
        turn = x.new_zeros(len(x), self._edges, requires_grad=True)
        there = reference.moved(cloths.topology, x, n, move, turn)
        total = reference.energy(cloths, x + move, there).sum()
        by_move, by_turn = torch.autograd.grad(total, (move, turn))
        both = torch.cat([by_move.flatten(1), by_turn], dim=1)
        return list(both[:, self._free].cpu().numpy())

    def factorise(
        self, asked: Sequence[tuple[int, np.ndarray, float]]
    ) -> list[bool]:
        """Whether Hessians are positive definite; their factors are kept until the next call.

        Args:
            asked: numbers, states, and shares from 0 to 1 in which the membrane is convex.
        """
        some = _PORTION[self.device.type]
        data = torch.cat([self._hessians(asked[k : k + some])
                          for k in range(0, len(asked), some)])
        self._factored = [number for number, *_ in asked]
        return self._solver.factorise(data).tolist()

    def solve(self, asked: Sequence[tuple[int, np.ndarray]]) -> list[np.ndarray]:
        """Solutions (n,) for right-hand sides (n,) with the last factors."""
        rhs = np.zeros((len(self._factored), self.pattern.size))
        at = [self._factored.index(number) for number, _ in asked]
        rhs[at] = [force for _, force in asked]
        found = self._solver.solve(torch.from_numpy(rhs).to(self.device)).cpu().numpy()
        return list(found[at])

    def _hessians(self, asked: Sequence[tuple[int, np.ndarray, float]]) -> Tensor:
        """CSR data (B, nnz)."""
        cloths, x, n = self._at([(number, q) for number, q, _ in asked])
        share = torch.tensor([convex for *_, convex in asked], dtype=x.dtype).to(self.device)
        # One more entry for what has no place.
        data = x.new_zeros(len(x), len(self.pattern.indices) + 1)
        self._add(data, "triangles", triangle_blocks(cloths, x, n, share))
        for name, points, scale, corners in reference.touched(cloths, x):
            _, blocks = derivatives(partial(reference.pressed, cloths, scale=scale), points)
            self._add(data, name, blocks.repeat(1, 1, corners, corners) / corners**2)
        return data[:, :-1]

    def _add(self, data: Tensor, name: str, blocks: Tensor) -> None:
        """Add blocks (B, N, K, K) to CSR data."""
        slots = self._slots[name]
        a, b = torch.triu_indices(blocks.shape[-1], blocks.shape[-1], device=self.device)
        upper = blocks[..., a, b]
        place = torch.where(slots >= 0, slots, data.shape[1] - 1).flatten()
        data.index_add_(1, place, upper.flatten(1))

    def _at(
        self, asked: Sequence[tuple[int, np.ndarray]]
    ) -> tuple[reference.Cloths, Tensor, Tensor]:
        """The cloths that are asked for, positions (B, V, 3) and normals (B, E, 3)."""
        numbers = self._on(np.array([number for number, _ in asked]))
        q = torch.from_numpy(np.stack([q for _, q in asked])).to(self.device)
        x, n = q.view(len(q), -1, 3).split([self._vertices, self._edges], dim=1)
        return self._all.take(numbers), x, n

    def _on(self, array: np.ndarray) -> Tensor:
        return torch.from_numpy(array).to(self.device)
