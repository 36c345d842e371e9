"""From the strips of one fabric to its moduli in warp, bias and weft.

The bias modulus of the law is that of a cylinder bent along 45°, but a free strip cut along the
bias also twists and curves across while it bends and so hangs a little lower than a cylinder
would (docs/validation.md). :func:`correct` takes this out by simulating the three strips and
moving the moduli until the same estimator reads from them what it read from the real ones.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from common.errors import InputError
from sim.cantilever.bezier import fit_bezier
from sim.cantilever.regression import Estimate, regress
from sim.cantilever.table import match
from sim.cantilever.tester import simulate_strips
from sim.material import DIRECTIONS, Fabric, is_admissible
from sim.scene import GRAVITY

METHODS = {"regression": regress, "table": match}
ROUNDS = 6
LARGEST_MOVE = 3.0  # of the correction in one round: 30 % in alpha, 3 mm in beta/alpha
CLOSE = 0.05  # enough: 0.5 % in alpha and 0.05 mm in beta/alpha
Strips = Mapping[str, Sequence[np.ndarray]]
"""Curves (N, 2), m, of one or several strips of each direction."""


def estimate(
    strips: Strips, *, density: float, method: str = "table", slope: float = 0.0, degree: int = 0
) -> dict[str, Estimate]:
    """The moduli of each direction, from its strips alone; ``density`` in kg/m², ``method`` one of
    :data:`METHODS`. InputError for curves that no strip has."""
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

    InputError where a direction is missing, or no plate has these moduli.
    """
    missing = [direction for direction in DIRECTIONS if direction not in estimates]
    if missing:
        raise InputError(f"a fabric needs strips of all three directions; {missing[0]} is missing")
    return Fabric(*_moduli(_unknowns(estimates)), density=density)


def correct(
    strips: Strips, estimates: Mapping[str, Estimate], *, density: float, rounds: int = ROUNDS,
    width: float = 0.03, method: str = "table", slope: float = 0.0, degree: int = 0,
) -> Fabric:
    """Moduli whose simulated strips give the estimates that the measured strips gave.

    Each round simulates the strips and estimates from them alike. What is missing moves the
    moduli, by Broyden's method, because each direction's strip feels the other moduli too. The
    regression's reading of a bias strip's beta varies with the triangulation by a quarter.

    Args:
        strips, estimates: of all three directions, see :func:`estimate`.
        rounds, width: of simulation, at most; of the strips, m.

    Returns:
        The fabric whose strips came nearest; InputError as for :func:`fabric_of`, or where a strip
        does not settle.
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
        missing = target - _unknowns(read)
        if np.linalg.norm(missing) < least:
            best, least = fabric, float(np.linalg.norm(missing))
        if last is not None:
            step, change = at - last[0], last[1] - missing
            response += np.outer(change - response @ step, step) / (step @ step)
        last = at, missing
        if least < CLOSE:
            break
        move = np.linalg.lstsq(response, missing, rcond=1e-3)[0]
        move *= min(1.0, LARGEST_MOVE / np.abs(move).max())
        while not is_admissible(*_moduli(at + move)):
            move = move / 2
        at = at + move
        fabric = Fabric(*_moduli(at), density=density)
    return best


def _unknowns(estimates: Mapping[str, Estimate]) -> np.ndarray:
    """(6,) ten times log alpha and beta/alpha in mm, so that both vary alike."""
    each = [estimates[direction] for direction in DIRECTIONS]
    return np.array([10 * np.log(e.alpha) for e in each] + [1e3 * e.beta / e.alpha for e in each])


def _moduli(unknowns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """alpha (3,) and beta (3,) of :func:`_unknowns`."""
    alpha = np.exp(unknowns[:3] / 10)
    return alpha, 1e-3 * unknowns[3:] * alpha
