"""Scenes: meshed specimens with their fixed vertices and obstacles."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from common.types import FaceMask, Points, VertexMask
from sim.mesh import Mesh
from sim.mesh.specimen import mesh_specimen
from sim.rig import GRAVITY, Cylinder, Rig
from sim.solver.state import State

CONTACT_PRESSURE = 120.0
"""Pressure on cloth :data:`sim.energies.external.DEPTH` deep in an obstacle, in its weights."""


@dataclass(frozen=True, eq=False)
class Scene:
    """A specimen with its fixed vertices and obstacles."""

    mesh: Mesh
    held: VertexMask  # triangles without a free vertex store no energy
    obstacles: tuple[Cylinder, ...] = ()  # solids that exclude the free vertices
    gravity: float = GRAVITY  # m/s², towards -z
    contact_pressure: float = CONTACT_PRESSURE

    @staticmethod
    def on(rig: Rig, mesh: Mesh, held: VertexMask, *, softness: float = 1.0) -> "Scene":
        """The scene of a specimen on ``rig``, with ``softness`` times the obstacles' pressure."""
        return Scene(mesh, held, rig.obstacles, contact_pressure=softness * CONTACT_PRESSURE)

    @cached_property
    def active(self) -> FaceMask:
        """Triangles with a free vertex."""
        return ~self.held[self.mesh.faces].all(axis=1)

    @cached_property
    def held_edges(self) -> np.ndarray:
        """(E,) bool, edges of held triangles, whose normals are fixed."""
        held = np.zeros(len(self.mesh.edges), dtype=bool)
        held[self.mesh.face_edges[~self.active]] = True
        return held

    def state(self, positions: Points) -> State:
        """The state with these positions and edge normals that bisect the dihedral angles."""
        return State.at(self.mesh, positions, self.active)


def make_specimen(rig: Rig, **mesh) -> Scene:
    """The specimen of ``rig``, meshed as :func:`sim.mesh.specimen.mesh_specimen` does, on it."""
    return Scene.on(rig, *mesh_specimen(rig, **mesh))
