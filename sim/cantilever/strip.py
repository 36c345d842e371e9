"""The virtual cantilever tester of strips."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from common.errors import InputError
from common.types import DeflectionCurve, Metres, Radians
from sim.cloth import Laws
from sim.equilibrium import find_equilibrium
from sim.material import DIRECTIONS, REFERENCE_DENSITY, Fabric, gravity_length
from sim.mesh import Mesh, strip
from sim.rig import GRAVITY
from sim.scene import Scene
from sim.solver.newton import NewtonOptions, NewtonResult, Status

ANGLES = dict(zip(DIRECTIONS, (0.0, np.pi / 4, np.pi / 2), strict=True))
TIGHT = NewtonOptions(residual=1e-6, step=1e-6)
CELLS, CELLS_ACROSS = 20, 10
"""Mesh cells along the gravity length of a strip's direction, and across it; the error of alpha is
then 1 %."""


@dataclass(frozen=True)
class HungStrip:
    """Deflection curve, averaged across a strip, and twist of its free end."""

    curve: DeflectionCurve
    twist: Radians
    result: NewtonResult

    @property
    def converged(self) -> bool:
        """Whether it hangs at rest; otherwise its curve is not valid."""
        return self.result.status is Status.CONVERGED


def hang(
    fabric: Fabric, *, angle: Radians = 0.0, slope: Radians = 0.0, length: Metres = 0.09,
    width: Metres = 0.03, edge: Metres = 0.003, across: int | None = None,
    laws: Laws | None = None, gravity: float = GRAVITY, **triangulation,
) -> HungStrip:
    """Simulate a strip that hangs from a clamp, cut at an ``angle`` from the warp.

    Cells are square unless their number ``across`` the strip is given; ``triangulation`` is that of
    :func:`sim.mesh.strip`. A very small ``gravity``, m/s², gives the deflections of plate theory.
    """
    across = round(width / edge) if across is None else across
    if length < 2 * edge or across < 1:
        raise InputError("a strip needs two mesh cells along it and one across")
    cut, held = strip(length=length, width=across * edge, edge=edge, clamp=2 * edge,
                      **triangulation)
    x, y = (cut.rest * [1.0, width / (across * edge)]).T
    flat = np.column_stack([x * np.cos(slope), y, -x * np.sin(slope)])
    cos, sin = np.cos(angle), np.sin(angle)
    mesh = Mesh(np.column_stack([cos * x - sin * y, sin * x + cos * y]), cut.faces)
    scene = Scene(mesh=mesh, held=held, gravity=gravity)
    equilibrium = find_equilibrium(scene, fabric, scene.state(flat), laws=laws, options=TIGHT)
    positions = equilibrium.positions
    columns = positions.reshape(-1, across + 1, 3)[:, :, [0, 2]] * [1.0, -1.0]
    curve = columns[np.count_nonzero(held) // (across + 1) - 1 :].mean(axis=1)
    side = positions[-1] - positions[-1 - across]
    return HungStrip(curve, float(np.arctan2(side[2], side[1])), equilibrium.searched)


def simulate_strips(
    fabric: Fabric, lengths: Mapping[str, Sequence[Metres]], *, width: Metres | None = 0.03,
    cells: int = CELLS, across: int = CELLS_ACROSS, **options,
) -> dict[str, list[DeflectionCurve]]:
    """Curves of simulated strips by direction; InputError if one does not reach equilibrium.

    ``cells`` are those along the gravity length; a ``width`` of None makes them square. ``options``
    are further arguments of :func:`hang`.
    """
    strips: dict[str, list[DeflectionCurve]] = {direction: [] for direction in lengths}
    for direction, length in ((d, length) for d in lengths for length in lengths[d]):
        alpha = fabric.alpha[DIRECTIONS.index(direction)]
        count = length * cells / gravity_length(alpha, fabric.density)
        edge = length / np.ceil(count - 1e-9)  # an integer may have been rounded up
        hung = hang(fabric, angle=ANGLES[direction], length=length, edge=edge, across=across,
                    width=across * edge if width is None else width, diagonals="random",
                    **options)
        if not hung.converged:
            raise InputError(f"the simulated {direction} strip of {1e3 * length:.0f} mm does not "
                             f"come to rest: {hung.result.message}")
        strips[direction].append(hung.curve)
    return strips


def fabric_of_gamma(gamma: float, length: Metres) -> Fabric:
    """Isotropic linear fabric whose strip of this length has rho g L³/alpha = ``gamma``."""
    return Fabric(alpha=np.full(3, REFERENCE_DENSITY * GRAVITY * length**3 / gamma))
