"""The barrier that keeps two triangles from folding through each other.

Cloth folded flat onto itself has an angle of half a turn, beyond which angles jump to the other
side and so does every energy of them. Close to that pole p, beyond s = ``LIMIT_START`` p, an angle
costs a modulus and a slenderness times

    -(|angle| - s)² log((p - |angle|)/(p - s)),

which has two continuous derivatives and no bound. A converged drape that feels it is not resolved
by its mesh.
"""

import numpy as np

LIMIT_START = 0.76  # of the pole: 2.4 rad between two triangles
LEAST_ROOM = 0.2  # share of the way to the pole that a step must leave


def is_bent(angle: np.ndarray, pole: np.ndarray | float) -> np.ndarray:
    """Where the barrier acts, bool, shaped like ``angle`` (rad)."""
    return np.abs(angle) > LIMIT_START * pole


def barrier(
    angle: np.ndarray, pole: np.ndarray | float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The barrier and its first two derivatives by ``angle`` (rad), each shaped like it.

    Args:
        pole: rad, one or as many as angles; infinite for angles that have none.
    """
    value, slope, bend = np.zeros((3, *np.shape(angle)))
    bent = is_bent(angle, pole)
    if bent.any():
        pole = np.broadcast_to(pole, bent.shape)[bent]
        over, left = np.abs(angle[bent]) - LIMIT_START * pole, pole - np.abs(angle[bent])
        with np.errstate(invalid="ignore", divide="ignore"):
            logarithm = np.log(left / ((1 - LIMIT_START) * pole))
            value[bent] = -(over**2) * logarithm
            slope[bent] = np.sign(angle[bent]) * (over**2 / left - 2.0 * over * logarithm)
            bend[bent] = 4.0 * over / left + (over / left) ** 2 - 2.0 * logarithm
    return value, slope, bend


def leaves_room(before: np.ndarray, after: np.ndarray, pole: np.ndarray | float) -> bool:
    """Whether a step leaves every angle (rad) room before its pole.

    An angle may neither pass its pole nor take most of its way there in one step: the second is
    the fraction-to-boundary rule of interior-point methods, without which a step can end too close
    to the pole for a later one to get away. A step turns an angle by less than half a turn.
    """
    turn = np.remainder(after - before + np.pi, 2 * np.pi) - np.pi
    reached = np.abs(before + turn)  # beyond half a turn where the angle itself has jumped
    near = is_bent(reached, pole)
    if not near.any():
        return True
    pole = np.broadcast_to(pole, near.shape)[near]
    room = np.minimum(pole - np.abs(before[near]), (1 - LIMIT_START) * pole)
    return bool((pole - reached[near] >= LEAST_ROOM * room).all())
