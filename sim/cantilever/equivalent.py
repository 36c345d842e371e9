"""Equivalent hinge moduli: what a simulator of hinges must be given to bend as the cloth does.

A strip of hinges with the physical modulus bends too far or too little, by an amount that depends
on its triangulation, its edge length and, weakly, on how far it hangs (docs/validation.md has
a table). Here the modulus is sought with which a given strip hangs as a physical one.
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
from sim.state import State

_MOST_STRIPS = 12


@dataclass(frozen=True)
class EquivalentModulus:
    """The modulus of a hinge law that stands for a physical one on a given mesh."""

    ratio: float  # hinge modulus over the physical alpha
    mismatch: float  # relative difference of the stiffness that is left
    found: bool  # whether the mismatch is below the tolerance
    message: str  # why not, in words; else how many strips it took


def equivalent_modulus(
    mesh: Mesh, held: np.ndarray, *, gamma: float = 10.0, laws: Laws | None = None,
    tolerance: float = 1e-4,
) -> EquivalentModulus:
    """Hinge modulus with which a strip hangs as the heavy elastica of ``gamma`` does.

    Args:
        mesh, held: a strip along +x, and its vertices (V,) clamped at x <= 0; see
            :func:`sim.mesh.strip`.
        gamma: rho g L³/alpha of the physical strip, L its free length. 10 hangs down by about
            its reach, as the cloth of a drape does.
        laws, tolerance: linear hinges by default; of the stiffness, relative.
    """
    laws = laws or Laws(bending="hinge_linear")
    elastica(gamma)  # refuses a gamma out of range before any work
    length = float(mesh.rest[:, 0].max())
    if not length > 0:
        raise InputError("the strip has no free length: its mesh must reach beyond x = 0")
    physical = fabric_of_gamma(gamma, length)
    scene = Scene(mesh=mesh, held=held)
    state = scene.state(np.column_stack([mesh.rest, np.zeros(len(mesh.rest))]))
    ratio, mismatch = 1.0, np.inf
    for strips in range(1, _MOST_STRIPS + 1):
        fabric = Fabric(ratio * physical.alpha, density=physical.density)
        found = find_equilibrium(scene, fabric, state, laws=laws, options=TIGHT)
        state = found.state
        if not found.converged:
            return EquivalentModulus(ratio, mismatch, False, found.message)
        # The stiffness shows in the gamma that a physical strip of this shape would have; it is
        # nearly proportional to the modulus, so that a few corrections by its error suffice.
        try:
            apparent = gamma_of_aspect_ratio(aspect_ratio(free_end(mesh, state)))
        except InputError as error:
            return EquivalentModulus(ratio, mismatch, False, str(error))
        mismatch = abs(apparent / gamma - 1)
        if mismatch < tolerance:
            return EquivalentModulus(ratio, mismatch, True, f"{strips} strips")
        ratio *= apparent / gamma
    return EquivalentModulus(ratio, mismatch, False, f"no match in {_MOST_STRIPS} strips")


def free_end(mesh: Mesh, state: State) -> np.ndarray:
    """Mean (reach, drop) (2,), m, of the free end of a strip along +x."""
    x = mesh.rest[:, 0]
    end = state.positions[x > (1 - 1e-9) * x.max()].mean(axis=0)
    return np.array([end[0], -end[2]])
