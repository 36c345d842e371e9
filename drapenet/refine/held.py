"""Simulations of a cloth that stays held, weakly, to the captured surface.

On a mesh a drape has many equilibria close to each other, a millimetre or two apart: its folds
stick where the mesh lets them. A free simulation ends in one of them, the captured cloth in none,
and the difference would be charged to the moduli. Weak springs towards the captured points leave
one equilibrium. The right fabric hardly needs them; a wrong one pulls at them, which shows in the
same residuals, only smaller.
"""

import numpy as np

from drapenet.refine.attraction import Springs, nearest_springs, spring_stiffness
from sim.drape import DrapeResult

PULL = 0.3
"""Force of the springs at a distance of 1 mm, over the cloth's weight."""
REACH = 6e-3  # m


def springs_to_surface(
    shape: DrapeResult, points: np.ndarray, normals: np.ndarray, *, pull: float = PULL
) -> Springs:
    """Springs that hold cloth across a captured surface; along it the cloth is free.

    Args:
        shape: the captured shape, as :func:`.attraction.captured_shape` gives it.
        points, normals: (N, 3) m and (N, 3) of the surface, specimen's axes.
        pull: see :data:`PULL`.
    """
    return nearest_springs(shape.scene, shape.positions, points, normals, pull=pull, reach=REACH)


def springs_to_vertices(shape: DrapeResult, *, pull: float = PULL) -> Springs:
    """Springs that hold the vertices of cloth to those of a registered ``shape``."""
    scene = shape.scene
    free = np.repeat(np.flatnonzero(~scene.held), 3)
    axes = np.tile(np.eye(3), (len(free) // 3, 1))
    return Springs(free, shape.positions[free], axes, spring_stiffness(scene, free, pull))
