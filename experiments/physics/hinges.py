"""Ratios of hinge moduli to those of the equivalent plate, on the meshes of other tools.

The report is the table of ``drapenet/weights/hinges.json``, minutes of simulated strips.
"""

import numpy as np
from tqdm import tqdm

from common.errors import InputError
from drapenet.export.material import GAMMA, MAX_CELLS, MESHES, MIN_CELLS
from experiments.result import Config, Result
from sim.cantilever.tester import equivalent_modulus
from sim.mesh import strip

LENGTH = 0.09  # m


def simulated_ratio(mesh: str, cells: int, *, samples: int = 6) -> float:
    """The ratio from simulated strips with so many cells along; up to half a minute."""
    diagonals, jitter = MESHES[mesh]
    edge, ratios = LENGTH / cells, []
    for seed in range(samples if jitter or diagonals == "random" else 1):
        modulus = equivalent_modulus(*strip(
            length=LENGTH, width=round(cells / 2) * edge, edge=edge, clamp=2 * edge,
            diagonals=diagonals, jitter=jitter, seed=seed), gamma=GAMMA)
        if not modulus.found:
            raise InputError(f"no strip on the mesh '{mesh}' came to rest ({modulus.message})")
        ratios.append(modulus.ratio)
    return float(np.mean(ratios))


def run(config: Config) -> Result:
    """Simulate the strips of all meshes."""
    return Result({mesh: [
        round(simulated_ratio(mesh, cells, samples=config["samples"]), 4)
        for cells in tqdm(range(MIN_CELLS, MAX_CELLS + 1), desc=mesh)] for mesh in MESHES})
