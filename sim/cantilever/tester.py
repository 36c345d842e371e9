"""Virtual testers of strips: cantilever, pure bending, and hinge moduli of equal deflection."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from common.errors import InputError
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


_LENGTH, _EDGE = 0.01, 5e-4  # m, of the bent square and of its cells
_STEP = 1e-3  # 1/m, of the differences of the energy


def pure_bending(
    fabric: Fabric, law: Law, curvatures: Sequence[float], *, angle: float = 0.0
) -> np.ndarray:
    """Torques per width (K,), N, of cloth bent to ``curvatures`` (K,), 1/m, one after the other.

    The torque is the derivative of the energy by the curvature, without stresses. Hysteresis
    follows every curvature in turn, so that they should be close to each other.

    Args:
        angle: from the warp to the direction that is bent, rad.
    """
    flat, _ = strip(length=_LENGTH, width=_LENGTH, edge=_EDGE, clamp=0.0)
    along, across = flat.rest.T
    cos, sin = np.cos(angle), np.sin(angle)
    mesh = Mesh(np.column_stack([cos * along - sin * across, sin * along + cos * across]),
                flat.faces)
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
        ends = [energy.value(bent(curvature + sign * _STEP)) for sign in (1, -1)]
        torques.append((ends[0] - ends[1]) / (2 * _STEP * mesh.areas.sum()))
        if isinstance(energy, HystereticBending):
            energy.origin = energy.origin_at(bent(curvature))
    return np.array(torques)


_MAX_ITERATIONS = 12  # simulated strips


@dataclass(frozen=True)
class EquivalentModulus:
    """The hinge modulus equivalent to a physical one on a given mesh."""

    ratio: float  # hinge modulus over the physical alpha
    mismatch: float  # relative error of the strip's stiffness
    found: bool  # whether the mismatch is below the tolerance
    message: str  # reason of a failure; else the number of strips simulated


def equivalent_modulus(
    mesh: Mesh, held: np.ndarray, *, gamma: float = 10.0, laws: Laws | None = None,
    tolerance: float = 1e-4,
) -> EquivalentModulus:
    """Hinge modulus with which a strip has the deflection of the heavy elastica of ``gamma``.

    Args:
        mesh, held: a strip along +x, and its vertices (V,) clamped at x <= 0; see
            :func:`sim.mesh.strip`.
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
    for strips in range(1, _MAX_ITERATIONS + 1):
        fabric = Fabric(ratio * physical.alpha, density=physical.density)
        found = find_equilibrium(scene, fabric, state, laws=laws, options=TIGHT)
        state = found.state
        if not found.converged:
            return EquivalentModulus(ratio, mismatch, False, found.message)
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
    return EquivalentModulus(ratio, mismatch, False, f"no match in {_MAX_ITERATIONS} strips")


def free_end(mesh: Mesh, state: State) -> np.ndarray:
    """Mean (reach, drop) (2,), m, of the free end of a strip along +x."""
    x = mesh.rest[:, 0]
    end = state.positions[x > (1 - 1e-9) * x.max()].mean(axis=0)
    return np.array([end[0], -end[2]])
