"""Many drapes at once: ``python -m benchmarks.batched [key=value ...]``.

First, drapes a second by worker processes that make each on its own and are there (they stay
between calls), against one core that makes one after the other, on the fabrics of
``benchmarks.speed``; in turn, several times, and the shortest of each reported. Then drapes
minimised together, on a CPU or a GPU: time a drape against batch size and mesh, where it
goes, memory, and whether the same drapes come out.

Keys (``key=value``):

    device       of the drapes minimised together, cpu or cuda
    drapes       fabrics of the first part; 0 to leave it out
    seed         of the fabrics
    workers      processes
    repeats      rounds of the first part
    edge_mm      edges at the rim in the first part; 0: as the simulator chooses by itself
    batches      drapes minimised together; 0 to leave the second part out
    edges_mm     the same of the drapes minimised together
    threads      of the drapes minimised together, on a CPU
    check        drapes compared with the CPU's: on a GPU those minimised together there, on a
                 CPU those made each on its own
    out          the report, JSON
"""

import benchmarks.one_thread  # noqa: F401

# isort: split
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import torch

from benchmarks.common import REPORTS, parse_settings, table, write_report
from benchmarks.speed import peak_memory, prior_fabrics
from common.cli import run_command
from common.errors import InputError
from common.workers import worker_pool
from sim.batch import drape_batch
from sim.batch.device import DeviceCloths
from sim.drape import DrapeResult, drape
from sim.material import Fabric
from sim.mesh.specimens import TOPOLOGIES

DEFAULTS = {
    "device": "cpu",
    "drapes": 32,
    "seed": 77,
    "workers": 2,
    "repeats": 9,
    "edge_mm": 0.0,
    "batches": [1, 4, 16],
    "edges_mm": [4.0],
    "threads": 1,
    "check": 4,
    "out": str(REPORTS / "batched.json"),
}
SAME = 1e-6  # m, between vertices of the same drape
CALCULATIONS = {"values": "energy", "gradients": "gradient", "factorise": "Hessian and factor",
                "solve": "solution"}
"""Methods of :class:`sim.batch.device.DeviceCloths`, and what they calculate."""


def throughput(
    fabrics: list[Fabric], *, edge_mm: float, workers: int, repeats: int
) -> dict:
    """One core against several, in turn: whole rounds over the fabrics, and their ratio."""
    drape(fabrics[0], edge=4e-3)  # compiles or loads the kernels
    edge = 1e-3 * edge_mm or None
    start = start_seconds(fabrics[0], workers)
    single, several = [], []
    for repeat in range(repeats):
        began, busy = time.perf_counter(), time.process_time()
        alone = [drape(fabric, edge=edge, seed=seed) for seed, fabric in enumerate(fabrics)]
        single.append((time.perf_counter() - began, time.process_time() - busy))
        start_seconds(fabrics[0], workers)  # processes are there
        began = time.perf_counter()
        made = drape_batch(fabrics, edge=edge, workers=workers)
        several.append(time.perf_counter() - began)
        print(f"  round {repeat + 1} of {repeats}: one core {single[-1][0]:.1f} s, "
              f"{workers} processes {several[-1]:.1f} s", flush=True)
    wall, busy = (min(times) for times in zip(*single, strict=True))
    ratios = [one[1] / many for one, many in zip(single, several, strict=True)]
    return {
        "drapes": len(fabrics),
        "workers": workers,
        "converged": sum(result.converged for result in made),
        "largest_difference_m": max(map(apart, alone, made)),
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
    """Seconds until worker processes are at work; they stay for the next call."""
    began = time.perf_counter()
    made = drape_batch([fabric] * workers, edge=0.01, workers=workers)
    return time.perf_counter() - began - max(result.seconds for result in made)


def apart(a: DrapeResult, b: DrapeResult) -> float:
    """Largest distance, m, between the same vertex of two drapes."""
    return float(np.linalg.norm(a.positions - b.positions, axis=1).max())


def together(fabrics: list[Fabric], *, edge_mm: float, device: str) -> dict:
    """Figures of drapes minimised together, all at once, kernels at hand."""
    settings = {"edge": 1e-3 * edge_mm or None, "device": device, "together": True}
    drape_batch(fabrics[:1], **settings)
    if device != "cpu":
        torch.cuda.reset_peak_memory_stats()
    with timed_calculations() as spent:
        began = time.perf_counter()
        made = drape_batch(fabrics, seeds=seeds_of_one_topology(len(fabrics)), **settings,
                           at_a_time=len(fabrics))
        seconds = time.perf_counter() - began
    memory = peak_memory() if device == "cpu" else torch.cuda.max_memory_allocated() / 1024**3
    spent["rest"] = seconds - sum(spent.values())
    return {
        "batch": len(fabrics),
        "edge_mm": edge_mm or "default",
        "seconds_per_drape": seconds / len(fabrics),
        "drapes_per_second": len(fabrics) / seconds,
        "converged": sum(result.converged for result in made),
        "touching_themselves": sum(result.touches for result in made),
        "mean_newton_steps": float(np.mean([result.iterations for result in made])),
        "share_by_activity": {k: v / seconds for k, v in spent.items()},
        "peak_memory_GiB": round(memory, 2),
    }


@contextmanager
def timed_calculations() -> Iterator[dict[str, float]]:
    """Wall seconds that batches calculate in the block, by what they calculate."""
    spent = dict.fromkeys(CALCULATIONS.values(), 0.0)
    plain = {method: getattr(DeviceCloths, method) for method in CALCULATIONS}

    def timing(method: str) -> Callable[..., list]:
        def call(cloths: DeviceCloths, asked: list) -> list:
            began = time.perf_counter()
            found = plain[method](cloths, asked)  # numbers of the host: the device has finished
            spent[CALCULATIONS[method]] += time.perf_counter() - began
            return found

        return call

    for method in CALCULATIONS:
        setattr(DeviceCloths, method, timing(method))
    try:
        yield spent
    finally:
        for method, function in plain.items():
            setattr(DeviceCloths, method, function)


def seeds_of_one_topology(count: int) -> list[int]:
    """Seeds of other starts on one triangulation, whose drapes form one batch."""
    return [TOPOLOGIES * k for k in range(count)]


def agreement(fabrics: list[Fabric], *, edge_mm: float, device: str) -> dict:
    """Drapes minimised together on ``device``, against the CPU's."""
    settings = {"edge": 1e-3 * edge_mm or None, "seeds": seeds_of_one_topology(len(fabrics))}
    found = drape_batch(fabrics, **settings, device=device, together=True)
    # On a CPU both ways differ in rounding from the first step on, and by the rough factors of
    # single drapes, so that some fabrics may find other folds.
    expected = drape_batch(fabrics, **settings, together=device != "cpu", workers=1)
    distances = [apart(*pair) for pair in zip(found, expected, strict=True)]
    return {
        "drapes": len(fabrics),
        "distances_m": distances,
        "same_shape": sum(distance <= SAME for distance in distances),
        "largest_distance_of_same_m": max((d for d in distances if d <= SAME), default=None),
    }


def main(argv: list[str]) -> None:
    """Run, print the tables, and write the report."""
    config = parse_settings(DEFAULTS, argv)
    for key in ("workers", "repeats", "threads"):
        if config[key] < 1:
            raise InputError(f"{key}={config[key]} must be at least 1")
    device = config["device"]
    drape_batch([], device=device)  # refuses one that is not there
    batches = [count for count in config["batches"] if count > 0]
    fabrics = prior_fabrics(max([config["drapes"], config["check"], *batches]), config["seed"])
    report = {"dtype": "float64", "settings": {k: v for k, v in config.items() if k != "out"}}
    if device == "cuda":
        report["gpu"] = torch.cuda.get_device_name()
    if config["drapes"]:
        report["each_on_its_own"] = part = throughput(
            fabrics[: config["drapes"]], edge_mm=config["edge_mm"],
            workers=config["workers"], repeats=config["repeats"])
        print(f"each on its own, {part['drapes']} drapes: one core "
              f"{part['drapes_per_second_one_core']:.3f} a second, {part['workers']} processes "
              f"{part['drapes_per_second_workers']:.3f}, {part['ratio']:.2f} times as many "
              f"({part['median_ratio']:.2f} in the median round; "
              f"{part['ratio_from_their_start']:.2f} with their start, "
              f"{part['start_seconds_of_workers']:.1f} s at the first call); "
              f"largest difference {part['largest_difference_m']:.1e} m\n")
    if batches:
        report["together"] = rows = []
        for edge_mm in config["edges_mm"]:
            for count in batches:
                settings = {"edge_mm": edge_mm, "device": device}
                if device == "cpu":  # a fresh process, for its peak memory
                    with worker_pool(1, torch.set_num_threads, config["threads"]) as pool:
                        rows.append(pool.submit(together, fabrics[:count], **settings).result())
                else:
                    rows.append(together(fabrics[:count], **settings))
        print(f"together, device={device}")
        activities = list(rows[0]["share_by_activity"])
        print(table(
            ["edges at the rim, mm", "batch", "ms a drape", "converged", "touching themselves",
             *(f"{name}, %" for name in activities), "peak memory, GiB"],
            [[row["edge_mm"], row["batch"], round(1e3 * row["seconds_per_drape"]),
              row["converged"], row["touching_themselves"],
              *(round(100 * row["share_by_activity"][name]) for name in activities),
              row["peak_memory_GiB"]] for row in rows]))
    if config["check"]:
        report["agreement"] = same = agreement(
            fabrics[: config["check"]], edge_mm=config["edges_mm"][0], device=device)
        print(f"\n{same['same_shape']} of {same['drapes']} drapes are the CPU's to {SAME:.0e} m; "
              "distances, m: " + ", ".join(f"{d:.1e}" for d in same["distances_m"]))
    write_report(Path(config["out"]), report)


if __name__ == "__main__":
    run_command(main, usage=__doc__)
