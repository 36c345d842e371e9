"""Elastica curves of cantilever strips."""

import numpy as np

from common.normal import Normal
from sim.cantilever import heavy_elastica
from sim.material import DIRECTIONS, gravity_length
from sim.rig import GRAVITY

WEIGHT = 0.3 * GRAVITY
PRIOR = Normal(np.array([np.log(30e-6), -2.6e-3, 0.0]), np.diag([1.0, 3e-3, 7.1]) ** 2)
"""Of a direction's log alpha, beta/alpha and natural curvature."""
PRIORS = dict.fromkeys(DIRECTIONS, PRIOR)
LAWS = [(20e-6, -50e-9), (80e-6, -150e-9), (20e-6, 40e-9), (5e-6, -30e-9)]


def curves_of(alpha: float, beta: float, *, slope: float = 0.0, points: int = 81) -> list:
    """Elastica curves of two strips, 1.5 and 2.5 bending lengths long."""
    return [
        heavy_elastica(alpha, beta, weight=WEIGHT, length=x * gravity_length(alpha, 0.3),
                       slope=slope, points=points)
        for x in (1.5, 2.5)
    ]
