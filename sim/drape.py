"""The public door of the simulator: fabric, rig and start in, drape out."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from common.errors import InputError
from sim.energies.base import Energy
from sim.equilibrium import Equilibrium, find_equilibrium
from sim.initial import borrowed_positions, check_start, initial_positions, interpolate_positions
from sim.laws import Laws
from sim.material import REFERENCE_DENSITY, Fabric
from sim.mesh import Mesh
from sim.mesh.specimens import (
    BORROWED_COARSEST,
    COARSEST,
    TOPOLOGIES,
    Specimen,
    coarse_to_fine,
    default_edge,
    longest_edge,
    make_specimen,
)
from sim.newton import NewtonOptions, Status
from sim.scene import CONTACT_PRESSURE, Rig, Scene
from sim.self_contact import self_intersections
from sim.state import State

COARSE_MEMBRANE = 0.03
"""Membrane stiffness on the coarser meshes, relative to the final one. In-plane stiffness matters
little for the shape but limits the length of Newton's steps (docs/physics.md)."""
COARSE_CONTACT = 0.003
"""The same for the obstacles' pressure: most steps of falling cloth would end in the cylinder."""
COARSE_OPTIONS = NewtonOptions(residual=1e-2, step=0.1, max_iterations=200)
FINE_OPTIONS = NewtonOptions(residual=1e-4, step=1e-4, max_iterations=400)


@dataclass(frozen=True, eq=False)
class DrapeResult:
    """A draped specimen, or how far it came, with what made it.

    Attributes:
        fabric, rig: what was asked for.
        mesh: of the specimen; origin on the plate's axis, without a plate at the specimen's centre.
        held: (V,) bool, vertices that the rig holds.
        state: positions (V, 3), m, origin and axes as :class:`sim.scene.Rig` says, z up, and
            normals of the edges.
        laws: of bending and membrane with which it is in balance.
        extra: more energies that it is in balance with.
        touches: whether contact of the cloth with itself is among them.
        edge: length of the mesh's edges at the rim, m.
        status, message: how it ended, in one word and in a sentence.
        residual: largest force residual, in units of a vertex's weight.
        step: last Newton step, mm.
        positive_definite: whether the exact Hessian is, so that the state is a minimum.
        self_intersections: places where an edge passes through a triangle; 0 when converged.
        iterations: Newton steps on all meshes together.
        seconds: wall time.
        time_spent: seconds of all minimisations by activity.
        coarse: statuses of the minimisations on coarser meshes, coarsest first.
        equilibrium: the last minimisation with its energies and factor, where it was asked for;
            it does not travel between processes.
    """

    fabric: Fabric
    rig: Rig
    mesh: Mesh
    held: np.ndarray
    state: State
    laws: Laws
    extra: tuple[Energy, ...]
    touches: bool
    edge: float
    status: Status
    message: str
    residual: float
    step: float
    positive_definite: bool
    self_intersections: int
    iterations: int
    seconds: float
    time_spent: dict[str, float]
    coarse: tuple[Status, ...] = ()
    equilibrium: Equilibrium | None = None

    @property
    def positions(self) -> np.ndarray:
        """(V, 3) m."""
        return self.state.positions

    @property
    def rest(self) -> np.ndarray:
        """(V, 2) m, warp along +x, weft along +y."""
        return self.mesh.rest

    @property
    def faces(self) -> np.ndarray:
        """(F, 3) int64, counter-clockwise seen from above at rest."""
        return self.mesh.faces

    @property
    def converged(self) -> bool:
        """Whether this is a proven equilibrium."""
        return self.status is Status.CONVERGED

    @property
    def simulated(self) -> Fabric:
        """The fabric at the reference density, at which drapes are simulated."""
        return self.fabric.at_density(REFERENCE_DENSITY)

    @property
    def scene(self) -> Scene:
        """The specimen on its rig."""
        return scene_on(Specimen(self.mesh, self.held), self.rig)

    def at(self, positions: np.ndarray, mesh: Mesh | None = None) -> "DrapeResult":
        """The same cloth elsewhere, not settled: positions (V, 3) m, on another ``mesh``. Where it
        is held follows the positions."""
        there = replace(self, mesh=mesh or self.mesh, equilibrium=None,
                        status=Status.MAX_ITERATIONS, message="not settled")
        return replace(there, state=there.scene.state(positions))

    def __getstate__(self) -> dict:
        return self.__dict__ | {"equilibrium": None}


def drape(
    fabric: Fabric, *, rig: Rig | None = None, edge: float | None = None, start: str = "sine",
    borrowed: tuple[np.ndarray, np.ndarray] | None = None, seed: int = 0,
    offset: tuple[float, float] = (0.0, 0.0), laws: Laws | None = None,
    options: NewtonOptions | None = None
) -> DrapeResult:
    """Drape ``fabric`` on ``rig``, coarse mesh first.

    The shape depends on moduli/density only (section 5.1.2), so the fabric is simulated at the
    reference density; its own density changes nothing.

    Args:
        rig: what holds the specimen; None for the square on its cylinder.
        edge: length of the edges at the plate's rim, m, of the final mesh
            (:func:`sim.mesh.specimens.make_specimen`); None chooses it by the fabric
            (:func:`sim.mesh.specimens.default_edge`).
        start: initial shape, see :data:`sim.initial.STARTS`.
        borrowed: rest (W, 2) and positions (W, 3), m, of another fabric's drape on the same rig
            to start from, in place of ``start``; on a mesh fine enough for its folds.
        seed: of the initial shape; ``seed`` modulo :data:`sim.mesh.specimens.TOPOLOGIES` is the
            triangulation.
        offset: (2,) m, specimen's centre from the plate's axis, along warp and weft.
        laws: of bending, membrane and energies of your own; made again on every mesh.
        options: of the final minimisation.

    Returns:
        The drape; look at its ``status``. Only parameters that make no sense raise an InputError.
    """
    rig, laws = rig or Rig(), laws or Laws()
    check_arguments(rig, laws, start, seed, offset)
    edge = default_edge(fabric, rig) if edge is None else edge
    began = time.perf_counter()
    simulated = fabric.at_density(REFERENCE_DENSITY)
    found, statuses = None, []
    coarsest = min(COARSEST if borrowed is None else BORROWED_COARSEST, longest_edge(rig, offset))
    for level in coarse_to_fine(edge, coarsest):
        last = level == edge
        specimen = make_specimen(rig, edge=level, topology=seed % TOPOLOGIES, offset=offset)
        positions = start_positions(specimen, rig, coarse=found, borrowed=borrowed, start=start,
                                    seed=seed)
        scene = scene_on(specimen, rig, soft=not last)
        found = find_equilibrium(
            scene, simulated, scene.state(positions), self_contact=last,
            laws=laws if last else laws.softened(COARSE_MEMBRANE),
            options=(options or FINE_OPTIONS) if last else COARSE_OPTIONS).after(found)
        statuses.append(found.status)
    return drape_result(fabric, rig, laws, found, edge=edge, seconds=time.perf_counter() - began,
                        coarse=tuple(statuses[:-1]))


def check_arguments(
    rig: object, laws: object, start: str, seed: int, offset: tuple[float, float]
) -> None:
    """InputError for arguments of :func:`drape` that make no sense, such as the name of a rig."""
    if not isinstance(rig, Rig):
        raise InputError(f"rig={rig!r}: give a sim.scene.Rig, such as "
                         f"Rig.from_name('{Rig().name}')")
    if not isinstance(laws, Laws):
        raise InputError(f"laws={laws!r}: give a sim.laws.Laws, such as "
                         f"Laws(bending='{Laws().bending}')")
    check_start(start)
    if np.shape(offset) != (2,) or not np.isfinite(offset).all():
        raise InputError(f"offset={offset}: give two finite numbers, in metres")
    if seed < 0:
        raise InputError(f"seed={seed} must not be negative")


def start_positions(
    specimen: Specimen, rig: Rig, *, coarse: Equilibrium | None,
    borrowed: tuple[np.ndarray, np.ndarray] | None, start: str, seed: int
) -> np.ndarray:
    """Positions (V, 3), m, at which the minimisation on one mesh begins: those of the ``coarse``
    drape, on the first mesh of the start."""
    rest, held = specimen.mesh.rest, specimen.held
    if coarse is not None:
        positions = interpolate_positions(coarse.cloth.scene.mesh.rest, coarse.state.positions,
                                          rest)
    elif borrowed is not None:
        positions = borrowed_positions(rest, rig=rig, borrowed=borrowed)
    else:
        rng = np.random.default_rng([seed, 1])
        positions = initial_positions(rest, rig=rig, start=start, rng=rng)
    positions[held] = rig.place(rest[held])
    return positions


def scene_on(specimen: Specimen, rig: Rig, *, soft: bool = False) -> Scene:
    """A specimen on ``rig``; with ``soft`` obstacles, as on the coarser meshes."""
    pressure = CONTACT_PRESSURE * (COARSE_CONTACT if soft else 1.0)
    return Scene(specimen.mesh, specimen.held, rig.obstacles, contact_pressure=pressure)


def drape_result(
    fabric: Fabric, rig: Rig, laws: Laws, found: Equilibrium, *, edge: float, seconds: float,
    extra: Sequence[Energy] = (), coarse: tuple[Status, ...] = (), keep: bool = False
) -> DrapeResult:
    """The drape, on triangles with sides of ``edge``, m, whose last minimisation ended with
    ``found``; ``keep``: with its factor."""
    scene, newton = found.cloth.scene, found.newton
    return DrapeResult(
        fabric=fabric, rig=rig, mesh=scene.mesh, held=scene.held, state=found.state, laws=laws,
        extra=tuple(extra), touches=found.contact is not None, edge=edge, status=found.status,
        message=found.message, residual=newton.residual, step=newton.step,
        positive_definite=newton.positive_definite,
        self_intersections=len(self_intersections(found.state.positions, scene.mesh.faces)),
        iterations=newton.iterations, seconds=seconds, time_spent=newton.seconds, coarse=coarse,
        equilibrium=found if keep else None,
    )
