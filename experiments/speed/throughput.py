"""Drapes per second of several processes compared with one core, and CPU-seconds of maps.

The fabrics of :mod:`experiments.speed.speed` are draped by running worker processes (they persist
between calls) and one by one on a single core, in turn, several times. The shortest times are
reported. Maps are made, on one core, of a dataset of several testers as train.py makes them.
"""

import experiments.one_thread  # noqa: F401

# isort: split
import tempfile
import time
from functools import partial
from pathlib import Path

import numpy as np

from common.command import compose_config
from common.configs import metres
from common.errors import InputError
from common.workers import worker_pool
from data.dataset.config import Options, config_from_options
from data.dataset.generate import generate_dataset
from data.dataset.shards import Shard
from data.render.setups import Setups
from drapenet.config import TrainConfig
from drapenet.network.dataset import maps_of_shard
from experiments.drapes import prior_fabric
from experiments.result import Config, Result
from sim.drape import Drape, drape
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


def maps_seconds(drapes: int, *, edge_mm: float, seed: int, repeats: int) -> dict:
    """CPU-seconds of the maps of a drape with the settings of configs/train.yaml, of a new dataset
    with ``drapes`` drapes; the shortest of all rounds after one that compiles the kernels."""
    dataset = config_from_options(compose_config("generate", [
        "dataset=testers", f"drapes={drapes}", f"edge_mm={edge_mm}", f"seed={seed}"],
        schema=Options))
    train = compose_config("train", [], schema=TrainConfig)
    options = {name: getattr(train, name)
               for name in ("captures", "neighbours", "outlines", "seed")}
    rounds = []
    with tempfile.TemporaryDirectory() as folder:
        manifest = generate_dataset(dataset, Path(folder))
        shards = [Shard(Path(folder) / name) for name in manifest["shards"]]
    for _ in range(1 + repeats):
        began = time.process_time()
        made = [maps_of_shard(shard, setups=Setups.from_config(train.setup), **options)
                for shard in shards]
        rounds.append(time.process_time() - began)
    used = sum(len(np.unique(maps.index)) for maps in made)
    seconds = [spent / used for spent in rounds[1:]]
    print(f"  maps: {min(seconds):.3f} CPU-seconds a drape", flush=True)
    return {"drapes": used, "edge_mm": edge_mm, **options,
            "rows_per_drape": sum(map(len, made)) / used, "cpu_seconds_per_drape": min(seconds),
            "cpu_seconds_of_rounds": seconds}


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
    """Time one core and several processes, then maps."""
    for key in ("drapes", "workers", "repeats", "maps_drapes"):
        if config[key] < 1:
            raise InputError(f"{key}={config[key]} must be at least 1")
    fabrics = [prior_fabric(k, config["seed"]) for k in range(config["drapes"])]
    found = throughput(fabrics, edge_mm=config["edge_mm"], workers=config["workers"],
                       repeats=config["repeats"])
    maps = maps_seconds(config["maps_drapes"], edge_mm=config["maps_edge_mm"], seed=config["seed"],
                        repeats=config["repeats"])
    return Result({"dtype": "float64", **found, "maps": maps})
