"""The virtual cantilever tester: strips cut at any angle hang from a clamp."""

from dataclasses import dataclass

import numpy as np

from common.errors import InputError
from sim.cantilever.guide import GuidedSides
from sim.equilibrium import find_equilibrium
from sim.laws import Laws
from sim.material import REFERENCE_DENSITY, Fabric
from sim.mesh import Mesh, strip
from sim.newton import NewtonOptions, NewtonResult
from sim.scene import GRAVITY, Scene, State

GUIDE = 100.0
"""Stiffness of a guide's ties in units of alpha/edge²; the rulings are then level to 1e-4."""


@dataclass(frozen=True)
class HungStrip:
    """A strip in equilibrium.

    Attributes:
        curve: (N, 2) m, reach and drop from the clamp's edge to the free end, each point the
            mean across the strip.
        positions: (N, M, 3) m, vertices along and across the strip, clamped ones left out;
            x away from the clamp, z up.
        mesh: all of the strip, ``rest`` in material axes.
        result: the solver's; the shape counts only if its status is CONVERGED.
    """

    curve: np.ndarray
    positions: np.ndarray
    mesh: Mesh
    result: NewtonResult

    @property
    def twist(self) -> float:
        """Slope of the free end across the strip, radians."""
        side = self.positions[-1, -1] - self.positions[-1, 0]
        return float(np.arctan2(side[2], side[1]))


def hang(
    fabric: Fabric,
    *,
    angle: float = 0.0,
    slope: float = 0.0,
    length: float = 0.09,
    width: float = 0.03,
    edge: float = 0.003,
    across: int | None = None,
    diagonals: str = "alternating",
    jitter: float = 0.0,
    seed: int = 0,
    guided: bool = False,
    laws: Laws | None = None,
    gravity: float = GRAVITY,
) -> HungStrip:
    """Let a strip hang from a clamp.

    Args:
        fabric: of which the moduli over density matter.
        angle: of the strip to the warp, radians; pi/4 is the bias, pi/2 the weft.
        slope: of the clamp below the horizontal, radians.
        length, width, edge: free length, width and mesh spacing, m.
        across: mesh cells across the strip; None makes them square.
        diagonals, jitter, seed: triangulation, see :func:`sim.mesh.strip`.
        guided: keep the rulings level, see :mod:`sim.cantilever.guide`; a real strip is free.
        laws: of bending and membrane.
        gravity: m/s²; tiny values give the small deflections of plate theory.

    Raises:
        InputError: the mesh has less than two cells along or one across, or a guided strip's
            mesh is jittered.
    """
    across = round(width / edge) if across is None else across
    if length < 2 * edge or across < 1:
        raise InputError("a strip needs two mesh cells along it and one across")
    if guided and jitter:
        raise InputError("a guided strip needs a regular mesh: jitter=0")
    cut, held = strip(
        length=length,
        width=across * edge,
        edge=edge,
        clamp=2 * edge,
        diagonals=diagonals,
        jitter=jitter,
        seed=seed,
    )
    x, y = (cut.rest * [1.0, width / (across * edge)]).T
    along = np.array([np.cos(angle), np.sin(angle)])
    rest = np.outer(x, along) + np.outer(y, [-along[1], along[0]])
    mesh = Mesh(rest=rest, faces=cut.faces)
    flat = np.column_stack([x * np.cos(slope), y, -x * np.sin(slope)])
    fabric = fabric.at_density(REFERENCE_DENSITY)
    extra = []
    if guided:
        stiffness = GUIDE * float(fabric.alpha.max()) / edge**2
        extra = [GuidedSides(mesh, across=across + 1, stiffness=stiffness, edge=edge)]
    state, result = find_equilibrium(
        Scene(mesh=mesh, held=held, gravity=gravity),
        fabric,
        State.at(mesh, flat),
        laws=laws,
        extra=extra,
        options=NewtonOptions(residual=1e-6, step=1e-6),
    )
    columns = state.positions.reshape(-1, across + 1, 3)
    free = columns[np.count_nonzero(held) // (across + 1) - 1 :]
    curve = free.mean(axis=1)[:, [0, 2]] * [1.0, -1.0]
    return HungStrip(curve=curve, positions=free, mesh=mesh, result=result)


def hang_strip(fabric: Fabric, **options) -> tuple[np.ndarray, NewtonResult]:
    """Mean (reach, drop) (2,) of the free end, m, and the solver's result; see :func:`hang`."""
    strip_ = hang(fabric, **options)
    return strip_.curve[-1], strip_.result


def fabric_of_gamma(gamma: float, length: float) -> Fabric:
    """Isotropic linear fabric whose strip of ``length`` (m) has rho g L³/alpha = ``gamma``."""
    alpha = REFERENCE_DENSITY * GRAVITY * length**3 / gamma
    return Fabric(alpha=np.full(3, alpha))
