"""The virtual cantilever tester: strips cut at any angle hang from a clamp."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from common.errors import InputError
from sim.cantilever.guide import GuidedSides
from sim.energies.base import Energy
from sim.equilibrium import find_equilibrium
from sim.laws import Laws
from sim.material import DIRECTIONS, REFERENCE_DENSITY, Fabric
from sim.mesh import Mesh, strip
from sim.newton import NewtonOptions, NewtonResult, Status
from sim.scene import GRAVITY, Scene, State

GUIDE = 100.0
"""Stiffness of a guide's ties in units of alpha/edge²; the rulings are then level to 1e-4."""

ANGLES = dict(zip(DIRECTIONS, (0.0, np.pi / 4, np.pi / 2), strict=True))
CELLS = 20
"""Along the bending length of a simulated strip's direction; alpha is then right to 1 %."""

CELLS_ACROSS = 10


@dataclass(frozen=True)
class HungStrip:
    """A strip in equilibrium.

    Attributes:
        curve: (N, 2) m, reach and drop from the clamp's edge to the free end, each point the
            mean across the strip.
        twist: slope of the free end across the strip, radians.
        result: the solver's; the shape counts only if its status is CONVERGED.
    """

    curve: np.ndarray
    twist: float
    result: NewtonResult


def hang(
    fabric: Fabric,
    *,
    angle: float = 0.0,
    slope: float = 0.0,
    length: float = 0.09,
    width: float = 0.03,
    edge: float = 0.003,
    across: int | None = None,
    guided: bool = False,
    laws: Laws | None = None,
    gravity: float = GRAVITY,
    **triangulation,
) -> HungStrip:
    """Let a strip hang from a clamp.

    Args:
        fabric: of which the moduli over density matter.
        angle: of the strip to the warp, radians; pi/4 is the bias, pi/2 the weft.
        slope: of the clamp below the horizontal, radians.
        length, width, edge: free length, width and mesh spacing, m.
        across: mesh cells across the strip; None makes them square.
        guided: keep the rulings level, see :mod:`sim.cantilever.guide`; a real strip is free.
        laws: of bending and membrane.
        gravity: m/s²; tiny values give the small deflections of plate theory.
        triangulation: diagonals, jitter and seed of :func:`sim.mesh.strip`.

    Raises:
        InputError: the mesh has less than two cells along or one across, or a guided strip's
            mesh is jittered.
    """
    across = round(width / edge) if across is None else across
    if length < 2 * edge or across < 1:
        raise InputError("a strip needs two mesh cells along it and one across")
    if guided and triangulation.get("jitter"):
        raise InputError("a guided strip needs a regular mesh: jitter=0")
    cut, held = strip(
        length=length, width=across * edge, edge=edge, clamp=2 * edge, **triangulation
    )
    x, y = (cut.rest * [1.0, width / (across * edge)]).T
    cos, sin = np.cos(angle), np.sin(angle)
    mesh = Mesh(rest=np.column_stack([cos * x - sin * y, sin * x + cos * y]), faces=cut.faces)
    flat = np.column_stack([x * np.cos(slope), y, -x * np.sin(slope)])
    fabric = fabric.at_density(REFERENCE_DENSITY)
    extra = []
    if guided:
        stiffness = GUIDE * float(fabric.alpha.max()) / edge**2
        extra = [GuidedSides(mesh, across=across + 1, stiffness=stiffness, edge=edge)]
    state, result = hang_mesh(
        mesh, held, fabric, State.at(mesh, flat), laws=laws, gravity=gravity, extra=extra
    )
    columns = state.positions.reshape(-1, across + 1, 3)
    free = columns[np.count_nonzero(held) // (across + 1) - 1 :]
    side = free[-1, -1] - free[-1, 0]
    return HungStrip(
        curve=free.mean(axis=1)[:, [0, 2]] * [1.0, -1.0],
        twist=float(np.arctan2(side[2], side[1])),
        result=result,
    )


def hang_mesh(
    mesh: Mesh, held: np.ndarray, fabric: Fabric, start: State, *, laws: Laws | None = None,
    gravity: float = GRAVITY, extra: Sequence[Energy] = (),
) -> tuple[State, NewtonResult]:
    """Equilibrium, next to ``start``, of a mesh whose ``held`` (V,) vertices are clamped."""
    return find_equilibrium(
        Scene(mesh=mesh, held=held, gravity=gravity), fabric, start, laws=laws, extra=extra,
        options=NewtonOptions(residual=1e-6, step=1e-6),
    )


def simulate_strips(
    fabric: Fabric, lengths: Mapping[str, Sequence[float]], *, width: float = 0.03,
    cells: int = CELLS, guided: bool = False, seed: int = 0, **options,
) -> dict[str, list[np.ndarray]]:
    """Curves (N, 2), m, of simulated strips of ``lengths`` (m) by direction.

    Args:
        width: m, of free strips. Guided ones are cylinders: three cells across them are enough.
        cells: along the bending length of the strip's direction.
        seed: of the triangulation.
        options: slope, laws and gravity of :func:`hang`.

    Raises:
        InputError: a strip does not reach equilibrium.
    """
    strips: dict[str, list[np.ndarray]] = {}
    for direction, each in lengths.items():
        alpha = fabric.alpha[DIRECTIONS.index(direction)]
        spacing = bending_length(alpha, fabric.density) / cells
        for length in each:
            edge = length / np.ceil(length / spacing)
            hung = hang(
                fabric, angle=ANGLES[direction], length=length, edge=edge,
                width=3 * edge if guided else width, across=3 if guided else CELLS_ACROSS,
                diagonals="random", seed=seed, guided=guided, **options,
            )
            if hung.result.status is not Status.CONVERGED:
                raise InputError(
                    f"the simulated {direction} strip of {1e3 * length:.0f} mm does not settle: "
                    f"{hung.result.message}"
                )
            strips.setdefault(direction, []).append(hung.curve)
    return strips


def bending_length(alpha: float, density: float) -> float:
    """(alpha/rho g)^(1/3), m, of a modulus N·m and a density kg/m².

    Strips of 1.5 and 2.5 of it, which fall 0.4 and 1.5 times as far as they reach if the law is
    linear, determine alpha and beta well.
    """
    return float((alpha / (density * GRAVITY)) ** (1 / 3))


def fabric_of_gamma(gamma: float, length: float) -> Fabric:
    """Isotropic linear fabric whose strip of ``length`` (m) has rho g L³/alpha = ``gamma``."""
    alpha = REFERENCE_DENSITY * GRAVITY * length**3 / gamma
    return Fabric(alpha=np.full(3, alpha))
