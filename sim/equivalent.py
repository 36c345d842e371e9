"""Equivalent hinge moduli: what a simulator of hinges must be given to bend as the cloth does.

A strip of hinges with the physical modulus bends too far or too little, by an amount that depends
on its triangulation, its edge length and, weakly, on how far it hangs (docs/validation.md has
a table). Here the modulus is sought with which a given strip hangs as a physical one.
"""

from dataclasses import dataclass

import numpy as np

from common.errors import InputError
from sim.cantilever import aspect_ratio, elastica, fabric_of_gamma, gamma_of_aspect_ratio
from sim.equilibrium import find_equilibrium
from sim.laws import Laws
from sim.material import Fabric
from sim.mesh import Mesh
from sim.newton import NewtonOptions, NewtonResult, Status
from sim.scene import Scene, State

_MOST_STRIPS = 12
_LEAST_REACH = 1e-3  # of the length; a free end that hangs closer to the clamp says nothing


@dataclass(frozen=True)
class EquivalentModulus:
    """The modulus of a hinge law that stands for a physical one on a given mesh.

    Attributes:
        ratio: hinge modulus over the physical alpha.
        gamma: rho g L³/alpha of the strip that was compared, with the physical alpha.
        mismatch: relative difference of the stiffness that is left.
        found: whether ``mismatch`` is below the tolerance.
        message: why not, in words; else how many strips it took.
    """

    ratio: float
    gamma: float
    mismatch: float
    found: bool
    message: str


def equivalent_modulus(
    mesh: Mesh,
    held: np.ndarray,
    *,
    gamma: float = 10.0,
    laws: Laws | None = None,
    tolerance: float = 1e-4,
) -> EquivalentModulus:
    """Hinge modulus with which a strip hangs as the heavy elastica of ``gamma`` does.

    Args:
        mesh: a strip along +x, clamped at x <= 0; see :func:`sim.mesh.strip`.
        held: (V,) bool, clamped vertices.
        gamma: rho g L³/alpha of the physical strip, L its free length. 10 hangs down by about
            its reach, as the cloth of a drape does.
        laws: linear hinges by default.
        tolerance: of the stiffness, relative.

    Raises:
        InputError: the strip has no free length or gamma is out of range.
    """
    laws = laws or Laws(bending="hinge_linear")
    elastica(gamma)  # refuses a gamma out of range before any work
    length = free_length(mesh)
    physical = fabric_of_gamma(gamma, length)
    state = State.at(mesh, np.column_stack([mesh.rest, np.zeros(len(mesh.rest))]))
    ratio, mismatch = 1.0, np.inf
    for strips in range(1, _MOST_STRIPS + 1):
        fabric = Fabric(ratio * physical.alpha, density=physical.density)
        end, state, result = hang_mesh(mesh, held, fabric, state, laws=laws)
        if result.status is not Status.CONVERGED:
            return EquivalentModulus(ratio, gamma, mismatch, False, result.message)
        if not (end[0] > _LEAST_REACH * length and end[1] > 0):
            return EquivalentModulus(ratio, gamma, mismatch, False, "the strip folds under itself")
        # The stiffness shows in the gamma that a physical strip of this shape would have; it is
        # nearly proportional to the modulus, so that a few corrections by its error suffice.
        try:
            apparent = gamma_of_aspect_ratio(aspect_ratio(end))
        except InputError as error:
            return EquivalentModulus(ratio, gamma, mismatch, False, str(error))
        mismatch = abs(apparent / gamma - 1)
        if mismatch < tolerance:
            return EquivalentModulus(ratio, gamma, mismatch, True, f"{strips} strips")
        ratio *= apparent / gamma
    return EquivalentModulus(ratio, gamma, mismatch, False, f"no match in {strips} strips")


def free_length(mesh: Mesh) -> float:
    """Length, m, of a strip along +x beyond its clamp at x = 0.

    Raises:
        InputError: there is none.
    """
    length = float(mesh.rest[:, 0].max())
    if not length > 0:
        raise InputError("the strip has no free length: its mesh must reach beyond x = 0")
    return length


def hang_mesh(
    mesh: Mesh, held: np.ndarray, fabric: Fabric, start: State, *, laws: Laws
) -> tuple[np.ndarray, State, NewtonResult]:
    """Let a strip along +x hang from its clamp.

    Args:
        mesh, held: as for :func:`equivalent_modulus`.
        start: state next to which the equilibrium is sought.

    Returns:
        Mean (reach, drop) (2,) of the free end, m, the state, and the solver's result.
    """
    options = NewtonOptions(residual=1e-6, step=1e-6)
    state, result = find_equilibrium(
        Scene(mesh=mesh, held=held), fabric, start, laws=laws, options=options
    )
    length = free_length(mesh)
    end = state.positions[mesh.rest[:, 0] > (1 - 1e-9) * length].mean(axis=0)
    return np.array([end[0], -end[2]]), state, result
