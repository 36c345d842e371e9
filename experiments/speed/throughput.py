"""Drapes per second of several processes compared with one core.

The fabrics of :mod:`experiments.speed.speed` are draped by running worker processes (they persist
between calls) and one by one on a single core, in turn, several times. The shortest times are
reported.
"""

import experiments.one_thread  # noqa: F401

# isort: split
import time
from functools import partial

import numpy as np

from common.configs import metres
from common.errors import InputError
from common.workers import worker_pool
from experiments.drapes import prior_fabric
from experiments.result import Config, Result
from sim.draping import Drape, drape
from sim.many import drape_many
from sim.material import Fabric


def throughput(
    fabrics: list[Fabric], *, edge_mm: float | None, workers: int, repeats: int
) -> dict:
    """Time one core and several processes in turn; ``edge_mm`` None for the default mesh."""
    drape(fabrics[0], edge=4e-3)  # compiles or loads the kernels
    edge = metres(edge_mm)
    start = start_seconds(fabrics[0], workers)
    single, several = [], []
    for repeat in range(repeats):
        began, busy = time.perf_counter(), time.process_time()
        alone = [drape(fabric, edge=edge, seed=seed) for seed, fabric in enumerate(fabrics)]
        single.append((time.perf_counter() - began, time.process_time() - busy))
        start_seconds(fabrics[0], workers)  # ensures that the processes are running
        began = time.perf_counter()
        made = drape_many([{"fabric": fabric, "edge": edge, "seed": seed}
                           for seed, fabric in enumerate(fabrics)], workers=workers)
        several.append(time.perf_counter() - began)
        print(f"  round {repeat + 1} of {repeats}: one core {single[-1][0]:.1f} s, "
              f"{workers} processes {several[-1]:.1f} s", flush=True)
    wall, busy = (min(times) for times in zip(*single, strict=True))
    ratios = [one[1] / many for one, many in zip(single, several, strict=True)]
    return {
        "drapes": len(fabrics),
        "workers": workers,
        "converged": sum(result.converged for result in made),
        "largest_difference_m": max(map(largest_distance, alone, made)),
        "one_core_wall_seconds": wall,
        "one_core_cpu_seconds": busy,
        "workers_wall_seconds": min(several),
        "longest_drape_seconds": max(result.seconds for result in alone),
        "drapes_per_second_one_core": len(fabrics) / busy,
        "drapes_per_second_workers": len(fabrics) / min(several),
        "ratio": busy / min(several),
        "start_seconds_of_workers": start,
        "ratio_from_their_start": busy / (min(several) + start),
        "ratios_of_rounds": ratios,
        "median_ratio": float(np.median(ratios)),
    }


def start_seconds(fabric: Fabric, workers: int) -> float:
    """Seconds until the worker processes have started; they persist for the next call."""
    began = time.perf_counter()
    with worker_pool(workers) as pool:
        made = list(pool.map(partial(drape, edge=0.01), [fabric] * workers))
    return time.perf_counter() - began - max(result.seconds for result in made)


def largest_distance(a: Drape, b: Drape) -> float:
    """Largest distance, m, between the same vertex of two drapes."""
    return float(np.linalg.norm(a.positions - b.positions, axis=1).max())


def run(config: Config) -> Result:
    """Time one core and several processes."""
    for key in ("drapes", "workers", "repeats"):
        if config[key] < 1:
            raise InputError(f"{key}={config[key]} must be at least 1")
    fabrics = [prior_fabric(k, config["seed"]) for k in range(config["drapes"])]
    return Result(throughput(fabrics, edge_mm=config["edge_mm"], workers=config["workers"],
                             repeats=config["repeats"]))
