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
from sim.mesh import check_resolution
from sim.newton import NewtonOptions, NewtonResult, Status
from sim.scene import CONTACT_PRESSURE, GRAVITY, Rig, Scene, State
from sim.self_contact import find_free_equilibrium, self_intersections
from sim.specimens import Specimen, make_specimen

COARSEST = 16  # fewest vertices a side that a drape is started on
BORROWED_COARSEST = 24  # the same for a borrowed drape, whose folds have to survive
COARSE_MEMBRANE = 0.03
"""Membrane stiffness on the coarser meshes, relative to the final one. In-plane stiffness hardly
matters for the shape but limits the length of Newton's steps (docs/physics.md)."""
COARSE_CONTACT = 0.003
"""The same for the obstacles' pressure: most steps of falling cloth would end in the cylinder."""
LENGTHS_PER_SPACING = 0.6
"""Mesh spacing over the bending length of the softest direction, when the mesh is chosen."""
_CHOSEN = (41, 101)  # vertices a side: fewest, for folds and rim; most, for the time
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
        diagonals: (n-1, n-1) bool; ``faces == sim.mesh.grid_faces(diagonals)``; None where the
            mesh is no grid.
        held: (V,) bool, vertices that the rig holds.
        resolution: vertices a side, or across a disc.
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
    diagonals: np.ndarray | None
    held: np.ndarray
    resolution: int
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
    resolution: int | None = None,
    start: str = "sine",
    borrowed: tuple[np.ndarray, np.ndarray] | None = None,
    seed: int = 0,
    offset: tuple[float, float] = (0.0, 0.0),
    mesh: str = "perturbed",
    jitter: float = 0.15,
    diagonals: str | None = None,
    laws: Laws | None = None,
    options: NewtonOptions | None = None,
) -> DrapeResult:
    """Drape ``fabric`` on ``rig``, coarse mesh first.

    The shape depends on moduli/density only (section 5.1.2), so the fabric is simulated at the
    reference density; its own density changes nothing.

    Args:
        rig: what holds the specimen; None for the square on its cylinder.
        resolution: vertices a side, or across a disc, of the final mesh, within
            :data:`sim.mesh.RESOLUTIONS`; None chooses it, see :func:`default_resolution`.
        start: initial shape, see :data:`sim.initial.STARTS`.
        borrowed: rest (W, 2) and positions (W, 3), m, of another fabric's drape on the same rig
            to start from, in place of ``start``; on a mesh fine enough for its folds.
        seed: of the initial shape and of the triangulation.
        offset: (2,) m, specimen's centre from the plate's axis, along warp and weft.
        mesh, jitter, diagonals: kind of triangulation, see :func:`sim.specimens.make_specimen`.
        laws: of bending, membrane and energies of your own; made anew on every mesh.
        options: of the final minimisation.

    Returns:
        The drape; look at its ``status``, a numerical failure raises nothing.

    Raises:
        InputError: parameters that make no sense.
    """
    rig, laws = rig or Rig(), laws or Laws()
    check_setting(rig, laws)
    resolution = resolution or default_resolution(fabric, rig)
    check_resolution(resolution)
    check_start(start)
    if not np.isfinite(offset).all():
        raise InputError("offset must be two finite numbers, in metres")
    check_seed(seed)
    if not 0 <= jitter <= 0.3:
        raise InputError(f"jitter={jitter}: give a fraction of the spacing between 0 and 0.3")
    began = time.perf_counter()
    simulated = fabric.at_density(REFERENCE_DENSITY)
    levels = coarse_to_fine(resolution, COARSEST if borrowed is None else BORROWED_COARSEST)
    iterations, coarse, time_spent = 0, None, Counter()
    for level in levels:
        last = level == resolution
        try:
            specimen = make_specimen(
                rig,
                mesh=mesh,
                resolution=level,
                offset=offset,
                jitter=jitter,
                diagonals=diagonals,
                seed=seed,
            )
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
        resolution=resolution,
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
    resolution: int,
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
        diagonals=specimen.diagonals,
        held=specimen.held,
        resolution=resolution,
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


def default_resolution(fabric: Fabric, rig: Rig) -> int:
    """Vertices a side so that the spacing follows the fabric's bending length (alpha/rho g)^⅓.

    Softer cloth makes narrower folds. ``LENGTHS_PER_SPACING`` of the softest direction's bending
    length, within ``_CHOSEN``.
    """
    length = np.cbrt(fabric.alpha.min() / (fabric.density * GRAVITY))
    cells = rig.specimen_size / (LENGTHS_PER_SPACING * length)
    return int(np.clip(np.ceil(cells) + 1, *_CHOSEN))


def coarse_to_fine(resolution: int, coarsest: int = COARSEST) -> list[int]:
    """Vertices a side of the meshes a drape is solved on; the spacing halves each time.

    None but the last has fewer than ``coarsest``.
    """
    levels = [resolution]
    while (levels[0] - 1) // 2 + 1 >= coarsest:
        levels.insert(0, (levels[0] - 1) // 2 + 1)
    return levels
