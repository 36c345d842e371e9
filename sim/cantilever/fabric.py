"""Moduli of a fabric in warp, bias and weft from its strips.

The bias modulus of the law is that of a cylinder bent along 45°, but a free strip cut along the
bias also twists and curves across while it bends, and thus hangs slightly lower than a cylinder
(docs/validation.md). :func:`correct` removes this bias: it simulates the three strips and adjusts
the moduli until the estimates from the simulated strips equal those from the measured ones.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from common.errors import InputError
from sim.cantilever.bezier import fit_bezier
from sim.cantilever.regression import Estimate, regress
from sim.cantilever.table import match
from sim.cantilever.tester import simulate_strips
from sim.material import DIRECTIONS, Fabric, is_admissible
from sim.rig import GRAVITY

METHODS = {"regression": regress, "table": match}
MAX_ROUNDS = 6
MAX_MOVE = 3.0  # of the correction in one round: 30 % in alpha, 3 mm in beta/alpha
TOLERANCE = 0.05  # 0.5 % in alpha and 0.05 mm in beta/alpha
Strips = Mapping[str, Sequence[np.ndarray]]
"""Curves (N, 2), m, of one or several strips of each direction."""


def estimate(
    strips: Strips, *, density: float, method: str = "table", slope: float = 0.0, degree: int = 0
) -> dict[str, Estimate]:
    """Moduli of each direction from its strips alone; ``density`` in kg/m², ``method`` one of
    :data:`METHODS`. InputError for curves that do not fit a hanging strip."""
    if method not in METHODS:
        raise InputError(f"unknown method '{method}'; choose from {', '.join(METHODS)}")
    found = {}
    for direction, curves in strips.items():
        try:
            found[direction] = METHODS[method](curves, weight=density * GRAVITY, slope=slope,
                                               degree=degree)
        except InputError as error:
            raise InputError(f"{direction}: {error}") from None
    return found


def fabric_of(estimates: Mapping[str, Estimate], density: float) -> Fabric:
    """The fabric with the estimated moduli of the three directions and a density, kg/m².

    InputError if a direction is missing, or if no elastic plate has these moduli.
    """
    missing = [direction for direction in DIRECTIONS if direction not in estimates]
    if missing:
        raise InputError(f"a fabric needs strips of all three directions; {missing[0]} is missing")
    return Fabric(*_moduli(_unknowns(estimates)), density=density)


def correct(
    strips: Strips, estimates: Mapping[str, Estimate], *, density: float, rounds: int = MAX_ROUNDS,
    width: float = 0.03, method: str = "table", slope: float = 0.0, degree: int = 0,
) -> Fabric:
    """Moduli whose simulated strips give the same estimates as the measured strips.

    Each round simulates the strips and estimates moduli from them by the same method. The residual
    moves the moduli by Broyden's method, as each direction's strip depends on the other moduli too.
    The regression's estimate of a bias strip's beta varies with the triangulation by a quarter.

    Args:
        strips, estimates: of all three directions, see :func:`estimate`.
        rounds: maximum number of simulation rounds.
        width: of the strips, m.

    Returns:
        The fabric with the smallest residual; InputError as for :func:`fabric_of`, or if a strip
        does not reach equilibrium.
    """
    fabric = fabric_of(estimates, density)
    lengths = {
        direction: [fit_bezier(c, degree=degree, slope=slope)[0].length for c in strips[direction]]
        for direction in DIRECTIONS
    }
    target = at = _unknowns(estimates)
    response = np.eye(len(target))
    best, least, last = fabric, np.inf, None
    for _ in range(rounds):
        simulated = simulate_strips(fabric, lengths, width=width, slope=slope)
        read = estimate(simulated, density=density, method=method, slope=slope, degree=degree)
        residual = target - _unknowns(read)
        if np.linalg.norm(residual) < least:
            best, least = fabric, float(np.linalg.norm(residual))
        if last is not None:
            step, change = at - last[0], last[1] - residual
            response += np.outer(change - response @ step, step) / (step @ step)
        last = at, residual
        if least < TOLERANCE:
            break
        move = np.linalg.lstsq(response, residual, rcond=1e-3)[0]
        move *= min(1.0, MAX_MOVE / np.abs(move).max())
        while not is_admissible(*_moduli(at + move)):
            move = move / 2
        at = at + move
        fabric = Fabric(*_moduli(at), density=density)
    return best


def _unknowns(estimates: Mapping[str, Estimate]) -> np.ndarray:
    """(6,) ten times log alpha, and beta/alpha in mm: both vary by similar amounts."""
    each = [estimates[direction] for direction in DIRECTIONS]
    return np.array([10 * np.log(e.alpha) for e in each] + [1e3 * e.beta / e.alpha for e in each])


def _moduli(unknowns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """alpha (3,) and beta (3,), inverse of :func:`_unknowns`."""
    alpha = np.exp(unknowns[:3] / 10)
    return alpha, 1e-3 * unknowns[3:] * alpha
