"""Fidelity of an estimate to a captured shape (Feng et al. 2022, section 7.2).

The simulation begins at the captured shape and ends at rest: how far it has gone says how well the
cloth of the estimate explains the capture.
"""

from dataclasses import dataclass

import numpy as np

from drapenet.refine.captured import CapturedShape
from drapenet.refine.surface import Cloud, distances
from sim.drape import DrapeResult
from sim.measures import drape_coefficient


@dataclass(frozen=True)
class Fidelity:
    """A settled drape beside the captured shape it began at.

    Attributes:
        displacement_mm: mean distance of a hanging vertex from where it was captured.
        surface_mm: the same from the captured surface, wherever on it.
        coefficient, captured_coefficient: drape coefficients, percent.
    """

    displacement_mm: float
    surface_mm: float
    coefficient: float
    captured_coefficient: float


def fidelity(shape: CapturedShape, drape: DrapeResult) -> Fidelity:
    """How far ``drape``, settled from ``shape`` on the same mesh, is from it."""
    hanging, settled = shape.hanging, drape.positions
    surface = Cloud.of_mesh(shape.positions, shape.faces)
    return Fidelity(
        1e3 * float(np.linalg.norm(settled - shape.positions, axis=1)[hanging].mean()),
        1e3 * float(distances(surface, settled[hanging]).mean()),
        *(100 * drape_coefficient(x, shape.faces, shape.rig) for x in (settled, shape.positions)))
