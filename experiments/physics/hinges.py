"""Ratios of hinge moduli to those of the equivalent plate, on the meshes of other tools.

The report is the table of ``drapenet/weights/hinges.json``, minutes of simulated strips.
"""

from dataclasses import dataclass

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


@dataclass(frozen=True)
class EquivalentModulus:
    """The hinge modulus equivalent to a physical one on a given mesh.

    A strip of hinges with the physical modulus bends too far or too little, by an amount that
    depends on its triangulation, its edge length and, weakly, on its deflection (table in
    docs/validation.md). The equivalent modulus gives a strip the deflection of the physical one.
    """

    ratio: float  # hinge modulus over the physical alpha
    mismatch: float  # relative error of the strip's stiffness
    found: bool  # whether the mismatch is below the tolerance
    message: str  # reason of a failure; else the number of strips simulated


def equivalent_modulus(
    mesh: Mesh, held: VertexMask, *, gamma: float = 10.0, laws: Laws | None = None,
    tolerance: float = 1e-4,
) -> EquivalentModulus:
    """Hinge modulus with which a strip has the deflection of the heavy elastica of ``gamma``.

    Args:
        mesh, held: a strip along +x, clamped at x <= 0; see :func:`sim.mesh.strip`.
        gamma: rho g L³/alpha of the physical strip, L its free length. At 10 the drop about
            equals the reach, as for the cloth of a drape.
        laws: linear hinges by default.
        tolerance: relative, of the stiffness.
    """
    laws = laws or Laws(bending="hinge_linear")
    elastica(gamma)  # raises for a gamma out of range
    length = float(mesh.rest[:, 0].max())
    if not length > 0:
        raise InputError("the strip has no free length: its mesh must reach beyond x = 0")
    physical = fabric_of_gamma(gamma, length)
    scene = Scene(mesh=mesh, held=held)
    state = scene.state(np.column_stack([mesh.rest, np.zeros(len(mesh.rest))]))
    ratio, mismatch = 1.0, np.inf
    for strips in range(1, MAX_STRIPS + 1):
        fabric = Fabric(ratio * physical.alpha, density=physical.density)
        equilibrium = find_equilibrium(scene, fabric, state, laws=laws, options=TIGHT)
        state = equilibrium.state
        if not equilibrium.converged:
            return EquivalentModulus(ratio, mismatch, False, equilibrium.message)
        # The gamma of a physical strip of this shape measures the stiffness, which is nearly
        # proportional to the modulus: a few corrections by its relative error suffice.
        try:
            apparent = gamma_of_aspect_ratio(aspect_ratio(free_end(mesh, state)))
        except InputError as error:
            return EquivalentModulus(ratio, mismatch, False, str(error))
        mismatch = abs(apparent / gamma - 1)
        if mismatch < tolerance:
            return EquivalentModulus(ratio, mismatch, True, f"{strips} strips")
        ratio *= apparent / gamma
    return EquivalentModulus(ratio, mismatch, False, f"no match in {MAX_STRIPS} strips")


def simulated_ratio(mesh: str, cells: int, *, samples: int = 6) -> float:
    """The ratio from simulated strips with so many cells along; up to half a minute."""
    diagonals, jitter = MESHES[mesh]
    edge, ratios = LENGTH / cells, []
    for seed in range(samples if jitter or diagonals == "random" else 1):
        modulus = equivalent_modulus(*strip(
            length=LENGTH, width=round(cells / 2) * edge, edge=edge, clamp=2 * edge,
            diagonals=diagonals, jitter=jitter, seed=seed), gamma=GAMMA)
        if not modulus.found:
            raise InputError(f"no strip on the mesh '{mesh}' came to rest ({modulus.message})")
        ratios.append(modulus.ratio)
    return float(np.mean(ratios))


class Keys(PlainKeys):
    samples: int = 6  # strips of each irregular mesh, whose stiffness varies by 4 %


def run(keys: Keys) -> Report:
    """Simulate the strips of all meshes."""
    return {mesh: [round(simulated_ratio(mesh, cells, samples=keys.samples), 4)
                   for cells in tqdm(range(MIN_CELLS, MAX_CELLS + 1), desc=mesh)]
            for mesh in MESHES}


STUDY = Study(Keys, run)
