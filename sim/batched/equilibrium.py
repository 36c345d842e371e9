"""Equilibria of many cloths on meshes of one grid."""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch

from sim.batched.newton import minimise_batch
from sim.batched.objective import BatchedSolver
from sim.batched.potential import BatchedPotential
from sim.batched.solvers import FrontalSolver
from sim.equilibrium import cloth_terms
from sim.grid_unknowns import GridUnknowns
from sim.laws import Laws
from sim.linear import SparsePattern
from sim.linear.multifrontal import Analysis, analyse
from sim.material import Fabric
from sim.newton import NewtonOptions, NewtonResult
from sim.scene import Scene, State

_KEPT = 6
"""Grids: some 10 MB each for 41 vertices a side, 110 MB for 101; five times that where a cloth has
felt the limit of folds."""


@dataclass(frozen=True)
class Analysed:
    """What all drapes on a grid share.

    Attributes:
        unknowns: numbering and patterns.
        device: of the minimisation.
    """

    unknowns: GridUnknowns
    device: torch.device
    _analyses: dict[SparsePattern, Analysis] = field(default_factory=dict, repr=False)

    def analysis(self, pattern: SparsePattern) -> Analysis:
        """Of the batched linear solver for a pattern of ``unknowns``, on the device; kept."""
        if pattern not in self._analyses:
            self._analyses[pattern] = analyse(pattern, self.unknowns.places, device=self.device)
        return self._analyses[pattern]


def analyse_grid(free: np.ndarray, device: torch.device | str = "cpu") -> Analysed:
    """Prepare for cloths on a grid; the last few grids are remembered.

    Args:
        free: (nx, ny) bool, vertices that may be free in some sample. Fewer make the solver
            faster; which ones there are changes drapes by rounding only.
        device: of the minimisation.
    """
    return _analyse(free.shape, free.tobytes(), str(device))


@functools.lru_cache(maxsize=_KEPT)
def _analyse(shape: tuple[int, int], free: bytes, device: str) -> Analysed:
    unknowns = GridUnknowns(shape, np.frombuffer(free, dtype=bool).reshape(shape))
    analysed = Analysed(unknowns, torch.device(device))
    analysed.analysis(unknowns.pattern)  # the one that is always needed
    return analysed


def find_equilibria(
    scenes: Sequence[Scene],
    fabrics: Sequence[Fabric],
    starts: Sequence[State],
    analysed: Analysed,
    *,
    laws: Laws | None = None,
    options: NewtonOptions | None = None,
    make_solver: Callable[[SparsePattern], BatchedSolver] | None = None,
) -> tuple[list[State], list[NewtonResult]]:
    """For each sample what :func:`sim.equilibrium.find_equilibrium` finds.

    Args:
        scenes, fabrics, starts: of the samples, their meshes triangulations of one grid.
        analysed: of that grid; all vertices that a scene does not hold are among its free ones.
        laws: of all samples; only those whose energies have batched twins.
        options: of every minimisation.
        make_solver: makes the solver of the Newton systems of one pattern; None: the batched one.

    Raises:
        InputError: laws, meshes or held vertices that do not fit.
    """
    terms = [
        cloth_terms(scene, fabric, start, laws=laws)
        for scene, fabric, start in zip(scenes, fabrics, starts, strict=True)
    ]
    device = analysed.device
    meshes = [scene.mesh for scene in scenes]
    potential = BatchedPotential(terms, meshes, analysed.unknowns, device)
    results = minimise_batch(
        potential,
        potential.start([sample.template for sample in terms]),
        options,
        make_solver=make_solver or (lambda pattern: FrontalSolver(analysed.analysis(pattern))),
    )
    y = torch.from_numpy(np.stack([result.y for result in results])).to(device)
    unknowns = potential.full(y).cpu().numpy()
    states = []
    for q, mesh in zip(unknowns, meshes, strict=True):
        coordinates = 3 * len(mesh.rest)
        states.append(State(q[:coordinates].reshape(-1, 3), q[coordinates:]))
    return states, results
