"""Equivalent hinge moduli, with which a hinge-based simulator reproduces the cloth's bending.

A strip of hinges with the physical modulus bends too far or too little, by an amount that depends
on its triangulation, its edge length and, weakly, on its deflection (table in docs/validation.md).
The equivalent modulus gives a strip the deflection of the physical one.
"""

from dataclasses import dataclass

import numpy as np

from common.errors import InputError
from sim.cantilever.elastica import aspect_ratio, elastica, gamma_of_aspect_ratio
from sim.cantilever.tester import TIGHT, fabric_of_gamma
from sim.equilibrium import find_equilibrium
from sim.laws import Laws
from sim.material import Fabric
from sim.mesh import Mesh
from sim.scene import Scene
from sim.solver.state import State

_MAX_ITERATIONS = 12  # simulated strips


@dataclass(frozen=True)
class EquivalentModulus:
    """The hinge modulus equivalent to a physical one on a given mesh."""

    ratio: float  # hinge modulus over the physical alpha
    mismatch: float  # relative error of the strip's stiffness
    found: bool  # whether the mismatch is below the tolerance
    message: str  # reason of a failure; else the number of strips simulated


def equivalent_modulus(
    mesh: Mesh, held: np.ndarray, *, gamma: float = 10.0, laws: Laws | None = None,
    tolerance: float = 1e-4,
) -> EquivalentModulus:
    """Hinge modulus with which a strip has the deflection of the heavy elastica of ``gamma``.

    Args:
        mesh, held: a strip along +x, and its vertices (V,) clamped at x <= 0; see
            :func:`sim.mesh.strip`.
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
    for strips in range(1, _MAX_ITERATIONS + 1):
        fabric = Fabric(ratio * physical.alpha, density=physical.density)
        found = find_equilibrium(scene, fabric, state, laws=laws, options=TIGHT)
        state = found.state
        if not found.converged:
            return EquivalentModulus(ratio, mismatch, False, found.message)
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
    return EquivalentModulus(ratio, mismatch, False, f"no match in {_MAX_ITERATIONS} strips")


def free_end(mesh: Mesh, state: State) -> np.ndarray:
    """Mean (reach, drop) (2,), m, of the free end of a strip along +x."""
    x = mesh.rest[:, 0]
    end = state.positions[x > (1 - 1e-9) * x.max()].mean(axis=0)
    return np.array([end[0], -end[2]])
