"""The public door of the simulator: fabric, rig and start in, drape out."""

import time
from collections import Counter
from dataclasses import dataclass

import numpy as np

from common.errors import InputError
from sim.equilibrium import find_equilibrium
from sim.initial import (
    borrowed_positions,
    check_start,
    initial_positions,
    interpolate_positions,
)
from sim.lagged import find_settled_equilibrium
from sim.laws import Laws
from sim.material import REFERENCE_DENSITY, Fabric
from sim.mesh.specimens import (
    BORROWED_COARSEST,
    COARSEST,
    TOPOLOGIES,
    Specimen,
    coarse_to_fine,
    default_edge,
    make_specimen,
)
from sim.newton import NewtonOptions, NewtonResult, Status
from sim.scene import CONTACT_PRESSURE, Rig, Scene, State
from sim.self_contact import find_free_equilibrium, self_intersections

COARSE_MEMBRANE = 0.03
"""Membrane stiffness on the coarser meshes, relative to the final one. In-plane stiffness hardly
matters for the shape but limits the length of Newton's steps (docs/physics.md)."""
COARSE_CONTACT = 0.003
"""The same for the obstacles' pressure: most steps of falling cloth would end in the cylinder."""
COARSE_OPTIONS = NewtonOptions(residual=1e-2, step=0.1, max_iterations=200)
FINE_OPTIONS = NewtonOptions(residual=1e-4, step=1e-4, max_iterations=400)


@dataclass(frozen=True)
class DrapeResult:
    """A draped specimen, or how far it came.

    Attributes:
        fabric, rig: what was asked for.
        positions: (V, 3) m; origin and axes as :class:`sim.scene.Rig` says, z up.
        rotations: (E,) rad, edge rotations of the bending law.
        rest: (V, 2) m, warp along +x, weft along +y, origin on the plate's axis, without a
            plate at the specimen's centre.
        faces: (F, 3) int64, counter-clockwise seen from above at rest.
        held: (V,) bool, vertices that the rig holds.
        edge: length of the mesh's edges at the plate's rim, m; without a plate of all edges.
        status, message: how it ended, in one word and in a sentence.
        residual: largest force residual, in units of a vertex's weight.
        step: last Newton step, mm.
        positive_definite: whether the exact Hessian is, so that the state is a minimum.
        self_intersections: places where an edge passes through a triangle; 0 when converged.
        iterations: Newton steps on all meshes together.
        seconds: wall time.
        time_spent: seconds of all minimisations by activity (see :class:`NewtonResult`).
    """

    fabric: Fabric
    rig: Rig
    positions: np.ndarray
    rotations: np.ndarray
    rest: np.ndarray
    faces: np.ndarray
    held: np.ndarray
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

    @property
    def converged(self) -> bool:
        """Whether this is a proven equilibrium."""
        return self.status is Status.CONVERGED


def drape(
    fabric: Fabric,
    *,
    rig: Rig | None = None,
    edge: float | None = None,
    start: str = "sine",
    borrowed: tuple[np.ndarray, np.ndarray] | None = None,
    seed: int = 0,
    offset: tuple[float, float] = (0.0, 0.0),
    laws: Laws | None = None,
    options: NewtonOptions | None = None,
) -> DrapeResult:
    """Drape ``fabric`` on ``rig``, coarse mesh first.

    The shape depends on moduli/density only (section 5.1.2), so the fabric is simulated at the
    reference density; its own density changes nothing.

    Args:
        rig: what holds the specimen; None for the square on its cylinder.
        edge: length of the final mesh's edges at the plate's rim, m; None chooses it, see
            :func:`sim.mesh.specimens.default_edge`.
        start: initial shape, see :data:`sim.initial.STARTS`.
        borrowed: rest (W, 2) and positions (W, 3), m, of another fabric's drape on the same rig
            to start from, in place of ``start``; on a mesh fine enough for its folds.
        seed: of the initial shape; it chooses the triangulation among
            :data:`sim.mesh.specimens.TOPOLOGIES`, too.
        offset: (2,) m, specimen's centre from the plate's axis, along warp and weft.
        laws: of bending, membrane and energies of your own; made anew on every mesh.
        options: of the final minimisation.

    Returns:
        The drape; look at its ``status``, a numerical failure raises nothing.

    Raises:
        InputError: parameters that make no sense.
    """
    rig, laws = rig or Rig(), laws or Laws()
    check_setting(rig, laws)
    edge = default_edge(fabric, rig) if edge is None else edge
    check_start(start)
    if not np.isfinite(offset).all():
        raise InputError("offset must be two finite numbers, in metres")
    check_seed(seed)
    began = time.perf_counter()
    simulated = fabric.at_density(REFERENCE_DENSITY)
    levels = coarse_to_fine(edge, COARSEST if borrowed is None else BORROWED_COARSEST)
    iterations, coarse, time_spent = 0, None, Counter()
    for level in levels:
        last = level == edge
        try:
            specimen = make_specimen(rig, edge=level, topology=seed % TOPOLOGIES, offset=offset)
        except InputError:
            # A narrow overhang may be too narrow for a coarse mesh alone.
            if last:
                raise
            continue
        positions = start_positions(
            specimen, rig, coarse=coarse, borrowed=borrowed, start=start, seed=seed
        )
        state, result, _ = find_settled_equilibrium(
            scene_on(specimen, rig, last=last),
            simulated,
            State.at(specimen.mesh, positions),
            laws=laws if last else laws.softened(COARSE_MEMBRANE),
            options=(options or FINE_OPTIONS) if last else COARSE_OPTIONS,
            find=find_free_equilibrium if last else find_equilibrium,
        )
        iterations += result.iterations
        time_spent.update(result.seconds)
        coarse = (specimen.mesh.rest, state.positions)
    return drape_result(
        fabric,
        rig,
        specimen,
        state,
        result,
        edge=edge,
        iterations=iterations,
        seconds=time.perf_counter() - began,
        time_spent=dict(time_spent),
    )


def check_setting(rig: object, laws: object) -> None:
    """InputError for what is no rig or no laws, such as the name of one."""
    if not isinstance(rig, Rig):
        raise InputError(f"rig={rig!r}: give a sim.scene.Rig, such as "
                         f"Rig.from_name('{Rig().name}')")
    if not isinstance(laws, Laws):
        raise InputError(f"laws={laws!r}: give a sim.laws.Laws, such as "
                         f"Laws(bending='{Laws().bending}')")


def check_seed(seed: int) -> None:
    """InputError for what seeds no random numbers."""
    if seed < 0:
        raise InputError(f"seed={seed} must not be negative")


def start_positions(
    specimen: Specimen,
    rig: Rig,
    *,
    coarse: tuple[np.ndarray, np.ndarray] | None,
    borrowed: tuple[np.ndarray, np.ndarray] | None = None,
    start: str,
    seed: int,
) -> np.ndarray:
    """Positions (V, 3), m, at which the minimisation on one mesh begins.

    Args:
        coarse: rest points and positions of the coarser drape, None on the first mesh.
        borrowed, start, seed: as for :func:`drape`, for the first mesh.
    """
    rest, held = specimen.mesh.rest, specimen.held
    if coarse is not None:
        positions = interpolate_positions(*coarse, rest)
    elif borrowed is not None:
        positions = borrowed_positions(rest, rig=rig, borrowed=borrowed)
    else:
        rng = np.random.default_rng([seed, 1])
        positions = initial_positions(rest, rig=rig, start=start, rng=rng)
    positions[held] = rig.place(rest[held])
    return positions


def scene_on(specimen: Specimen, rig: Rig, *, last: bool) -> Scene:
    """A specimen on ``rig``, on the last mesh or on a coarser one, where obstacles are soft."""
    return Scene(
        mesh=specimen.mesh,
        held=specimen.held,
        obstacles=rig.obstacles,
        contact_pressure=CONTACT_PRESSURE * (1.0 if last else COARSE_CONTACT),
    )


def drape_result(
    fabric: Fabric,
    rig: Rig,
    specimen: Specimen,
    state: State,
    result: NewtonResult,
    *,
    edge: float,
    iterations: int,
    seconds: float,
    time_spent: dict[str, float],
) -> DrapeResult:
    """The drape whose last minimisation ended with ``state`` and ``result``."""
    return DrapeResult(
        fabric=fabric,
        rig=rig,
        positions=state.positions,
        rotations=state.rotations,
        rest=specimen.mesh.rest,
        faces=specimen.mesh.faces,
        held=specimen.held,
        edge=edge,
        status=result.status,
        message=result.message,
        residual=result.residual,
        step=result.step,
        positive_definite=result.positive_definite,
        self_intersections=len(self_intersections(state.positions, specimen.mesh.faces)),
        iterations=iterations,
        seconds=seconds,
        time_spent=time_spent,
    )
