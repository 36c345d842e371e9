"""Virtual testers of strips: cantilever, pure bending as KES-FB2, and hinge moduli with which a
strip of hinges hangs as the cloth does.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from common.errors import InputError
from common.types import DeflectionCurve, Density, Metres, Radians, VertexMask
from sim.cantilever.elastica import aspect_ratio, elastica, gamma_of_aspect_ratio
from sim.cloth import Law, Laws
from sim.energies.plate_variants import HystereticBending
from sim.equilibrium import find_equilibrium
from sim.material import DIRECTIONS, REFERENCE_DENSITY, Fabric
from sim.mesh import Mesh, strip
from sim.rig import GRAVITY
from sim.scene import Scene
from sim.solver.newton import NewtonOptions, NewtonResult, Status
from sim.solver.state import State

ANGLES = dict(zip(DIRECTIONS, (0.0, np.pi / 4, np.pi / 2), strict=True))
TIGHT = NewtonOptions(residual=1e-6, step=1e-6)
CELLS, CELLS_ACROSS = 20, 10
"""Mesh cells along the bending length of a strip's direction, and across it; the error of alpha is
then 1 %."""
_MAX_STRIPS = 12  # simulated for one equivalent modulus
_BENT_LENGTH, _BENT_EDGE = 0.01, 5e-4  # m, of the square and its cells in pure bending
_CURVATURE_STEP = 1e-3  # 1/m, of the differences of the energy


@dataclass(frozen=True)
class HungStrip:
    """Deflection curve, averaged across a strip, and twist of its free end. Valid only if the
    result's status is CONVERGED."""

    curve: DeflectionCurve
    twist: Radians
    result: NewtonResult


def hang(
    fabric: Fabric, *, angle: Radians = 0.0, slope: Radians = 0.0, length: Metres = 0.09,
    width: Metres = 0.03, edge: Metres = 0.003, across: int | None = None,
    laws: Laws | None = None, gravity: float = GRAVITY, **triangulation,
) -> HungStrip:
    """Simulate a strip that hangs from a clamp.

    Args:
        angle: from the warp to the strip; pi/4 is the bias, pi/2 the weft.
        length, edge: free length and mesh spacing.
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
    flat = np.column_stack([x * np.cos(slope), y, -x * np.sin(slope)])
    scene = Scene(mesh=_cut_at(angle, x, y, cut), held=held, gravity=gravity)
    equilibrium = find_equilibrium(scene, fabric, scene.state(flat), laws=laws, options=TIGHT)
    positions = equilibrium.positions
    columns = positions.reshape(-1, across + 1, 3)[:, :, [0, 2]] * [1.0, -1.0]
    curve = columns[np.count_nonzero(held) // (across + 1) - 1 :].mean(axis=1)
    side = positions[-1] - positions[-1 - across]
    return HungStrip(curve, float(np.arctan2(side[2], side[1])), equilibrium.outcome)


def _cut_at(angle: Radians, along: np.ndarray, across: np.ndarray, flat: Mesh) -> Mesh:
    """The mesh of a strip with coordinates (V,) m along and across it, at an angle to the warp."""
    cos, sin = np.cos(angle), np.sin(angle)
    return Mesh(np.column_stack([cos * along - sin * across, sin * along + cos * across]),
                flat.faces)


def simulate_strips(
    fabric: Fabric, lengths: Mapping[str, Sequence[Metres]], *, width: Metres | None = 0.03,
    cells: int = CELLS, across: int = CELLS_ACROSS, **options,
) -> dict[str, list[DeflectionCurve]]:
    """Curves of simulated strips by direction; InputError if one does not reach equilibrium.

    Args:
        width: None for square mesh cells.
        cells, across: mesh cells along the bending length and across the strip.
        options: further arguments of :func:`hang`, such as the seed of the triangulation.
    """
    strips: dict[str, list[DeflectionCurve]] = {direction: [] for direction in lengths}
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


def bending_length(alpha: float, density: Density) -> Metres:
    """Bending length (alpha/rho g)^(1/3) of a modulus in N·m.

    Strips of 1.5 and 2.5 bending lengths, whose drop is 0.4 and 1.5 times their reach for a linear
    law, determine alpha and beta well.
    """
    return float((alpha / (density * GRAVITY)) ** (1 / 3))


def fabric_of_gamma(gamma: float, length: Metres) -> Fabric:
    """Isotropic linear fabric whose strip of this length has rho g L³/alpha = ``gamma``."""
    return Fabric(alpha=np.full(3, REFERENCE_DENSITY * GRAVITY * length**3 / gamma))


def pure_bending(
    fabric: Fabric, law: Law, curvatures: Sequence[float], *, angle: Radians = 0.0
) -> np.ndarray:
    """Torques per width (K,), N, of cloth bent to ``curvatures`` (K,), 1/m, one after the other.

    The torque is the derivative of the energy of a cylinder by the curvature, without stresses; the
    ``angle`` is from the warp to the direction that is bent. Hysteresis follows every curvature in
    turn, so that they should be close to each other.
    """
    flat, _ = strip(length=_BENT_LENGTH, width=_BENT_LENGTH, edge=_BENT_EDGE, clamp=0.0)
    along, across = flat.rest.T
    mesh = _cut_at(angle, along, across, flat)
    energy = law(mesh, np.ones(len(mesh.faces), dtype=bool), fabric=fabric)

    def bent(curvature: float) -> np.ndarray:
        """The cylinder's positions and edge normals."""
        turn = curvature * along
        middle = turn[mesh.edges].mean(axis=1)
        reach, drop = along * np.sinc(turn / np.pi), along * np.sinc(turn / 2 / np.pi) * np.sin(
            turn / 2)
        positions = np.column_stack([reach, across, -drop])
        normals = np.column_stack([np.sin(middle), np.zeros(len(middle)), np.cos(middle)])
        return np.concatenate([positions.ravel(), normals.ravel()])

    torques = []
    for curvature in curvatures:
        ends = [energy.value(bent(curvature + sign * _CURVATURE_STEP)) for sign in (1, -1)]
        torques.append((ends[0] - ends[1]) / (2 * _CURVATURE_STEP * mesh.areas.sum()))
        if isinstance(energy, HystereticBending):
            energy.origin = energy.origin_at(bent(curvature))
    return np.array(torques)


@dataclass(frozen=True)
class EquivalentModulus:
    """The hinge modulus equivalent to a physical one on a given mesh.

    A strip of hinges with the physical modulus bends too far or too little, by an amount that
    depends on its triangulation, its edge length and, weakly, on its deflection (table in
    docs/validation.md). The equivalent modulus gives a strip the deflection of the physical one.
    """

    ratio: float  # hinge modulus over the physical alpha
    mismatch: float  # relative error of the strip's stiffness
    found: bool  # whether the mismatch is below the tolerance
    message: str  # reason of a failure; else the number of strips simulated


def equivalent_modulus(
    mesh: Mesh, held: VertexMask, *, gamma: float = 10.0, laws: Laws | None = None,
    tolerance: float = 1e-4,
) -> EquivalentModulus:
    """Hinge modulus with which a strip has the deflection of the heavy elastica of ``gamma``.

    Args:
        mesh, held: a strip along +x, clamped at x <= 0; see :func:`sim.mesh.strip`.
        gamma: rho g L³/alpha of the physical strip, L its free length. At 10 the drop about
            equals the reach, as for the cloth of a drape.
        laws: linear hinges by default.
        tolerance: relative, of the stiffness.
    """
    laws = laws or Laws(bending="hinge_linear")
    elastica(gamma)  # raises for a gamma out of range
    length = float(mesh.rest[:, 0].max())
    if not length > 0:
        raise InputError("the strip has no free length: its mesh must reach beyond x = 0")
    physical = fabric_of_gamma(gamma, length)
    scene = Scene(mesh=mesh, held=held)
    state = scene.state(np.column_stack([mesh.rest, np.zeros(len(mesh.rest))]))
    ratio, mismatch = 1.0, np.inf
    for strips in range(1, _MAX_STRIPS + 1):
        fabric = Fabric(ratio * physical.alpha, density=physical.density)
        equilibrium = find_equilibrium(scene, fabric, state, laws=laws, options=TIGHT)
        state = equilibrium.state
        if not equilibrium.converged:
            return EquivalentModulus(ratio, mismatch, False, equilibrium.message)
        # The gamma of a physical strip of this shape measures the stiffness, which is nearly
        # proportional to the modulus: a few corrections by its relative error suffice.
        try:
            apparent = gamma_of_aspect_ratio(aspect_ratio(free_end(mesh, state)))
        except InputError as error:
            return EquivalentModulus(ratio, mismatch, False, str(error))
        mismatch = abs(apparent / gamma - 1)
        if mismatch < tolerance:
            return EquivalentModulus(ratio, mismatch, True, f"{strips} strips")
        ratio *= apparent / gamma
    return EquivalentModulus(ratio, mismatch, False, f"no match in {_MAX_STRIPS} strips")


def free_end(mesh: Mesh, state: State) -> np.ndarray:
    """Mean (reach, drop) (2,), m, of the free end of a strip along +x."""
    x = mesh.rest[:, 0]
    end = state.positions[x > (1 - 1e-9) * x.max()].mean(axis=0)
    return np.array([end[0], -end[2]])
