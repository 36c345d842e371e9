"""The public door of the simulator: fabric, rig and start in, drape out."""

import time
from collections import Counter
from dataclasses import dataclass

import numpy as np

from sim.equilibrium import find_equilibrium
from sim.errors import InputError
from sim.initial import initial_positions, interpolate_positions
from sim.laws import Laws
from sim.material import REFERENCE_DENSITY, Fabric
from sim.mesh import draped_square
from sim.newton import NewtonOptions, Status
from sim.scene import Rig, Scene, State

COARSEST = 16  # fewest vertices a side that a drape is started on
COARSE_MEMBRANE = 0.1
"""Membrane stiffness on the coarser meshes, relative to the final one. In-plane stiffness hardly
matters for the shape but limits the length of Newton's steps: soft fabrics take half the time."""
_COARSE = NewtonOptions(residual=1e-2, step=0.1, max_iterations=200)
_FINE = NewtonOptions(residual=1e-4, step=1e-4, max_iterations=400)


@dataclass(frozen=True)
class DrapeResult:
    """A draped specimen, or how far it came.

    Attributes:
        fabric, rig: what was asked for.
        positions: (V, 3) m; origin at the centre of the plate's top face, z up.
        rotations: (E,) rad, edge rotations of the bending law.
        rest: (V, 2) m, warp along +x, weft along +y, origin on the plate's axis.
        faces: (F, 3) int64, counter-clockwise seen from above at rest.
        diagonals: (n-1, n-1) bool; ``faces == sim.mesh.grid_faces(diagonals)``.
        held: (V,) bool, vertices on the plate.
        status, message: how it ended, in one word and in a sentence.
        residual: largest force residual, in units of a vertex's weight.
        step: last Newton step, mm.
        positive_definite: whether the exact Hessian is, so that the state is a minimum.
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
    diagonals: np.ndarray
    held: np.ndarray
    status: Status
    message: str
    residual: float
    step: float
    positive_definite: bool
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
    resolution: int = 51,
    start: str = "sine",
    seed: int = 0,
    offset: tuple[float, float] = (0.0, 0.0),
    jitter: float = 0.15,
    diagonals: str = "random",
    laws: Laws | None = None,
    options: NewtonOptions | None = None,
) -> DrapeResult:
    """Drape ``fabric`` on ``rig``, coarse mesh first.

    The shape depends on moduli/density only (section 5.1.2), so the fabric is simulated at the
    reference density; its own density changes nothing.

    Args:
        resolution: vertices a side of the final mesh.
        start: initial shape, see :mod:`sim.initial`.
        seed: of the initial shape and of the triangulation.
        offset: (2,) m, specimen's centre from the plate's axis, along warp and weft.
        jitter: random displacement of rest vertices, as a fraction of the spacing.
        diagonals: kind of triangulation, see :data:`sim.mesh.DIAGONALS`.
        laws: of bending and membrane.
        options: of the final minimisation.

    Returns:
        The drape; look at its ``status``, a numerical failure raises nothing.

    Raises:
        InputError: parameters that make no sense.
    """
    rig = rig or Rig()
    if not np.isfinite(offset).all():
        raise InputError("offset must be two finite numbers, in metres")
    if not 0 <= jitter <= 0.3:
        raise InputError(f"jitter={jitter}: give a fraction of the spacing between 0 and 0.3")
    began = time.perf_counter()
    simulated = fabric.at_density(REFERENCE_DENSITY)
    laws = laws or Laws()
    levels = coarse_to_fine(resolution)
    iterations, coarse, time_spent = 0, None, Counter()
    for level in levels:
        last = level == resolution
        mesh, held, cells = draped_square(
            size=rig.specimen_size,
            plate_radius=rig.plate_radius,
            resolution=level,
            offset=offset,
            diagonals=diagonals,
            jitter=jitter,
            seed=seed,
        )
        if coarse is None:
            rng = np.random.default_rng([seed, 1])
            positions = initial_positions(mesh.rest, rig=rig, start=start, rng=rng)
        else:
            positions = interpolate_positions(*coarse, mesh.rest)
        positions[held] = np.column_stack([mesh.rest[held], np.zeros(held.sum())])
        scene = Scene(mesh=mesh, held=held, cylinder_radius=rig.plate_radius)
        state, result = find_equilibrium(
            scene,
            simulated,
            State.at(mesh, positions),
            laws=laws if last else laws.softened(COARSE_MEMBRANE),
            options=(options or _FINE) if last else _COARSE,
        )
        iterations += result.iterations
        time_spent.update(result.seconds)
        coarse = (mesh.rest, state.positions)
    return DrapeResult(
        fabric=fabric,
        rig=rig,
        positions=state.positions,
        rotations=state.rotations,
        rest=mesh.rest,
        faces=mesh.faces,
        diagonals=cells,
        held=held,
        status=result.status,
        message=result.message,
        residual=result.residual,
        step=result.step,
        positive_definite=result.positive_definite,
        iterations=iterations,
        seconds=time.perf_counter() - began,
        time_spent=dict(time_spent),
    )


def coarse_to_fine(resolution: int) -> list[int]:
    """Vertices a side of the meshes a drape is solved on; the spacing halves each time."""
    levels = [resolution]
    while (levels[0] - 1) // 2 + 1 >= COARSEST:
        levels.insert(0, (levels[0] - 1) // 2 + 1)
    return levels
