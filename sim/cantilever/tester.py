"""Virtual cantilever tester: simulation of clamped strips cut at any angle."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from common.errors import InputError
from sim.equilibrium import find_equilibrium
from sim.laws import Laws
from sim.material import DIRECTIONS, REFERENCE_DENSITY, Fabric
from sim.mesh import Mesh, strip
from sim.rig import GRAVITY
from sim.scene import Scene
from sim.solver.newton import NewtonOptions, NewtonResult, Status

ANGLES = dict(zip(DIRECTIONS, (0.0, np.pi / 4, np.pi / 2), strict=True))
TIGHT = NewtonOptions(residual=1e-6, step=1e-6)
CELLS, CELLS_ACROSS = 20, 10
"""Mesh cells along the bending length of a strip's direction, and across it; the error of alpha is
then 1 %."""


@dataclass(frozen=True)
class HungStrip:
    """Deflection curve (N, 2), m, averaged across a strip, and twist of its free end, rad. Valid
    only if the result's status is CONVERGED."""

    curve: np.ndarray
    twist: float
    result: NewtonResult


def hang(
    fabric: Fabric, *, angle: float = 0.0, slope: float = 0.0, length: float = 0.09,
    width: float = 0.03, edge: float = 0.003, across: int | None = None,
    laws: Laws | None = None, gravity: float = GRAVITY, **triangulation,
) -> HungStrip:
    """Simulate a strip that hangs from a clamp.

    Args:
        fabric: only its moduli over density matter.
        angle: from the warp to the strip, radians; pi/4 is the bias, pi/2 the weft.
        length, width, edge: free length, width and mesh spacing, m.
        across: mesh cells across the strip; None makes them square.
        gravity: m/s²; very small values give the small deflections of plate theory.
        triangulation: diagonals, jitter and seed of :func:`sim.mesh.strip`.
    """
    across = round(width / edge) if across is None else across
    if length < 2 * edge or across < 1:
        raise InputError("a strip needs two mesh cells along it and one across")
    cut, held = strip(length=length, width=across * edge, edge=edge, clamp=2 * edge,
                      **triangulation)
    x, y = (cut.rest * [1.0, width / (across * edge)]).T
    cos, sin = np.cos(angle), np.sin(angle)
    mesh = Mesh(rest=np.column_stack([cos * x - sin * y, sin * x + cos * y]), faces=cut.faces)
    flat = np.column_stack([x * np.cos(slope), y, -x * np.sin(slope)])
    fabric = fabric.at_density(REFERENCE_DENSITY)
    scene = Scene(mesh=mesh, held=held, gravity=gravity)
    found = find_equilibrium(scene, fabric, scene.state(flat), laws=laws, options=TIGHT)
    state = found.state
    columns = state.positions.reshape(-1, across + 1, 3)[:, :, [0, 2]] * [1.0, -1.0]
    curve = columns[np.count_nonzero(held) // (across + 1) - 1 :].mean(axis=1)
    side = state.positions[-1] - state.positions[-1 - across]
    return HungStrip(curve=curve, twist=float(np.arctan2(side[2], side[1])), result=found.newton)


def simulate_strips(
    fabric: Fabric, lengths: Mapping[str, Sequence[float]], *, width: float | None = 0.03,
    cells: int = CELLS, across: int = CELLS_ACROSS, **options,
) -> dict[str, list[np.ndarray]]:
    """Curves (N, 2), m, of simulated strips of ``lengths`` (m) by direction.

    Args:
        width: m; None for square mesh cells.
        cells, across: mesh cells along the bending length and across the strip.
        options: further arguments of :func:`hang`, such as the seed of the triangulation.

    Raises:
        InputError: a strip does not reach equilibrium.
    """
    strips: dict[str, list[np.ndarray]] = {direction: [] for direction in lengths}
    for direction, length in ((d, length) for d, each in lengths.items() for length in each):
        alpha = fabric.alpha[DIRECTIONS.index(direction)]
        count = length * cells / bending_length(alpha, fabric.density)
        edge = length / np.ceil(count - 1e-9)  # an integer may have been rounded up
        hung = hang(fabric, angle=ANGLES[direction], length=length, edge=edge, across=across,
                    width=across * edge if width is None else width, diagonals="random",
                    **options)
        if hung.result.status is not Status.CONVERGED:
            raise InputError(f"the simulated {direction} strip of {1e3 * length:.0f} mm does not "
                             f"come to rest: {hung.result.message}")
        strips[direction].append(hung.curve)
    return strips


def bending_length(alpha: float, density: float) -> float:
    """Bending length (alpha/rho g)^(1/3), m, of a modulus in N·m and a density in kg/m².

    Strips of 1.5 and 2.5 bending lengths, whose drop is 0.4 and 1.5 times their reach for a linear
    law, determine alpha and beta well.
    """
    return float((alpha / (density * GRAVITY)) ** (1 / 3))


def fabric_of_gamma(gamma: float, length: float) -> Fabric:
    """Isotropic linear fabric whose strip of ``length`` (m) has rho g L³/alpha = ``gamma``."""
    return Fabric(alpha=np.full(3, REFERENCE_DENSITY * GRAVITY * length**3 / gamma))
