"""Rigs, scenes (what does not change during a simulation) and states (what does), in SI units."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sim.errors import InputError
from sim.mesh import Mesh

GRAVITY = 9.81  # m/s²


@dataclass(frozen=True)
class Rig:
    """A square specimen on a round plate that tops a vertical cylinder (paper, section 3.1).

    The world's origin is the centre of the plate's top face, z points up; the cylinder's side
    goes down from the plate's rim.

    Attributes:
        name: identifier stored in datasets and checkpoints.
        specimen_size: side of the square specimen, m.
        plate_diameter: diameter of the plate and of the cylinder under it, m.
    """

    name: str = "square300_cylinder100"
    specimen_size: float = 0.300
    plate_diameter: float = 0.100

    @property
    def plate_radius(self) -> float:
        """Radius of the plate, m."""
        return self.plate_diameter / 2

    @staticmethod
    def from_name(name: str) -> "Rig":
        """Return the rig called ``name``.

        Raises:
            InputError: no such rig.
        """
        if name not in RIGS:
            raise InputError(f"unknown rig '{name}'; known rigs: {', '.join(RIGS)}")
        return RIGS[name]


RIGS = {rig.name: rig for rig in (Rig(),)}


@dataclass(frozen=True)
class Scene:
    """A specimen, what holds it and what it may touch.

    Attributes:
        mesh: the specimen.
        held: (V,) bool, vertices that do not move; triangles held entirely store no energy.
        cylinder_radius: of the solid cylinder below z = 0, m; None for no contact.
        gravity: m/s², towards -z.
    """

    mesh: Mesh
    held: np.ndarray
    cylinder_radius: float | None = None
    gravity: float = GRAVITY

    @cached_property
    def active(self) -> np.ndarray:
        """(F,) bool, triangles with a free vertex."""
        return ~self.held[self.mesh.faces].all(axis=1)


@dataclass
class State:
    """Where the cloth is.

    Attributes:
        positions: (V, 3) m.
        rotations: (E,) rad, how each edge splits its dihedral angle between its triangles
            (:mod:`sim.energies.midedge`).
    """

    positions: np.ndarray
    rotations: np.ndarray

    @staticmethod
    def at(mesh: Mesh, positions: np.ndarray) -> "State":
        """State with positions (V, 3) and all dihedral angles split evenly."""
        return State(positions=positions.copy(), rotations=np.zeros(len(mesh.edges)))
