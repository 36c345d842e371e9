"""Barrier that prevents two triangles from folding through each other.

Cloth folded flat onto itself has an angle of pi, at which angles jump to -pi, and energies of them
are discontinuous. Close to that pole p, beyond s = ``LIMIT_START`` p, the energy of an angle is
a modulus and a slenderness times

    -(|angle| - s)² log((p - |angle|)/(p - s)),

which is twice continuously differentiable and unbounded. A converged drape in which the barrier
acts is not resolved by its mesh.
"""

import numpy as np

LIMIT_START = 0.76  # of the pole: 2.4 rad between two triangles
MIN_REMAINING = 0.2  # fraction of the distance to the pole that must remain after a step


def is_bent(angle: np.ndarray, pole: np.ndarray | float) -> np.ndarray:
    """Whether the barrier acts, bool, shaped like ``angle`` (rad)."""
    return np.abs(angle) > LIMIT_START * pole


def barrier(
    angle: np.ndarray, pole: np.ndarray | float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The barrier and its first two derivatives by ``angle`` (rad), each shaped like it. Angles
    without a ``pole``, rad, have an infinite one."""
    value, slope, bend = np.zeros((3, *np.shape(angle)))
    bent = is_bent(angle, pole)
    if bent.any():
        pole = np.broadcast_to(pole, bent.shape)[bent]
        over, remaining = np.abs(angle[bent]) - LIMIT_START * pole, pole - np.abs(angle[bent])
        with np.errstate(invalid="ignore", divide="ignore"):
            logarithm = np.log(remaining / ((1 - LIMIT_START) * pole))
            value[bent] = -(over**2) * logarithm
            slope[bent] = np.sign(angle[bent]) * (over**2 / remaining - 2.0 * over * logarithm)
            bend[bent] = 4.0 * over / remaining + (over / remaining) ** 2 - 2.0 * logarithm
    return value, slope, bend


def keeps_distance(before: np.ndarray, after: np.ndarray, pole: np.ndarray | float) -> bool:
    """Whether a step, by less than pi, keeps the angles (...,), rad, from their poles.

    An angle may neither pass its pole nor cover most of the distance to it in one step: without
    this fraction-to-boundary rule, a step can end too close to the pole for later steps to return.
    """
    turn = np.remainder(after - before + np.pi, 2 * np.pi) - np.pi
    reached = np.abs(before + turn)  # beyond pi where the angle has jumped
    near = is_bent(reached, pole)
    if not near.any():
        return True
    pole = np.broadcast_to(pole, near.shape)[near]
    distance = np.minimum(pole - np.abs(before[near]), (1 - LIMIT_START) * pole)
    return bool((pole - reached[near] >= MIN_REMAINING * distance).all())
