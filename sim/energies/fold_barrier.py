"""A barrier that keeps triangles from folding through each other at an edge.

    -(|phi| - s)² log((p - |phi|)/(p - s))   beyond   s = LIMIT_START p

of an angle phi with the pole p, per unit of stiffness: smooth, zero up to s, infinite at p, where
the angle would jump. A converged drape that feels it is not resolved by its mesh.
"""

import numpy as np

LIMIT_START = 0.76  # of the pole: 2.4 rad between two triangles
LEAST_ROOM = 0.2  # share of the way to the pole that a step must leave


def is_bent(angle: np.ndarray, pole: np.ndarray | float) -> np.ndarray:
    """Whether angles, rad, feel the barrier."""
    return np.abs(angle) > LIMIT_START * pole


def barrier(
    angle: np.ndarray, pole: np.ndarray | float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Barrier at angles beyond its start, rad, and its first two derivatives by them."""
    over, left = np.abs(angle) - LIMIT_START * pole, pole - np.abs(angle)
    with np.errstate(invalid="ignore"):  # not a number beyond the pole
        logarithm = np.log(left / ((1 - LIMIT_START) * pole))
    return (
        -(over**2) * logarithm,
        np.sign(angle) * (over**2 / left - 2.0 * over * logarithm),
        4.0 * over / left + (over / left) ** 2 - 2.0 * logarithm,
    )


def leaves_room(before: np.ndarray, after: np.ndarray, pole: np.ndarray | float) -> bool:
    """False when an angle would pass its pole or take most of its way there in one step.

    The second is the fraction-to-boundary rule of interior-point methods: without it, a step can
    end so close to the pole that no later one gets away.
    """
    room = np.minimum(pole - np.abs(before), (1 - LIMIT_START) * pole)
    near = is_bent(after, pole)
    return bool((pole - np.abs(after) >= LEAST_ROOM * room)[near].all())
