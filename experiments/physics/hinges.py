"""Ratios of hinge moduli to those of the equivalent plate, on the meshes of other tools.

The report is the table of ``drapenet/weights/hinges.json``, minutes of simulated strips.
"""

import numpy as np
from tqdm import tqdm

from common.errors import InputError
from common.types import VertexMask
from drapenet.export.material import GAMMA, MAX_CELLS, MESHES, MIN_CELLS
from experiments.physics.elastica import free_end
from experiments.report import Report
from experiments.study import PlainKeys, Study
from sim.cantilever.elastica import aspect_ratio, elastica, gamma_of_aspect_ratio
from sim.cantilever.strip import TIGHT, fabric_of_gamma
from sim.cloth import Laws
from sim.equilibrium import find_equilibrium
from sim.material import Fabric
from sim.mesh import Mesh, strip
from sim.scene import Scene

LENGTH = 0.09  # m
MAX_STRIPS = 12  # simulated for one equivalent modulus


def equivalent_ratio(
    mesh: Mesh, held: VertexMask, *, gamma: float = 10.0, laws: Laws | None = None,
    tolerance: float = 1e-4,
) -> float:
    """Hinge modulus over the physical one with which a strip has the deflection of the heavy
    elastica of ``gamma``.

    A strip of hinges with the physical modulus bends too far or too little, by an amount that
    depends on its triangulation, its edge length and, weakly, on its deflection.

    Args:
        mesh, held: a strip along +x, clamped at x <= 0; see :func:`sim.mesh.strip`.
        gamma: rho g L³/alpha of the physical strip, L its free length. At 10 the drop about
            equals the reach, as for the cloth of a drape.
        laws: linear hinges by default.
        tolerance: relative, of the stiffness.

    Raises:
        InputError: no elastica has this gamma, a strip does not converge, or none matches.
    """
    laws = laws or Laws(bending="hinge_linear")
    elastica(gamma)  # raises for a gamma out of range
    length = float(mesh.rest[:, 0].max())
    if not length > 0:
        raise InputError("the strip has no free length: its mesh must reach beyond x = 0")
    physical = fabric_of_gamma(gamma, length)
    scene, ratio = Scene(mesh=mesh, held=held), 1.0
    state = scene.state(np.column_stack([mesh.rest, np.zeros(len(mesh.rest))]))
    for _ in range(MAX_STRIPS):
        fabric = Fabric(ratio * physical.alpha, density=physical.density)
        found = find_equilibrium(scene, fabric, state, laws=laws, options=TIGHT)
        if not found.converged:
            raise InputError(f"no strip came to rest ({found.message})")
        # The gamma of a physical strip of this shape measures the stiffness, which is nearly
        # proportional to the modulus: a few corrections by its relative error suffice.
        state = found.state
        apparent = gamma_of_aspect_ratio(aspect_ratio(free_end(mesh, state)))
        if abs(apparent / gamma - 1) < tolerance:
            return ratio
        ratio *= apparent / gamma
    raise InputError(f"no match in {MAX_STRIPS} strips")


def simulated_ratio(mesh: str, cells: int, *, samples: int = 6) -> float:
    """The ratio from simulated strips with so many cells along; up to half a minute."""
    diagonals, jitter = MESHES[mesh]
    edge, ratios = LENGTH / cells, []
    for seed in range(samples if jitter or diagonals == "random" else 1):
        ratios.append(equivalent_ratio(*strip(
            length=LENGTH, width=round(cells / 2) * edge, edge=edge, clamp=2 * edge,
            diagonals=diagonals, jitter=jitter, seed=seed), gamma=GAMMA))
    return float(np.mean(ratios))


class Keys(PlainKeys):
    samples: int = 6  # strips of each irregular mesh, whose stiffness varies by 4 %


def run(keys: Keys) -> Report:
    """Simulate the strips of all meshes."""
    return {mesh: [round(simulated_ratio(mesh, cells, samples=keys.samples), 4)
                   for cells in tqdm(range(MIN_CELLS, MAX_CELLS + 1), desc=mesh)]
            for mesh in MESHES}


STUDY = Study(Keys, run)
