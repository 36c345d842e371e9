"""The energies of a fabric in a scene and their sum, the objective of the minimisation."""

from collections.abc import Sequence

import numpy as np

from sim.energies.base import Energy, dofs_of
from sim.energies.contact import ObstacleContact
from sim.energies.gravity import Gravity
from sim.laws import Laws
from sim.material import Fabric
from sim.rig import GRAVITY, Cylinder
from sim.scene import Scene
from sim.solver.potential import Potential

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
