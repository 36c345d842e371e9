"""The hinge bending laws by name: which energy, and which modulus each hinge gets."""

from dataclasses import dataclass, field

import numpy as np

from common.errors import InputError
from sim.anisotropy import edge_directions, modulus_of_bending
from sim.energies.base import Energy
from sim.energies.hinge_stencils import find_hinges
from sim.energies.hinges import DihedralBending, QuadraticBending
from sim.material import Fabric
from sim.mesh import Mesh

FORMS = ("hinge", "hinge_linear", "quadratic")
DIRECTIONS = ("mean", "edge", "curvature")


@dataclass(frozen=True)
class HingeLaw:
    """A hinge law: the form of its energy and how the fabric's direction enters.

    Attributes:
        form: ``hinge`` (torque alpha kappa + beta kappa²), ``hinge_linear`` (beta left out) or
            ``quadratic`` (gamma = alpha/3, beta left out).
        direction: ``mean``: every hinge has the mean modulus over all directions; ``edge``: the
            modulus across its rest edge (Wang et al. 2011); ``curvature``: the modulus along
            ``axes``.
        axes: (N, 2) directions of bending (:mod:`sim.anisotropy`) of the hinges of
            :func:`sim.energies.hinge_stencils.find_hinges`; for ``curvature`` only.
            :func:`sim.lagged.find_settled_equilibrium` finds them.

    Raises:
        InputError: unknown form or direction.
    """

    form: str = "hinge"
    direction: str = "mean"
    axes: np.ndarray | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        if self.form not in FORMS:
            raise InputError(f"unknown hinge law '{self.form}'; choose from {', '.join(FORMS)}")
        if self.direction not in DIRECTIONS:
            raise InputError(
                f"unknown direction '{self.direction}'; choose from {', '.join(DIRECTIONS)}"
            )

    @property
    def lagged(self) -> bool:
        """Whether the directions of bending must come from a previous solution."""
        return self.direction == "curvature"

    def __call__(self, mesh: Mesh, active: np.ndarray, *, fabric: Fabric) -> Energy:
        """The energy of the hinges beside the triangles ``active`` (F,) bool of ``mesh``.

        Raises:
            InputError: the law follows the curvature and has no ``axes`` for these hinges.
        """
        hinges = find_hinges(mesh, active)
        if self.direction == "edge":
            axes = edge_directions(hinges)
        elif self.direction == "mean":
            axes = np.zeros((len(hinges.edge), 2))
        elif self.axes is None or len(self.axes) != len(hinges.edge):
            raise InputError(
                f"the law '{self.form}_curvature' needs the cloth's directions of bending; "
                "find equilibria with sim.lagged.find_settled_equilibrium"
            )
        else:
            axes = self.axes
        alpha = modulus_of_bending(fabric.alpha, axes)
        if self.form == "quadratic":
            return QuadraticBending(hinges, gamma=alpha / 3)
        beta = modulus_of_bending(fabric.beta, axes)
        return DihedralBending(hinges, alpha=alpha, beta=beta * (self.form == "hinge"))


HINGE_LAWS = {
    form if direction == "mean" else f"{form}_{direction}": HingeLaw(form, direction)
    for form in FORMS
    for direction in DIRECTIONS
}
"""hinge, hinge_edge, hinge_curvature, hinge_linear, ..., quadratic_curvature."""
