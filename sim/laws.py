"""The material laws of a simulated cloth: which bending energy, which membrane."""

from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from sim.energies.base import Energy
from sim.energies.fold_limit import FoldLimit
from sim.energies.membrane import CorotationalMembrane
from sim.energies.midedge import MidEdgeBending
from sim.errors import InputError
from sim.material import Fabric
from sim.mesh import Mesh


class Membrane(Protocol):
    """Parameters of an in-plane law, SI units."""

    def energy(self, mesh: Mesh, active: np.ndarray) -> Energy:
        """The energy of the triangles ``active`` (F,) bool of ``mesh``."""

    def scaled(self, factor: float) -> "Membrane":
        """The same law, ``factor`` times as stiff."""


@dataclass(frozen=True)
class Corotational:
    """Isotropic corotational membrane (section 4.1).

    Attributes:
        stiffness: Young's modulus times thickness, N/m.
        poisson: Poisson's ratio in the plane.
    """

    stiffness: float = 200.0
    poisson: float = 0.3

    def energy(self, mesh: Mesh, active: np.ndarray) -> Energy:
        return CorotationalMembrane(mesh, active, stiffness=self.stiffness, poisson=self.poisson)

    def scaled(self, factor: float) -> "Corotational":
        return replace(self, stiffness=factor * self.stiffness)


BENDING = {"midedge": MidEdgeBending}
"""Bending laws by name: ``law(mesh, active, fabric=fabric)`` is an :class:`Energy`."""


@dataclass(frozen=True)
class Laws:
    """What stands for the cloth in the total energy.

    Attributes:
        bending: a key of :data:`BENDING`.
        membrane: in-plane law.

    Raises:
        InputError: unknown bending law.
    """

    bending: str = "midedge"
    membrane: Membrane = field(default_factory=Corotational)

    def __post_init__(self) -> None:
        if self.bending not in BENDING:
            raise InputError(
                f"unknown bending law '{self.bending}'; choose from {', '.join(BENDING)}"
            )

    def energies(self, mesh: Mesh, active: np.ndarray, fabric: Fabric) -> list[Energy]:
        """Energies of the triangles ``active`` (F,) bool of a cloth of ``fabric``."""
        return [
            self.membrane.energy(mesh, active),
            BENDING[self.bending](mesh, active, fabric=fabric),
            FoldLimit(mesh, active, stiffness=float(fabric.alpha.min())),
        ]

    def softened(self, factor: float) -> "Laws":
        """The same laws with ``factor`` times the membrane's stiffness."""
        return replace(self, membrane=self.membrane.scaled(factor))
