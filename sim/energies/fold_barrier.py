"""Barrier that prevents two triangles from folding through each other.

Cloth folded flat onto itself has an angle of pi, at which angles jump to -pi, and energies of them
are discontinuous. Close to that pole p, beyond s = ``LIMIT_START`` p, the energy of an angle is
a modulus and a slenderness times

    -(|angle| - s)² log((p - |angle|)/(p - s)),

which is twice continuously differentiable and unbounded. A converged drape in which the barrier
acts is not resolved by its mesh.
"""

import numba
import numpy as np

LIMIT_START = 0.76  # of the pole: 2.4 rad between two triangles
MIN_REMAINING = 0.2  # fraction of the distance to the pole that must remain after a step


def is_bent(angle: np.ndarray, pole: np.ndarray | float) -> np.ndarray:
    """Whether the barrier acts, bool, shaped like ``angle`` (rad)."""
    return np.abs(angle) > LIMIT_START * pole


@numba.njit(inline="always")
def barrier_at(angle, pole):
    """The barrier and its first two derivatives by ``angle``, rad; an infinite ``pole``: none."""
    over = abs(angle) - LIMIT_START * pole
    if not over > 0.0:
        return 0.0, 0.0, 0.0
    remaining = pole - abs(angle)
    logarithm = np.log(remaining / ((1 - LIMIT_START) * pole))
    return (-over * over * logarithm,
            np.sign(angle) * (over * over / remaining - 2.0 * over * logarithm),
            4.0 * over / remaining + (over / remaining) ** 2 - 2.0 * logarithm)


@numba.njit(inline="always")
def keeps_distance(before, after, pole):
    """Whether a step, by less than pi, keeps an angle, rad, from its ``pole``.

    An angle may neither pass its pole nor cover most of the distance to it in one step: without
    this fraction-to-boundary rule, a step can end too close to the pole for later steps to return.
    """
    turn = (after - before + np.pi) % (2 * np.pi) - np.pi
    reached = abs(before + turn)  # beyond pi where the angle has jumped
    if not reached > LIMIT_START * pole:
        return True
    return pole - reached >= MIN_REMAINING * min(pole - abs(before), (1 - LIMIT_START) * pole)
