"""The material laws of a simulated cloth: which bending energy, which membrane."""

from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from sim.energies.base import Energy
from sim.energies.fold_limit import FoldLimit
from sim.energies.midedge import MidEdgeBending
from sim.errors import InputError
from sim.hinge_laws import HINGE_LAWS
from sim.material import Fabric
from sim.membranes import Corotational, Membrane
from sim.mesh import Mesh


class Bending(Protocol):
    """A bending law."""

    def __call__(self, mesh: Mesh, active: np.ndarray, *, fabric: Fabric) -> Energy:
        """The energy of the triangles ``active`` (F,) bool of ``mesh``."""


BENDING: dict[str, Bending] = {"midedge": MidEdgeBending, **HINGE_LAWS}
"""Bending laws by name."""


@dataclass(frozen=True)
class Laws:
    """What stands for the cloth in the total energy.

    Attributes:
        bending: a key of :data:`BENDING`, or a law itself.
        membrane: in-plane law.

    Raises:
        InputError: unknown bending law.
    """

    bending: str | Bending = "midedge"
    membrane: Membrane = field(default_factory=Corotational)

    def __post_init__(self) -> None:
        if isinstance(self.bending, str) and self.bending not in BENDING:
            raise InputError(
                f"unknown bending law '{self.bending}'; choose from {', '.join(BENDING)}"
            )

    @property
    def bending_law(self) -> Bending:
        """The bending law that ``bending`` names or is."""
        return BENDING[self.bending] if isinstance(self.bending, str) else self.bending

    def energies(self, mesh: Mesh, active: np.ndarray, fabric: Fabric) -> list[Energy]:
        """Energies of the triangles ``active`` (F,) bool of a cloth of ``fabric``."""
        return [
            self.membrane.energy(mesh, active),
            self.bending_law(mesh, active, fabric=fabric),
            FoldLimit(mesh, active, stiffness=float(fabric.alpha.min())),
        ]

    def softened(self, factor: float) -> "Laws":
        """The same laws with ``factor`` times the membrane's stiffness."""
        return replace(self, membrane=self.membrane.scaled(factor))
