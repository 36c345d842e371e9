"""The energies of a fabric in a scene: laws by name, and their sum, which is minimised."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Protocol

import numpy as np

from common.arguments import require
from common.errors import InputError
from common.types import Curvatures, FaceMask
from sim.energies.base import Energy, dofs_of
from sim.energies.bending_variants import Hysteresis
from sim.energies.external import Gravity, ObstacleContact
from sim.energies.hinges import HingeBending
from sim.energies.membrane import Corotational, Membrane
from sim.energies.midedge import MidEdgeBending
from sim.material import REFERENCE_DENSITY, Fabric
from sim.mesh import Mesh
from sim.rig import GRAVITY
from sim.scene import Scene
from sim.solver.potential import Potential


class Law(Protocol):
    """Creates an energy of a cloth on a mesh: a bending law, or a user-defined one. It is called
    for each of several meshes, so it must not store one."""

    def __call__(self, mesh: Mesh, active: FaceMask, *, fabric: Fabric) -> Energy:
        """The energy of the active triangles of ``mesh``; ``fabric`` is scaled to the reference
        density, and loads and stiffnesses must be those of cloth of 300 g/m²."""


BENDING: dict[str, Law] = {
    "midedge": MidEdgeBending, "hinge": HingeBending,
    "hinge_edge": partial(HingeBending, directed=True),
    "hinge_linear": partial(HingeBending, linear=True)}
"""Bending laws by name; those of hinges are for comparison (:mod:`sim.energies.hinges`)."""


@dataclass(frozen=True)
class Laws:
    """The laws of the cloth's energies."""

    bending: str | Law = "midedge"  # a key of :data:`BENDING`, or a law
    membrane: Membrane = field(default_factory=Corotational)
    others: tuple[Law, ...] = ()  # of further energies, such as a foundation or a load

    def __post_init__(self) -> None:
        if not (callable(self.bending) or self.bending in tuple(BENDING)):
            raise InputError(f"unknown bending law {self.bending!r}; give a law or choose from "
                             f"{', '.join(BENDING)}")
        if not (isinstance(self.others, Sequence) and all(map(callable, self.others))):
            raise InputError("others must be laws, each called with a mesh, not energies: (law,)")
        require(membrane=(self.membrane, Membrane,
                          "sim.energies.Corotational(stiffness=200.0), N/m"))

    @property
    def bending_law(self) -> Law:
        """The bending law given by ``bending``."""
        return BENDING[self.bending] if isinstance(self.bending, str) else self.bending

    def with_origin(self, origin: Curvatures) -> "Laws":
        """A copy whose hysteresis has the ``origin`` S1 (N, 3), 1/m, of the triangles of a mesh."""
        assert isinstance(self.bending, Hysteresis), "plates without hysteresis have no origin"
        return replace(self, bending=replace(self.bending, origin=origin))

    def softened(self, factor: float) -> "Laws":
        """A copy with ``factor`` times the membrane's stiffness."""
        return replace(self, membrane=self.membrane.scaled(factor))


STEP_UNIT = 1e-3  # m; steps are reported in mm


@dataclass(frozen=True, eq=False)
class Cloth:
    """A fabric in a scene, with ``extra`` energies in addition to those of laws and scene.

    The shape depends on moduli over density only (Feng et al. 2022, 5.1.2), so the fabric is scaled
    to the reference density, for which membranes and user-defined energies are given. Energies are
    built when first used, and are not pickled. Unknowns are the coordinates of the free vertices
    and the rotations that an energy depends on. Residuals are in units of the mean weight of a
    vertex under standard gravity (for rotations: times the mean edge length), steps in mm (for
    rotations: mm per mean edge length).
    """

    scene: Scene
    fabric: Fabric
    laws: Laws = field(default_factory=Laws)
    extra: Sequence[Energy] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "fabric", self.fabric.at_density(REFERENCE_DENSITY))

    def __getstate__(self) -> dict:
        return {name: self.__dict__[name] for name in ("scene", "fabric", "laws", "extra")}

    @cached_property
    def membrane(self) -> Energy:
        """In-plane energy."""
        return self.laws.membrane.energy(self.scene.mesh, self.scene.active)

    @cached_property
    def bending(self) -> Energy:
        """Bending energy."""
        return self._energy(self.laws.bending_law)

    @cached_property
    def others(self) -> list[Energy]:
        """User-defined energies."""
        return [self._energy(law) for law in self.laws.others]

    @cached_property
    def weight(self) -> Gravity:
        """Potential of the weight."""
        return Gravity(self.scene.mesh, density=self.fabric.density, gravity=self.scene.gravity)

    @cached_property
    def obstacles(self) -> list[Energy]:
        """Contact energies of the obstacles at the free vertices and at the midpoints of the edges:
        points twice as dense reduce the penetration, of edges between touching vertices, to a
        quarter. Areas are those of the mesh refined by these points."""
        scene, mesh = self.scene, self.scene.mesh
        pressure = scene.contact_pressure * self.fabric.density * scene.gravity
        free = ~scene.held
        around = np.bincount(mesh.face_edges.ravel(), np.repeat(mesh.areas, 3),
                             minlength=len(mesh.edges))
        points = [(np.arange(len(mesh.rest))[:, None], mesh.vertex_areas, free),
                  (mesh.edges, around, free[mesh.edges].any(axis=1))]
        return [ObstacleContact(vertices[moves], areas[moves] / 4, obstacle=obstacle,
                                pressure=pressure)
                for obstacle in scene.obstacles for vertices, areas, moves in points]

    @property
    def external(self) -> list[Energy]:
        """Energies of external forces: weight, ``extra`` and obstacles."""
        return [self.weight, *self.extra, *self.obstacles]

    def _energy(self, law: Law) -> Energy:
        return law(self.scene.mesh, self.scene.active, fabric=self.fabric)

    @cached_property
    def potential(self) -> Potential:
        """The sum of all energies."""
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
