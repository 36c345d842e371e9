"""The energies of a fabric in a scene: laws by name, and their sum, which is minimised."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from common.errors import InputError
from sim.energies.base import Energy, dofs_of
from sim.energies.external import Gravity, ObstacleContact
from sim.energies.hinges import HINGE_LAWS
from sim.energies.membrane import Corotational, Membrane
from sim.energies.midedge import MidEdgeBending
from sim.material import Fabric
from sim.mesh import Mesh
from sim.rig import GRAVITY, Cylinder
from sim.scene import Scene
from sim.solver.potential import Potential


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
            raise InputError(f"membrane={self.membrane!r}: give one of sim.energies.membrane, such "
                             "as Corotational(stiffness=200.0)")
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


STEP_UNIT = 1e-3  # m; steps are reported in mm


class Cloth:
    """A fabric in a scene, with ``extra`` energies in addition to those of laws and scene.

    Unknowns are the coordinates of the free vertices and the rotations that an energy depends on.
    Residuals are in units of the mean weight of a vertex under standard gravity (for rotations:
    times the mean edge length), steps in mm (for rotations: mm per mean edge length).

    Attributes:
        scene, fabric, laws, extra: as given.
        membrane, bending, others: energies of the laws.
        weight, obstacles: potential of the weight, contact energies of the obstacles.
        potential: the sum of all energies.
    """

    def __init__(
        self, scene: Scene, fabric: Fabric, *, laws: Laws | None = None,
        extra: Sequence[Energy] = ()
    ) -> None:
        self.scene, self.fabric, self.laws = scene, fabric, laws or Laws()
        self.extra = tuple(extra)
        mesh, active = scene.mesh, scene.active
        self.membrane = self.laws.membrane.energy(mesh, active)
        self.bending = self.laws.bending_law(mesh, active, fabric=fabric)
        self.others = [law(mesh, active, fabric=fabric) for law in self.laws.others]
        self.weight = Gravity(mesh, density=fabric.density, gravity=scene.gravity)
        pressure = scene.contact_pressure * fabric.density * scene.gravity
        self.obstacles = [energy for obstacle in scene.obstacles
                          for energy in _contact(scene, obstacle, pressure)]
        self.potential = self._sum()

    @property
    def external(self) -> list[Energy]:
        """Energies of external forces: weight, ``extra`` and obstacles."""
        return [self.weight, *self.extra, *self.obstacles]

    def _sum(self) -> Potential:
        mesh = self.scene.mesh
        others = [self.bending, *self.others, *self.external]
        coordinates, edges = 3 * len(mesh.rest), len(mesh.edges)
        used = np.zeros(coordinates + edges + 1, dtype=bool)  # last entry: dofs of -1
        for energy in (self.membrane, *others):
            used[dofs_of(energy)] = True
        used[:coordinates] &= np.repeat(~self.scene.held, 3)
        used[coordinates:-1] &= ~self.scene.held_edges
        edge_length = mesh.edge_lengths.mean()
        per_area = self.fabric.density * GRAVITY
        weight = per_area * mesh.vertex_areas.mean()
        # A convex membrane alone nearly always makes the Hessian positive definite.
        return Potential(
            [[self.membrane], others],
            mesh.edges,
            used[:-1],
            force_scale=np.repeat([weight, weight * edge_length], [coordinates, edges]),
            length_scale=np.repeat([STEP_UNIT, STEP_UNIT / edge_length], [coordinates, edges]),
            energy_scale=per_area * mesh.areas.sum() * float(np.ptp(mesh.rest, axis=0).max()),
        )


def _contact(scene: Scene, obstacle: Cylinder, pressure: float) -> list[ObstacleContact]:
    """Contact energies at the free vertices and at the midpoints of the edges.

    Edges between touching vertices cut through a convex obstacle; points twice as dense reduce
    the penetration to a quarter. Areas are those of the mesh refined by these points.
    """
    mesh = scene.mesh
    free = ~scene.held
    around = np.bincount(mesh.face_edges.ravel(), np.repeat(mesh.areas, 3),
                         minlength=len(mesh.edges))
    points = [(np.arange(len(mesh.rest))[:, None], mesh.vertex_areas, free),
              (mesh.edges, around, free[mesh.edges].any(axis=1))]
    return [
        ObstacleContact(vertices[moves], areas[moves] / 4, obstacle=obstacle, pressure=pressure)
        for vertices, areas, moves in points
    ]
