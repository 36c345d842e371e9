"""Public entry point of the simulator: the drape of a fabric on a rig."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from common.errors import InputError
from sim.cloth import Laws
from sim.energies.base import Energy
from sim.energies.self_contact import self_intersections
from sim.equilibrium import Equilibrium, find_equilibrium
from sim.lowering import LOWERING_MESHES, lowered, with_origins
from sim.material import REFERENCE_DENSITY, Fabric
from sim.mesh import Mesh
from sim.mesh.specimen import (
    GRADING,
    MAX_BORROWED_EDGE,
    MAX_COARSE_EDGE,
    TOPOLOGIES,
    Specimen,
    coarse_to_fine,
    default_edge,
    longest_edge,
    make_specimen,
)
from sim.rig import Rig
from sim.scene import CONTACT_PRESSURE, Scene
from sim.solver.newton import NewtonOptions, Status
from sim.solver.state import State
from sim.start import (
    LOWERED,
    borrowed_positions,
    check_start,
    initial_positions,
    interpolate_positions,
)

COARSE_MEMBRANE = 0.03
"""Membrane stiffness on the coarser meshes, relative to the final one. In-plane stiffness has
little effect on the shape but limits the length of Newton steps (docs/physics.md)."""
COARSE_CONTACT = 0.003
"""The same for the obstacles' pressure: most steps of falling cloth end inside the cylinder."""
_MIDDLE = 0.7
"""Largest edge of a mesh between lowering and the final one, relative to that of the lowering."""
COARSE_OPTIONS = NewtonOptions(residual=1e-2, step=0.1, max_iterations=200)
FINE_OPTIONS = NewtonOptions(residual=1e-4, step=1e-4, max_iterations=400)


@dataclass(frozen=True, eq=False)
class DrapeResult:
    """A simulated drape with its inputs, or the last state of a failed simulation.

    Attributes:
        fabric, rig: as given.
        mesh: of the specimen; origin on the plate's axis, without a plate at the specimen's centre.
        held: (V,) bool, vertices that the rig holds.
        state: positions (V, 3), m, in the frame of :class:`sim.rig.Rig`, z up, and edge normals.
        laws: bending law, membrane and user-defined energies.
        extra: further energies of the equilibrium.
        touches: whether the equilibrium includes self-contact.
        edge: edge length at the rim, m.
        status, message: outcome as a keyword and as a sentence.
        residual: largest force residual, in units of a vertex's weight.
        step: last Newton step, mm.
        positive_definite: whether the exact Hessian is, so that the state is a minimum.
        self_intersections: number of edges that pass through a triangle; 0 when converged.
        iterations: Newton steps on all meshes together.
        seconds: wall time.
        time_spent: CPU seconds of all minimisations by activity.
        coarse: statuses of the minimisations on coarser meshes, coarsest first.
        equilibrium: the last minimisation with its energies and factor, if requested; it is not
            pickled.
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
        """Positions (V, 3), m."""
        return self.state.positions

    @property
    def rest(self) -> np.ndarray:
        """Rest points (V, 2), m, warp along +x, weft along +y."""
        return self.mesh.rest

    @property
    def faces(self) -> np.ndarray:
        """Faces (F, 3) int64, counter-clockwise seen from above at rest."""
        return self.mesh.faces

    @property
    def converged(self) -> bool:
        """Whether the state is a verified equilibrium."""
        return self.status is Status.CONVERGED

    @property
    def simulated(self) -> Fabric:
        """The fabric scaled to the reference density, at which drapes are simulated."""
        return self.fabric.at_density(REFERENCE_DENSITY)

    @property
    def scene(self) -> Scene:
        """The specimen on its rig."""
        return scene_on(Specimen(self.mesh, self.held), self.rig)

    def at(self, positions: np.ndarray, mesh: Mesh | None = None) -> "DrapeResult":
        """The same cloth at other positions (V, 3), m, or on another ``mesh``, not in equilibrium.
        Held vertices take their positions from ``positions``."""
        there = replace(self, mesh=mesh or self.mesh, equilibrium=None,
                        status=Status.MAX_ITERATIONS, message="not settled")
        return replace(there, state=there.scene.state(positions))

    def __getstate__(self) -> dict:
        return self.__dict__ | {"equilibrium": None}


def drape(
    fabric: Fabric, *, rig: Rig | None = None, edge: float | None = None, start: str | None = None,
    borrowed: tuple[np.ndarray, np.ndarray] | None = None, seed: int = 0,
    offset: tuple[float, float] = (0.0, 0.0), laws: Laws | None = None,
    options: NewtonOptions | None = None
) -> DrapeResult:
    """Simulate the drape of ``fabric`` on ``rig``, from a coarse mesh to the final one.

    The shape depends on moduli/density only (section 5.1.2), so the fabric is simulated at the
    reference density; the value of its density has no effect.

    Args:
        rig: specimen and its holder; None for the square on its cylinder.
        edge: edge length at the plate's rim, m, of the final mesh
            (:func:`sim.mesh.specimen.make_specimen`); None chooses it by the fabric
            (:func:`sim.mesh.specimen.default_edge`).
        start: "lowered" (:mod:`sim.lowering`), or an initial shape (:data:`sim.start.STARTS`);
            None: lowered over a plate, else "sine".
        borrowed: warm start in place of ``start``: rest points (W, 2) and positions (W, 3), m, of
            another fabric's drape on the same rig, on a mesh fine enough for its folds.
        seed: seed of the start; ``seed`` modulo :data:`sim.mesh.specimen.TOPOLOGIES`
            selects the triangulation.
        offset: (2,) m, specimen's centre from the plate's axis, along warp and weft.
        laws: bending law, membrane and user-defined energies; evaluated for every mesh.
        options: stopping criteria of the final minimisation.

    Returns:
        The drape; ``status`` gives the outcome. Only invalid parameters raise an InputError.
    """
    rig, laws = rig or Rig(), laws or Laws()
    check_arguments(rig, laws, start, seed, offset)
    start = start or (LOWERED if rig.has_plate else "sine")
    edge = default_edge(fabric, rig) if edge is None else edge
    began = time.perf_counter()
    simulated = fabric.at_density(REFERENCE_DENSITY)
    run = _Run(simulated, rig, seed, offset, options or FINE_OPTIONS)
    if start == LOWERED and borrowed is None:
        found, statuses, laws = run.lowered(edge, laws)
    else:
        coarsest = MAX_COARSE_EDGE if borrowed is None else MAX_BORROWED_EDGE
        scenes = run.scenes(edge, min(coarsest, longest_edge(rig, offset)))
        found, statuses, _ = run.settled(scenes, laws, borrowed=borrowed, start=start, seed=seed)
    return drape_result(fabric, rig, laws, found, edge=edge, seconds=time.perf_counter() - began,
                        coarse=tuple(statuses))


@dataclass(frozen=True)
class _Run:
    """Arguments of :func:`drape`; the fabric is that of the reference density."""

    fabric: Fabric
    rig: Rig
    seed: int
    offset: tuple[float, float]
    options: NewtonOptions

    def scene(self, edge: float, grading: float = GRADING, *, soft: bool = False) -> Scene:
        """The specimen, meshed, on its rig."""
        return scene_on(make_specimen(self.rig, edge=edge, topology=self.seed % TOPOLOGIES,
                                      offset=self.offset, grading=grading), self.rig, soft=soft)

    def lowered(self, edge: float, laws: Laws) -> tuple[Equilibrium, list[Status], Laws]:
        """The equilibrium of lowered cloth, as :meth:`settled`. Limp cloth without any is lowered
        again on a finer mesh."""
        for coarse, grading in LOWERING_MESHES:
            coarse = min(max(coarse, edge), longest_edge(self.rig, self.offset))
            scene = self.scene(coarse, grading, soft=True)
            before = lowered(scene, self.fabric, self.rig, laws=laws.softened(COARSE_MEMBRANE),
                             seed=self.seed)
            found = self.settled([scene, *self.scenes(edge, _MIDDLE * coarse)], laws, before=before)
            if found[0].converged:
                break
        return found

    def scenes(self, edge: float, coarsest: float) -> list[Scene]:
        """The specimen on meshes from ``coarsest`` at most to ``edge``, m, the last one's."""
        return [self.scene(level, soft=level != edge) for level in coarse_to_fine(edge, coarsest)]

    def settled(
        self, scenes: list[Scene], laws: Laws, *, before: Equilibrium | None = None, **first: Any
    ) -> tuple[Equilibrium, list[Status], Laws]:
        """The equilibrium in the last of ``scenes``, coarse to fine, the statuses in those before,
        and the laws, which remember the hysteresis of cloth that was lowered.

        Args:
            before: cloth that was lowered.
            first: other arguments of :func:`start_positions`, without ``before``.
        """
        found, statuses, used = before, [], laws
        for scene in scenes:
            last = scene is scenes[-1]
            used = with_origins(laws, before, scene) if before else laws
            positions = start_positions(scene, self.rig, coarse=found, **first)
            found = find_equilibrium(
                scene, self.fabric, scene.state(positions), self_contact=last,
                laws=used if last else used.softened(COARSE_MEMBRANE),
                options=self.options if last else COARSE_OPTIONS).after(found)
            statuses.append(found.status)
        return found, statuses[:-1], used


def check_arguments(
    rig: object, laws: object, start: str | None, seed: int, offset: tuple[float, float]
) -> None:
    """InputError for invalid arguments of :func:`drape`, such as the name of a rig."""
    if not isinstance(rig, Rig):
        raise InputError(f"rig={rig!r}: give a sim.rig.Rig, such as "
                         f"Rig.from_name('{Rig().name}')")
    if not isinstance(laws, Laws):
        raise InputError(f"laws={laws!r}: give a sim.cloth.Laws, such as "
                         f"Laws(bending='{Laws().bending}')")
    if start == LOWERED and not rig.has_plate:
        raise InputError(f"start={LOWERED} needs a plate, which {rig.name} lacks")
    if start not in (None, LOWERED):
        check_start(start)
    if np.shape(offset) != (2,) or not np.isfinite(offset).all():
        raise InputError(f"offset={offset}: give two finite numbers, in metres")
    if seed < 0:
        raise InputError(f"seed={seed} must not be negative")


def start_positions(
    scene: Scene, rig: Rig, *, coarse: Equilibrium | None = None,
    borrowed: tuple[np.ndarray, np.ndarray] | None = None, start: str = "sine", seed: int = 0
) -> np.ndarray:
    """Initial positions (V, 3), m, on one mesh: interpolated from the ``coarse`` drape; on the
    first mesh, from ``borrowed`` or ``start``."""
    rest, held = scene.mesh.rest, scene.held
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
    """The scene of a specimen on ``rig``; ``soft`` obstacles are for the coarser meshes."""
    pressure = CONTACT_PRESSURE * (COARSE_CONTACT if soft else 1.0)
    return Scene(specimen.mesh, specimen.held, rig.obstacles, contact_pressure=pressure)


def drape_result(
    fabric: Fabric, rig: Rig, laws: Laws, found: Equilibrium, *, edge: float, seconds: float,
    extra: Sequence[Energy] = (), coarse: tuple[Status, ...] = (), keep: bool = False
) -> DrapeResult:
    """The drape of the last minimisation ``found``, on a mesh with edges of ``edge``, m, at the
    rim; ``keep``: with its energies and factor."""
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
