"""CPU-seconds of a drape on one core.

Fabrics from the bundled prior, each lowered on the testers of ``testers`` and meshes of
``edges_mm``: CPU-seconds and Newton steps. References: 19.8 CPU-seconds per drape with 100 × 100
vertices (Feng et al. 2022, section 5.2: 48 000 drapes, 12 hours, 22 CPUs), 329 with the Style3D
solver of Newton 1.8.
"""

import os

from common.workers import ONE_THREAD

os.environ.update(ONE_THREAD)  # before libraries read it

# isort: split
import resource
import time

import numpy as np

from common.configs import metres
from data.dataset.plan import Stream, stream
from data.fabrics.fabrics import fabric_from_theta
from data.fabrics.prior import load_prior, sample_admissible
from experiments.report import Report
from experiments.study import PlainKeys, Study
from sim.draping import drape
from sim.material import MICRO, Fabric
from sim.rig import Rig
from sim.solver.linear import available_solvers


class Keys(PlainKeys):
    drapes: int = 32  # fabrics
    seed: int = 77  # of the fabrics
    testers: tuple[str, ...] = ("disc300_support180", "square300_cylinder100")
    edges_mm: tuple[float | None, ...] = (  # at the plate's rim, of training data; null: default
        5.0, None)


def prior_fabric(index: int, seed: int) -> Fabric:
    """Fabric ``index`` of the Gaussian prior."""
    drawn, _ = sample_admissible(load_prior("gaussian"), stream(seed, Stream.FABRIC, index))
    return fabric_from_theta(drawn)


def time_drape(fabric: Fabric, *, rig: Rig, edge_mm: float | None, seed: int) -> dict:
    """Time one lowered drape; ``edge_mm`` None for the default mesh."""
    began = time.process_time()
    result = drape(fabric, rig=rig, edge=metres(edge_mm), seed=seed)
    return {
        "alpha_uN_m": (fabric.alpha / MICRO).round(2).tolist(),
        "edge_mm": 1e3 * result.edge,
        "vertices": len(result.rest),
        "triangles": len(result.faces),
        "status": result.status.value,
        "cpu_seconds": round(time.process_time() - began, 3),
        "newton_steps": result.iterations,
    }


def time_drapes(fabrics: list[Fabric], rig: Rig, edge_mm: float | None) -> dict:
    """Time the drapes of all fabrics; summary and single results."""
    runs = []
    for seed, fabric in enumerate(fabrics):
        runs.append(time_drape(fabric, rig=rig, edge_mm=edge_mm, seed=seed))
        print(f"  {seed + 1} of {len(fabrics)}: {runs[-1]['cpu_seconds']:.2f} CPU-seconds, "
              f"{runs[-1]['triangles']} triangles, {runs[-1]['status']}", flush=True)
    seconds = np.array([run["cpu_seconds"] for run in runs])
    return {
        "mean_cpu_seconds": float(seconds.mean()),
        "median_cpu_seconds": float(np.median(seconds)),
        "largest_cpu_seconds": float(seconds.max()),
        "mean_newton_steps": float(np.mean([run["newton_steps"] for run in runs])),
        "converged": sum(run["status"] == "converged" for run in runs),
        "runs": runs,
    }


def run(keys: Keys) -> Report:
    """Time all drapes."""
    fabrics = [prior_fabric(k, keys.seed) for k in range(keys.drapes)]
    rigs = [Rig.from_name(name) for name in keys.testers]
    report = {"dtype": "float64", "linear_solver": available_solvers()[0].__name__, "threads": 1}
    for rig in rigs:
        drape(fabrics[0], rig=rig, edge=4e-3)  # compiles or loads the kernels of all meshes
        for edge_mm in keys.edges_mm:
            print(f"{rig.name}, edges of {edge_mm or 'the default number of'} mm", flush=True)
            name = f"{rig.name}_{f'{edge_mm:g}mm' if edge_mm else 'default'}"
            report[name] = time_drapes(fabrics, rig, edge_mm)
    report["peak_memory_GiB"] = round(
        resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024**2, 2)
    return report


STUDY = Study(Keys, run)
