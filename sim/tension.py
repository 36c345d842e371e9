"""Strips of cloth pulled between two clamps, in their plane."""

from dataclasses import dataclass

import numpy as np

from common.errors import InputError
from common.types import Metres, Radians
from sim.energies.membrane import Membrane
from sim.mesh import Mesh, strip
from sim.scene import Scene
from sim.solver.newton import NewtonOptions, Status, minimise
from sim.solver.potential import Potential, forces

POISSON = 0.3
"""Assumed where it is not known."""
TIGHT = NewtonOptions(residual=1e-7, step=1e-7)


@dataclass(frozen=True)
class PulledStrip:
    """A strip in equilibrium between its clamps.

    Attributes:
        load: N/m, force over the width of the cut strip.
        places: (N,) m, of the points of its middle line at rest, from one clamp's edge to the
            other's.
        moved: (N,) m, how far each has moved along the strip.
    """

    load: float
    places: np.ndarray
    moved: np.ndarray

    def extension(self, margin: Metres = 0.0) -> float:
        """Relative extension between two marks that lie ``margin`` inside the clamps."""
        first, last = margin, self.places[-1] - margin
        low, high = np.interp([first, last], self.places, self.moved)
        return float((high - low) / (last - first))


def pull(
    membrane: Membrane, *, angle: Radians, length: Metres, width: Metres, extension: float,
    cells: int = 12,
) -> PulledStrip:
    """Pull a strip, cut at an ``angle`` from the warp, by the share ``extension`` of its ``length``
    between the clamps, which let no point of the cloth move sideways.

    The cloth stays plane: folds of slack cloth are not simulated. InputError if it does not come to
    rest.

    Args:
        cells: of the mesh, across the strip; an even number.
    """
    edge = length / max(round(length * cells / width), 4)
    cut, held = strip(length=length, width=cells * edge, edge=edge, clamp=edge)
    x, y = (cut.rest * [1.0, width / (cells * edge)]).T
    held |= x >= length - edge / 2
    cos, sin = np.cos(angle), np.sin(angle)
    mesh = Mesh(np.column_stack([cos * x - sin * y, sin * x + cos * y]), cut.faces)
    scene = Scene(mesh=mesh, held=held)
    start = scene.state(np.column_stack([(1 + extension) * x.clip(0.0), y, np.zeros(len(x))]))
    energy = membrane.energy(mesh, np.ones(len(mesh.faces), dtype=bool))
    free = np.zeros(3 * len(x) + len(mesh.edges), dtype=bool)
    free[: 3 * len(x)] = (~held[:, None] & [True, True, False]).ravel()
    scale = sum(np.abs(forces([energy], start.q, len(free)))) / len(x)
    potential = Potential([[energy]], mesh.edges, free, force_scale=np.full(len(free), scale),
                          length_scale=np.full(len(free), extension * edge),
                          energy_scale=energy.value(start.q))
    found = minimise(potential, start.q, TIGHT)
    if found.status is not Status.CONVERGED:
        raise InputError(f"the simulated strip does not come to rest: {found.message}")
    moved = found.q[: 3 * len(x)].reshape(-1, 3)[:, 0] - x
    end = x >= length - edge / 2
    force = forces([energy], found.q, len(free))[: 3 * len(x)].reshape(-1, 3)[end, 0].sum()
    rows = slice((cells + 1) + cells // 2, None, cells + 1)  # from the clamp's edge
    return PulledStrip(float(force / width), x[rows], moved[rows])
