"""Ratios of hinge moduli to those of the equivalent plate, on the meshes of other tools.

The ratios depend on the mesh and its number of cells only. Strips with all of them take minutes of
computation, so the ratios are in ``drapenet/weights/hinges.json``:

    python -m drapenet.export.hinges [out=FILE]

writes that table; it takes effect in the place of the file above.
"""

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from tqdm import tqdm

from common.command import command
from common.errors import InputError
from common.files import replace_file, require_file
from sim.cantilever.tester import equivalent_modulus
from sim.mesh import strip

FILE = Path(__file__).parents[1] / "weights" / "hinges.json"
MESHES = {"unstructured": ("random", 0.2), "alternating": ("alternating", 0.0),
          "equal": ("equal", 0.0), "random": ("random", 0.0)}
"""Diagonals and jitter (:func:`sim.mesh.strip`) of the meshes that a tool may have."""
MIN_CELLS, MAX_CELLS = 6, 40  # along the strip that calibrates a mesh
SAMPLES = 6  # strips for irregular meshes, whose stiffness varies by 4 %
GAMMA = 10.0  # rho g L³/alpha of that strip, similar to that of hanging cloth in a drape
_LENGTH = 0.09  # m


@dataclass
class HingesConfig:
    """``configs/hinges.yaml``."""

    out: str


def hinge_ratio(mesh: str, cells: int) -> float:
    """Modulus of hinges over that of the equivalent plate on a mesh of :data:`MESHES`.

    Args:
        cells: along the strip, at least :data:`MIN_CELLS`; beyond :data:`MAX_CELLS` the ratio is
            constant.
    """
    return _table()[mesh][min(cells, MAX_CELLS) - MIN_CELLS]


@cache
def _table() -> dict[str, list[float]]:
    return json.loads(FILE.read_text(encoding="utf-8"))


def simulated_ratio(mesh: str, cells: int) -> float:
    """The ratio of :func:`hinge_ratio` from simulated strips; takes up to half a minute."""
    diagonals, jitter = MESHES[mesh]
    edge = _LENGTH / cells
    ratios = []
    for seed in range(SAMPLES if jitter or diagonals == "random" else 1):
        found = equivalent_modulus(*strip(
            length=_LENGTH, width=round(cells / 2) * edge, edge=edge, clamp=2 * edge,
            diagonals=diagonals, jitter=jitter, seed=seed), gamma=GAMMA)
        if not found.found:
            raise InputError(f"no strip on the mesh '{mesh}' came to rest ({found.message})")
        ratios.append(found.ratio)
    return float(np.mean(ratios))


@command("hinges", HingesConfig)
def main(config: HingesConfig) -> None:
    """Simulate the strips and write the table."""
    require_file(Path(config.out))
    lines = []
    for mesh in MESHES:
        cells = tqdm(range(MIN_CELLS, MAX_CELLS + 1), desc=mesh)
        ratios = [round(simulated_ratio(mesh, count), 4) for count in cells]
        lines.append(f' "{mesh}": {json.dumps(ratios)}')
    replace_file(Path(config.out), ("{\n" + ",\n".join(lines) + "\n}\n").encode())


if __name__ == "__main__":
    main()
