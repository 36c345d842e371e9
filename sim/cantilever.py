"""Cantilever strips: the simulated tester and the heavy elastica it is checked against."""

import numpy as np
from scipy.integrate import solve_bvp

from sim.equilibrium import find_equilibrium
from sim.errors import InputError
from sim.material import REFERENCE_DENSITY, Fabric
from sim.mesh import strip
from sim.newton import NewtonOptions, NewtonResult
from sim.scene import GRAVITY, Scene, State


def elastica(gamma: float, points: int = 2001) -> np.ndarray:
    """Shape (points, 2) of a heavy elastica clamped horizontally, for a strip of length 1.

    Solves theta'' = -gamma (1 - s) cos(theta), theta(0) = 0, theta'(1) = 0, where theta is the
    angle below the horizontal and gamma = rho g L³/alpha. Columns: distance from the clamp and
    drop. For small gamma, drop/reach tends to gamma/8.
    """

    def slope(s: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.stack([y[1], -gamma * (1 - s) * np.cos(y[0])])

    def ends(left: np.ndarray, right: np.ndarray) -> np.ndarray:
        return np.array([left[0], right[1]])

    # A boundary layer of width gamma^(-1/2) forms at the clamp; the guess has it.
    width = 1.0 / np.sqrt(1.0 + gamma)
    s = np.concatenate([np.linspace(0, 10 * width, 200), np.linspace(10 * width, 1, 200)[1:]])
    s = np.unique(np.clip(s, 0, 1))
    steepest = np.pi / 2 * gamma / (gamma + 10)
    guess = np.stack([steepest * (1 - np.exp(-s / width)), steepest / width * np.exp(-s / width)])
    solution = solve_bvp(slope, ends, s, guess, tol=1e-9, max_nodes=200_000)
    if not solution.success:
        raise InputError(f"no elastica for gamma={gamma}: {solution.message}")
    at = np.linspace(0, 1, points)
    theta = solution.sol(at)[0]
    middle = solution.sol((at[1:] + at[:-1]) / 2)[0]
    # Simpson's rule on each interval
    reach = (np.cos(theta[:-1]) + 4 * np.cos(middle) + np.cos(theta[1:])) / 6 * np.diff(at)
    drop = (np.sin(theta[:-1]) + 4 * np.sin(middle) + np.sin(theta[1:])) / 6 * np.diff(at)
    shape = np.zeros((points, 2))
    shape[1:] = np.cumsum(np.stack([reach, drop], axis=1), axis=0)
    return shape


def aspect_ratio(end: np.ndarray) -> float:
    """Drop over reach (H/W) of a deflected strip whose free end lies at ``end`` (2,)."""
    return float(end[1] / end[0])


def hang_strip(
    fabric: Fabric,
    *,
    length: float = 0.09,
    width: float = 0.03,
    edge: float = 0.003,
    diagonals: str = "alternating",
    jitter: float = 0.0,
    seed: int = 0,
) -> tuple[np.ndarray, NewtonResult]:
    """Let a strip cut along warp hang from a horizontal clamp.

    Args:
        fabric: of which the moduli over density matter.
        length, width, edge: free length, width and mesh spacing, m.
        diagonals, jitter, seed: triangulation, see :func:`sim.mesh.strip`.

    Returns:
        Mean (reach, drop) (2,) of the free end, m, and the solver's result.
    """
    mesh, held = strip(
        length=length,
        width=width,
        edge=edge,
        clamp=2 * edge,
        diagonals=diagonals,
        jitter=jitter,
        seed=seed,
    )
    scene = Scene(mesh=mesh, held=held)
    flat = np.column_stack([mesh.rest, np.zeros(len(mesh.rest))])
    state, result = find_equilibrium(
        scene,
        fabric.at_density(REFERENCE_DENSITY),
        State.at(mesh, flat),
        options=NewtonOptions(residual=1e-6, step=1e-6),
    )
    end = state.positions[np.isclose(mesh.rest[:, 0], length)]
    return np.array([end[:, 0].mean(), -end[:, 2].mean()]), result


def fabric_of_gamma(gamma: float, length: float) -> Fabric:
    """Isotropic linear fabric whose strip of ``length`` (m) has rho g L³/alpha = ``gamma``."""
    alpha = REFERENCE_DENSITY * GRAVITY * length**3 / gamma
    return Fabric(alpha=np.full(3, alpha))
