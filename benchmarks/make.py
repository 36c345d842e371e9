"""Make the captures of version 1 again: ``python -m benchmarks.make FOLDER``, ten CPU-minutes.

Fabrics of the prior with the nuisances of real specimens, drawn by a fixed seed, on two testers:
an outline of each, with errors of scale, centre and hem, and depth views of some, with the random
cameras and sensors of training. A later simulator or renderer makes other files: the stored ones
are the benchmark.
"""

import sys
from pathlib import Path

import numpy as np

from benchmarks.estimators import HEAD, LEARNED
from benchmarks.protocol import COLUMNS, EDGE, TRUTH, UNITS
from common.files import replace_file
from data.captures.capture import OutlineCapture
from data.captures.photograph import PhotographedOutline
from data.captures.writer import write_capture, write_outline
from data.dataset.plan import DrapePlan
from data.fabrics.fabrics import from_theta
from data.render.setups import Setups
from experiments.drapes import LEARNED as PLAIN
from experiments.drapes import capture_drape, drape_as_planned, outline_of, plan_specimen
from sim.draping import Drape
from sim.material import REFERENCE_DENSITY
from sim.measures import drape_coefficient
from sim.rig import DISC_RIG, SQUARE_RIG

SEED = 2031
WORDS = (*PLAIN, "dataset.starts_per_fabric=1", "dataset.testers_per_fabric=1")
FABRICS, DEPTH, REGRESSED = 12, 8, 40  # of each tester; of them with depth views; of the baseline
FINE = 3e-3  # m
DENSITIES = (0.08, 0.4)  # kg/m²
SCALE, CENTRE, HEM = 0.005, 5e-4, 2e-4  # deviations, relative, m, m


def main(folder: str) -> None:
    """Write the captures, their truth, and the drapes of the baseline."""
    out, truth, learned = Path(folder), [], []
    for tester, rig in enumerate((DISC_RIG, SQUARE_RIG)):
        for number in range(FABRICS + REGRESSED):
            plan = plan_specimen(number, *WORDS, seed=SEED + tester, nuisances="real", rig=rig)
            shape = drape_as_planned(plan, edge=FINE if number < FABRICS else EDGE)
            share = 100 * drape_coefficient(shape.positions, shape.faces, shape.rig)
            if number >= FABRICS:
                learned.append(row(rig.name, plan, REFERENCE_DENSITY, share))
                continue
            rng = np.random.default_rng([SEED, tester, number])
            density = round(float(np.exp(rng.uniform(*np.log(DENSITIES)))), 3)
            for write in (write_outline_of, write_depth_of)[: 1 + (number < DEPTH)]:
                name = f"{write.__name__.split('_')[1]}_{rig.name}_{number:02}"
                write(out / name, plan, shape, density, rng)
                truth.append(row(name, plan, density, share))
    for file, head, rows in ((TRUTH, COLUMNS, sorted(truth)), (LEARNED, HEAD, learned)):
        replace_file(out / file, "\n".join([",".join(head), *rows, ""]).encode())


def row(name: str, plan: DrapePlan, density: float, share: float) -> str:
    """A line of a table: moduli at a ``density``, kg/m², and a drape coefficient, %."""
    moduli = np.hstack(from_theta(plan.theta)) * density / REFERENCE_DENSITY / UNITS
    return ",".join([name, *(f"{value:.5g}" for value in moduli), f"{share:.2f}"])


def write_outline_of(
    path: Path, plan: DrapePlan, shape: Drape, density: float, rng: np.random.Generator
) -> None:
    """The outline under parallel light, turned at random."""
    warp = rng.uniform(0, np.pi)
    radius = outline_of(shape).radius[::2]  # cloth may bulge beyond its hem
    count = len(radius)
    radius = radius * (1 + SCALE * rng.standard_normal()) + HEM * rng.standard_normal(count)
    angle = np.arange(count) * 2 * np.pi / count + warp
    curve = radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    write_outline(OutlineCapture(
        density=density, rig=plan.rig, warp_direction=warp, face=face(plan),
        outline=PhotographedOutline(curve + rng.normal(0.0, CENTRE, 2), np.inf, True, plan.rig)),
        path)


def write_depth_of(
    path: Path, plan: DrapePlan, shape: Drape, density: float, rng: np.random.Generator
) -> None:
    """Depth views with a random set-up."""
    seen = capture_drape(shape, Setups.load("real"), rng, plan.rig)
    write_capture(path, views=seen.views, intrinsics=seen.intrinsics, density=density,
                  rig=plan.rig, warp_direction=seen.orientation % np.pi, turns=seen.turns,
                  face=face(plan))


def face(plan: DrapePlan) -> str:
    """Which face of the specimen is up."""
    return "up" if plan.face == 1 else "down"


if __name__ == "__main__":
    main(*sys.argv[1:])
