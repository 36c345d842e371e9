"""The virtual cantilever tester: strips cut at any angle hang from a clamp."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from common.errors import InputError
from sim.energies.base import Energy
from sim.equilibrium import find_equilibrium
from sim.laws import Laws
from sim.material import DIRECTIONS, REFERENCE_DENSITY, Fabric
from sim.mesh import Mesh, strip
from sim.newton import NewtonOptions, NewtonResult, Status
from sim.scene import GRAVITY, Scene, State

ANGLES = dict(zip(DIRECTIONS, (0.0, np.pi / 4, np.pi / 2), strict=True))
TIGHT = NewtonOptions(residual=1e-6, step=1e-6)
CELLS, CELLS_ACROSS = 20, 10
"""Of simulated strips, along the bending length of their direction and across them; alpha is then
right to 1 %."""
GUIDE = 100.0
"""Stiffness of a guide's ties in units of alpha/edge²; the rulings are then level to 1e-4."""


@dataclass(frozen=True)
class HungStrip:
    """Deflection curve (N, 2), m, the mean across a strip, and slope of its free end across, rad.

    The shape counts only if the result's status is CONVERGED.
    """

    curve: np.ndarray
    twist: float
    result: NewtonResult


def hang(
    fabric: Fabric, *, angle: float = 0.0, slope: float = 0.0, length: float = 0.09,
    width: float = 0.03, edge: float = 0.003, across: int | None = None, guided: bool = False,
    laws: Laws | None = None, gravity: float = GRAVITY, **triangulation,
) -> HungStrip:
    """Let a strip hang from a clamp.

    Args:
        fabric: of which the moduli over density matter.
        angle: of the strip to the warp, radians; pi/4 is the bias, pi/2 the weft.
        length, width, edge: free length, width and mesh spacing, m.
        across: mesh cells across the strip; None makes them square.
        guided: keep the rulings level, see :class:`GuidedSides`; a real strip is free.
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
    state, result = find_equilibrium(
        Scene(mesh=mesh, held=held, gravity=gravity), fabric, State.at(mesh, flat),
        laws=laws, extra=extra, options=TIGHT,
    )
    columns = state.positions.reshape(-1, across + 1, 3)[:, :, [0, 2]] * [1.0, -1.0]
    curve = columns[np.count_nonzero(held) // (across + 1) - 1 :].mean(axis=1)
    side = state.positions[-1] - state.positions[-1 - across]
    return HungStrip(curve=curve, twist=float(np.arctan2(side[2], side[1])), result=result)


class GuidedSides(Energy):
    """Penalty on whatever is not a cylinder across the strip: the bending of an endlessly wide one.

    A strip cut off the yarn directions twists when it bends, and one with a Poisson effect
    curves across. Held to a cylinder it carries the law's torque for the cut's direction. The
    guide ties each vertex to its neighbour across the strip, along x and z, and stops the cloth
    at the sides from turning about them.

    Args:
        mesh: a strip's grid of ``across`` vertices in a column, numbered column by column.
        stiffness, edge: N/m of each tie, and times the spacing (m) squared, N·m of the sides.
    """

    def __init__(self, mesh: Mesh, *, across: int, stiffness: float, edge: float) -> None:
        vertices = len(mesh.rest)
        grid = np.arange(vertices).reshape(-1, across)
        neighbours = np.stack([grid[:, :-1], grid[:, 1:]], axis=-1).reshape(-1, 2)
        ties = np.concatenate([3 * neighbours, 3 * neighbours + 2])
        row = mesh.edges % across
        border = (mesh.edge_faces[:, 1] < 0) & (row[:, 0] == row[:, 1])
        sides = 3 * vertices + np.flatnonzero(border)
        stops = np.stack([sides, np.full(len(sides), -1)], axis=1)
        self.dofs = np.concatenate([ties, stops])
        self._signs = np.where(self.dofs >= 0, [1.0, -1.0], 0.0)
        self._stiffness = np.repeat([stiffness, stiffness * edge**2], [len(ties), len(stops)])

    def _differences(self, q: np.ndarray) -> np.ndarray:
        return (self._signs * q[self.dofs]).sum(axis=1)

    def value(self, q: np.ndarray) -> float:
        return float(0.5 * self._stiffness @ self._differences(q) ** 2)

    def gradient(self, q: np.ndarray) -> np.ndarray:
        return (self._stiffness * self._differences(q))[:, None] * self._signs

    def hessian(self, q: np.ndarray, convex: bool = False) -> np.ndarray:
        return np.einsum("n,ni,nj->nij", self._stiffness, self._signs, self._signs)


def simulate_strips(
    fabric: Fabric, lengths: Mapping[str, Sequence[float]], *, width: float = 0.03,
    cells: int = CELLS, guided: bool = False, **options,
) -> dict[str, list[np.ndarray]]:
    """Curves (N, 2), m, of simulated strips of ``lengths`` (m) by direction.

    Args:
        width: m, of free strips. Guided ones are cylinders: three cells across them are enough.
        cells: along the bending length of the strip's direction.
        options: others of :func:`hang`, such as the seed of the triangulation.

    Raises:
        InputError: a strip does not reach equilibrium.
    """
    strips: dict[str, list[np.ndarray]] = {direction: [] for direction in lengths}
    for direction, length in ((d, length) for d, each in lengths.items() for length in each):
        alpha = fabric.alpha[DIRECTIONS.index(direction)]
        count = length * cells / bending_length(alpha, fabric.density)
        edge = length / np.ceil(count - 1e-9)  # a whole number may have been rounded up
        hung = hang(
            fabric, angle=ANGLES[direction], length=length, edge=edge, guided=guided,
            width=3 * edge if guided else width, across=3 if guided else CELLS_ACROSS,
            diagonals="random", **options,
        )
        if hung.result.status is not Status.CONVERGED:
            raise InputError(f"the simulated {direction} strip of {1e3 * length:.0f} mm does not "
                             f"settle: {hung.result.message}")
        strips[direction].append(hung.curve)
    return strips


def bending_length(alpha: float, density: float) -> float:
    """(alpha/rho g)^(1/3), m, of a modulus N·m and a density kg/m².

    Strips of 1.5 and 2.5 of it, which fall 0.4 and 1.5 times as far as they reach if the law is
    linear, determine alpha and beta well.
    """
    return float((alpha / (density * GRAVITY)) ** (1 / 3))


def fabric_of_gamma(gamma: float, length: float) -> Fabric:
    """Isotropic linear fabric whose strip of ``length`` (m) has rho g L³/alpha = ``gamma``."""
    return Fabric(alpha=np.full(3, REFERENCE_DENSITY * GRAVITY * length**3 / gamma))
