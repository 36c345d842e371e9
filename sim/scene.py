"""Scenes: a meshed specimen with its fixed vertices and obstacles."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sim.mesh import Mesh
from sim.rig import GRAVITY, Cylinder
from sim.solver.state import State

CONTACT_PRESSURE = 120.0
"""Pressure of an obstacle on cloth :data:`sim.energies.external.DEPTH` deep in it, as a multiple of
the cloth's weight."""


@dataclass(frozen=True, eq=False)
class Scene:
    """A specimen with its fixed vertices and obstacles.

    Attributes:
        mesh: the specimen.
        held: (V,) bool, fixed vertices; triangles without a free vertex store no energy.
        obstacles: solids that exclude the free vertices.
        gravity: m/s², towards -z.
        contact_pressure: of the obstacles, as :data:`CONTACT_PRESSURE`.
    """

    mesh: Mesh
    held: np.ndarray
    obstacles: tuple[Cylinder, ...] = ()
    gravity: float = GRAVITY
    contact_pressure: float = CONTACT_PRESSURE

    @cached_property
    def active(self) -> np.ndarray:
        """(F,) bool, triangles with a free vertex."""
        return ~self.held[self.mesh.faces].all(axis=1)

    @cached_property
    def held_edges(self) -> np.ndarray:
        """(E,) bool, edges of held triangles, whose normals are fixed."""
        held = np.zeros(len(self.mesh.edges), dtype=bool)
        held[self.mesh.face_edges[~self.active]] = True
        return held

    def state(self, positions: np.ndarray) -> State:
        """The state with positions (V, 3), m, and edge normals that bisect the dihedral angles."""
        return State.at(self.mesh, positions, self.active)
