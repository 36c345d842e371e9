"""Where an outline is not one that the hem of cloth can have: its error by its shape alone.

Cloth has folds of some widths, corners where the specimen has them, and, if it is limp, steps where
folds hide each other. A network has learned this from outlines of simulated drapes
(``python -m data.dataset.hem``): it says by how much each radius is likely to be off.
"""

from pathlib import Path

import numpy as np

from common.graphs import bundled_graph
from sim.rig import Rig

BUNDLED = Path(__file__).resolve().parents[1] / "weights" / "hem.safetensors"
USUAL = 1.5e-3  # of the specimen's size, error of which the network gives the logarithm


def unlike_cloth(radii: np.ndarray, rig: Rig) -> np.ndarray:
    """Standard deviation (720,), m, of radii (720,), m, as seen from anywhere, by their shape."""
    size = rig.specimen_size
    found, = bundled_graph(BUNDLED)(radius=radii[None] / size, plate=np.array(
        [rig.plate_radius / size]), reach=np.array([rig.reach / size]))
    return np.exp(found[0]) * USUAL * size
