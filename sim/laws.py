"""The laws of a simulated cloth: bending energy, membrane and user-defined energies."""

from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from common.errors import InputError
from sim.energies.base import Energy
from sim.energies.midedge import MidEdgeBending
from sim.hinge_laws import HINGE_LAWS
from sim.material import Fabric
from sim.membranes import Corotational, Membrane
from sim.mesh import Mesh


class Law(Protocol):
    """Creates an energy of a cloth on a mesh: a bending law, or a user-defined one. A drape is
    solved on several meshes and calls the law for each, so it must not store a mesh."""

    def __call__(self, mesh: Mesh, active: np.ndarray, *, fabric: Fabric) -> Energy:
        """The energy of the triangles ``active`` (F,) bool of ``mesh``.

        Drapes are simulated at the reference density: ``fabric`` is scaled to it, and loads and
        stiffnesses must be those of cloth of 300 g/m².
        """


BENDING: dict[str, Law] = {"midedge": MidEdgeBending, **HINGE_LAWS}
"""Bending laws by name."""


@dataclass(frozen=True)
class Laws:
    """The laws of the cloth's energies.

    Attributes:
        bending: a key of :data:`BENDING`, or a law.
        membrane: in-plane law.
        others: laws of further energies, such as a foundation or a load.
    """

    bending: str | Law = "midedge"
    membrane: Membrane = field(default_factory=Corotational)
    others: tuple[Law, ...] = ()

    def __post_init__(self) -> None:
        if isinstance(self.bending, str) and self.bending not in BENDING:
            raise InputError(f"unknown bending law '{self.bending}'; choose from "
                             f"{', '.join(BENDING)}")
        if not (isinstance(self.bending, str) or callable(self.bending)):
            raise InputError(f"bending={self.bending!r}: give a name or a law, called with a mesh")
        if isinstance(self.membrane, type) or not hasattr(self.membrane, "scaled"):
            raise InputError(f"membrane={self.membrane!r}: give one of sim.membranes, such as "
                             "Corotational(stiffness=200.0)")
        if not (isinstance(self.others, tuple) and all(callable(law) for law in self.others)):
            raise InputError("others must be a tuple of laws: others=(law,), each called with a "
                             "mesh, not an energy")

    @property
    def bending_law(self) -> Law:
        """The bending law given by ``bending``."""
        return BENDING[self.bending] if isinstance(self.bending, str) else self.bending

    def softened(self, factor: float) -> "Laws":
        """A copy with ``factor`` times the membrane's stiffness."""
        return replace(self, membrane=self.membrane.scaled(factor))
