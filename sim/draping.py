"""Public entry points of the simulator: the drape of a fabric on a rig, and drapes near it."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from common.arguments import number, numbers, require, whole_number
from common.errors import one_line
from common.types import Faces, Metres, Points, RestPoints, VertexMask
from sim.cloth import Cloth, Laws
from sim.energies.base import Energy
from sim.energies.self_contact import self_intersections
from sim.equilibrium import Equilibrium, find_equilibrium, light
from sim.lowering import LOWERING_MESHES, LoweringMesh, lowered, with_origins
from sim.material import Fabric, gravity_length
from sim.mesh import Mesh
from sim.mesh.specimen import (
    GRADING,
    MAX_BORROWED_EDGE,
    MAX_COARSE_EDGE,
    TOPOLOGIES,
    coarse_to_fine,
    default_edge,
    longest_edge,
    mesh_specimen,
)
from sim.rig import Rig
from sim.scene import Scene
from sim.solver.newton import NUMERICAL_ERRORS, NewtonOptions, NewtonResult, Status
from sim.solver.state import State
from sim.start import (
    LOWERED,
    Borrowed,
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
_EDGES_OF_LIMP = 1.3
"""Longest edge at the rim, in gravity lengths, of a mesh on which cloth is lowered, if there is a
finer one."""
_MIDDLE = 0.7
"""Largest edge of a mesh between lowering and the final one, relative to that of the lowering."""
COARSE_OPTIONS = NewtonOptions(residual=0.1, step=1.0, max_iterations=200)
FINE_OPTIONS = NewtonOptions(residual=1e-4, step=1e-4, max_iterations=400)


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Drape(Equilibrium):
    """A drape with its inputs, the last state of a failed simulation, or another shape of cloth.

    The origin is on the plate's axis, without a plate at the specimen's centre; z points up
    (:class:`sim.rig.Rig`). Iterations and CPU seconds of ``outcome`` are those on all meshes.
    """

    fabric: Fabric
    rig: Rig
    edge: Metres  # at the rim
    coarse: tuple[Status, ...] = ()  # on coarser meshes, coarsest first
    seconds: float = 0.0  # wall time

    @property
    def scene(self) -> Scene:
        """The specimen on its rig."""
        return self.cloth.scene

    @property
    def mesh(self) -> Mesh:
        """Mesh of the specimen."""
        return self.scene.mesh

    @property
    def held(self) -> VertexMask:
        """Vertices that the rig holds."""
        return self.scene.held

    @property
    def rest(self) -> RestPoints:
        """Rest points, warp along +x, weft along +y."""
        return self.mesh.rest

    @property
    def faces(self) -> Faces:
        """Triangles, counter-clockwise seen from above at rest."""
        return self.mesh.faces

    @property
    def laws(self) -> Laws:
        """Bending law, membrane and user-defined energies."""
        return self.cloth.laws

    @property
    def iterations(self) -> int:
        """Newton steps on all meshes together."""
        return self.searched.iterations

    @property
    def self_intersections(self) -> int:
        """Number of edges that pass through a triangle; 0 when converged."""
        return len(self_intersections(self.positions, self.faces))

    def at(self, positions: Points, mesh: Mesh | None = None) -> "Drape":
        """The cloth at other positions, or on another ``mesh``: a shape, not an equilibrium."""
        shape = self.on(mesh or self.mesh)
        return replace(shape, state=shape.scene.state(positions))

    def on(self, mesh: Mesh) -> "Drape":
        """The drape's state on the same triangles with other rest points: a shape."""
        scene = Scene.on(self.rig, mesh, self.held)
        return replace(self, cloth=replace(self.cloth, scene=scene), outcome=None)

    def __repr__(self) -> str:
        ended = self.status.value if self.status else self.message
        return f"Drape({ended}, {self.rig.name}, {len(self.positions)} vertices, {self.fabric})"


def drape(
    fabric: Fabric, *, rig: Rig | None = None, edge: Metres | None = None, start: str | None = None,
    borrowed: Borrowed | None = None, seed: int = 0,
    offset: tuple[float, float] = (0.0, 0.0), laws: Laws | None = None,
    options: NewtonOptions | None = None, keep: bool = False
) -> Drape:
    """Simulate the drape of ``fabric`` on ``rig`` (None: the square on its cylinder), from a coarse
    mesh to the final one. Only invalid parameters raise an InputError.

    Args:
        edge: edge length at the plate's rim of the final mesh; None chooses it by the fabric
            (:func:`sim.mesh.specimen.default_edge`).
        start: "lowered" (:mod:`sim.lowering`), or an initial shape (:data:`sim.start.STARTS`);
            None: lowered over a plate, else "sine".
        borrowed: warm start in place of ``start``: rest points and positions of another fabric's
            drape on the same rig, on a mesh fine enough for its folds.
        seed: of the start; modulo :data:`sim.mesh.specimen.TOPOLOGIES`, the triangulation.
        offset: (2,) m, specimen's centre from the plate's axis, along warp and weft.
        options: stopping criteria of the final minimisation.
        keep: whether the drape keeps its energies and factor, for derivatives.
    """
    run = Run.of(fabric, rig=rig, edge=edge, seed=seed, offset=offset, laws=laws, options=options)
    start = start or (LOWERED if run.rig.has_plate else "sine")
    check_start(start, run.rig)
    began = time.perf_counter()
    try:
        if start == LOWERED and borrowed is None:
            equilibrium, coarse = run.lowered()
        else:
            coarsest = MAX_COARSE_EDGE if borrowed is None else MAX_BORROWED_EDGE
            scenes = run.scenes(min(coarsest, longest_edge(run.rig, run.offset)))
            equilibrium, coarse = run.settled(scenes, borrowed=borrowed, start=start,
                                              seed=run.seed)
    except NUMERICAL_ERRORS as error:
        equilibrium, coarse = run.failed(error), []
    return run.made(equilibrium, coarse, time.perf_counter() - began, keep=keep)


@dataclass(frozen=True)
class Run:
    """A simulation by its arguments, those of :func:`drape`."""

    fabric: Fabric
    rig: Rig
    laws: Laws
    edge: Metres
    seed: int
    offset: tuple[float, float]
    options: NewtonOptions

    @staticmethod
    def of(
        fabric: Fabric, *, rig: Rig | None = None, edge: Metres | None = None, seed: int = 0,
        offset: tuple[float, float] = (0.0, 0.0), laws: Laws | None = None,
        options: NewtonOptions | None = None
    ) -> "Run":
        """The simulation with the arguments of :func:`drape`, checked, or their defaults."""
        rig, laws, options = rig or Rig(), laws or Laws(), options or FINE_OPTIONS
        require(fabric=(fabric, Fabric), laws=(laws, Laws), options=(options, NewtonOptions),
                rig=(rig, Rig, "Rig.from_name('disc300_support180')"))
        seed = whole_number("seed", seed, 0)
        warp, weft = numbers("offset", offset, "two numbers, along warp and weft, m",
                             (2,)).tolist()
        edge = default_edge(fabric, rig, offset=(warp, weft)) if edge is None else number(
            "edge", edge, "m")
        return Run(fabric, rig, laws, edge, seed, (warp, weft), options)

    def made(
        self, equilibrium: Equilibrium, coarse: Sequence[Status], seconds: float, *,
        keep: bool = False
    ) -> Drape:
        """The drape of this simulation, with its energies and factor only if they are to be kept;
        ``coarse`` are the statuses on coarser meshes, ``seconds`` its wall time."""
        made = Drape(**vars(equilibrium), fabric=self.fabric, rig=self.rig, edge=self.edge,
                     coarse=tuple(coarse), seconds=seconds)
        return made if keep else light(made)

    def scene(self, edge: Metres, grading: float = GRADING, *, soft: bool = False) -> Scene:
        """The specimen, meshed, on its rig."""
        mesh, held = mesh_specimen(self.rig, edge=edge, topology=self.seed % TOPOLOGIES,
                                   offset=self.offset, grading=grading)
        return Scene.on(self.rig, mesh, held, softness=COARSE_CONTACT if soft else 1.0)

    def lowered(self) -> tuple[Equilibrium, list[Status]]:
        """The equilibrium of lowered cloth, as :meth:`settled`. Limp cloth, and cloth without any,
        is lowered on a finer mesh."""
        for mesh in filter(self.is_lowered_on, LOWERING_MESHES):
            scenes = self.lowering_scenes(mesh)
            before = lowered(scenes[0], self.fabric, self.rig, seed=self.seed,
                             laws=self.laws.softened(COARSE_MEMBRANE))
            settled = self.settled(scenes, before=before, smooth=not mesh.limp)
            if settled[0].converged:
                break
        return settled

    def is_lowered_on(self, mesh: LoweringMesh) -> bool:
        """Whether folds of this fabric are wide enough for a mesh of lowering."""
        fold = gravity_length(self.fabric.alpha.min(), self.fabric.density)
        return mesh.limp or mesh.edge <= _EDGES_OF_LIMP * fold

    def lowering_edge(self, mesh: LoweringMesh) -> Metres:
        """Edge length at the rim of a mesh of lowering, at most that for which there is room."""
        return min(max(mesh.edge, self.edge), longest_edge(self.rig, self.offset))

    def lowering_scenes(self, mesh: LoweringMesh) -> list[Scene]:
        """The specimen on ``mesh``, on which it is lowered, and on finer ones to the final one."""
        coarse = self.lowering_edge(mesh)
        finer = self.scenes(_MIDDLE * coarse)
        if mesh.limp:
            # Between meshes limp cloth is strained so much that a stiff membrane tears it away.
            finer.insert(-1, self.scene(self.edge, soft=True))
        return [self.scene(coarse, mesh.grading, soft=True), *finer]

    def failed(self, error: Exception) -> Equilibrium:
        """The flat specimen in place of a drape that was ended by an ``error``."""
        scene = self.scene(self.edge)
        rest = scene.mesh.rest
        state = scene.state(np.column_stack([rest, np.zeros(len(rest))]))
        message = f"{type(error).__name__}: {one_line(error)}"
        return Equilibrium(cloth=Cloth(scene, self.fabric, laws=self.laws), state=state,
                           outcome=NewtonResult(state.q, Status.EXCEPTION, message))

    def scenes(self, coarsest: Metres) -> list[Scene]:
        """The specimen on meshes from ``coarsest`` at most to the final one."""
        return [self.scene(level, soft=level != self.edge)
                for level in coarse_to_fine(self.edge, coarsest)]

    def settled(
        self, scenes: list[Scene], *, before: Equilibrium | None = None, **options: Any
    ) -> tuple[Equilibrium, list[Status]]:
        """The equilibrium in the last of ``scenes``, coarse to fine, and the statuses in those
        before, from cloth that was lowered ``before``, whose hysteresis is kept, or by the other
        ``options`` of :func:`start_positions`."""
        coarse, settled_on = before, []
        for scene in scenes:
            last = scene is scenes[-1]
            laws = with_origins(self.laws, before, scene) if before else self.laws
            positions = start_positions(scene, self.rig, coarse=coarse, **options)
            coarse = find_equilibrium(
                scene, self.fabric, scene.state(positions), self_contact=last,
                laws=laws if last else laws.softened(COARSE_MEMBRANE),
                options=self.options if last else COARSE_OPTIONS).after(coarse)
            settled_on.append(coarse)
        return settled_on[-1], [earlier.searched.status for earlier in settled_on[:-1]]


def start_positions(
    scene: Scene, rig: Rig, *, coarse: Equilibrium | None = None, smooth: bool = True,
    borrowed: Borrowed | None = None, start: str = "sine", seed: int = 0
) -> Points:
    """Initial positions from the ``coarse`` drape, on a ``smooth`` surface or on its triangles; on
    the first mesh, ``borrowed`` or ``start``."""
    rest, held = scene.mesh.rest, scene.held
    if coarse is not None:
        positions = interpolate_positions(coarse.cloth.scene.mesh.rest, coarse.positions, rest,
                                          smooth=smooth)
    elif borrowed is not None:
        positions = borrowed_positions(rest, rig=rig, borrowed=borrowed)
    else:
        rng = np.random.default_rng([seed, 1])
        positions = initial_positions(rest, rig=rig, start=start, rng=rng)
    positions[held] = rig.place(rest[held])
    return positions


def follow(
    near: Drape, fabric: Fabric, *, laws: Laws | None = None, extra: Sequence[Energy] = (),
    options: NewtonOptions | None = None, start: State | None = None, keep: bool = False
) -> Drape:
    """The drape of ``fabric`` near a drape, on its mesh, by a warm start.

    A large change of moduli may lead to other folds, as this is a minimisation, not a continuation
    along a path of equilibria. The initial guess is ``start``, such as
    :meth:`sim.sensitivity.Sensitivities.prediction`, else the state of ``near``, whose laws are the
    default. ``keep`` preserves the drape's energies and factor, for derivatives.
    """
    began = time.perf_counter()
    require(near=(near, Drape), fabric=(fabric, Fabric))
    laws, options = laws or near.laws, options or FINE_OPTIONS
    start = near.state if start is None else start
    require(laws=(laws, Laws), options=(options, NewtonOptions), start=(start, State))
    equilibrium = find_equilibrium(near.scene, fabric, start, laws=laws, extra=extra,
                                   options=options, self_contact=True, touching=near.touches)
    made = Drape(**vars(equilibrium), fabric=fabric, rig=near.rig, edge=near.edge,
                 seconds=time.perf_counter() - began)
    return made if keep else light(made)
