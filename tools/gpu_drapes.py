"""Measure batches of drapes on an accelerator, and compare some with the CPU's:

    python tools/gpu_drapes.py prepare FILE            # fabrics of the prior, minima of the CPU
    python tools/gpu_drapes.py run FILE [--device cuda] [--count 256] [--cores N] [--out DIR]
    python tools/gpu_drapes.py count FILE --device cpu --count 64 --slots 8 --edge-mm 14

``run`` writes ``gpu_drapes.json`` and the drapes' positions, ``drapes.npz``, to DIR or $OUT. It
needs PyTorch, NumPy, SciPy, Numba and tqdm only. With --cores N, N processes simulate the same
drapes on the CPU, which needs pypardiso, too, and continue those that the accelerator does not
finish. Without ipctk, self-intersections are not looked for, and without both, unfinished drapes
are not continued; ``check FILE --out DIR`` looks for intersections later.

``in_lock`` is the number of steps that the slots take together, times the slots over all steps of
all drapes: 1 if no slot is ever empty. It hardly depends on the mesh, and not on the device:
``count`` counts for a disc that is not continued, on any machine.
"""

import argparse
import json
import os
import sys
import time
import types
from collections import Counter, defaultdict
from collections.abc import Callable
from concurrent.futures import Executor
from contextlib import contextmanager, nullcontext
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
if find_spec("threadpoolctl") is None:  # which only limits threads
    stand_in = types.ModuleType("threadpoolctl")
    stand_in.threadpool_limits = types.SimpleNamespace(wrap=lambda **_: lambda function: function)
    sys.modules["threadpoolctl"] = stand_in

import torch

from common.workers import worker_pool
from sim import equilibrium
from sim.batched import drapes as batched
from sim.batched import newton
from sim.batched.lowered import columns
from sim.batched.potential import BatchedPotential
from sim.batched.solver import BatchedSolver
from sim.cloth import Cloth
from sim.draping import Drape, drape, follow
from sim.material import Fabric
from sim.mesh.specimen import TOPOLOGIES
from sim.rig import DISC_RIG, SQUARE_RIG
from sim.scene import make_specimen
from sim.solver.linear import make_solver
from sim.solver.newton import NewtonOptions

RIGS = (DISC_RIG, SQUARE_RIG)
EDGE = 6e-3  # m
TIGHT = NewtonOptions(residual=1e-7, step=1e-5, max_iterations=100)
SEED, FABRICS, NEAR = 77, 512, 8
BESIDE = 2e-5  # m, deviation of a start from its minimum


def prepare(file: Path, count: int, near: int) -> None:
    """Fabrics of the prior, and the minima of the first few on each rig, found on the CPU."""
    from data.dataset.plan import Stream, stream
    from data.fabrics.fabrics import from_theta
    from data.fabrics.prior import load_prior, sample_admissible

    prior = load_prior("gaussian")
    thetas = [sample_admissible(prior, stream(SEED, Stream.FABRIC, k))[0] for k in range(count)]
    alpha, beta = from_theta(np.array(thetas))
    arrays = {"alpha": alpha, "beta": beta}
    for rig in RIGS:
        found, began = [], time.process_time()
        for k in range(near):
            fabric = Fabric(alpha[k], beta[k])
            one = drape(fabric, rig=rig, edge=EDGE, seed=k * TOPOLOGIES)
            found.append(follow(one, fabric, options=TIGHT))
        arrays[rig.name] = np.array([one.positions for one in found])
        print(rig.name, Counter(one.status.value for one in found),
              f"{(time.process_time() - began) / near:.2f} CPU-seconds a drape")
    np.savez_compressed(file, **arrays)


def fabrics_of(file: Path) -> list[Fabric]:
    """Those that are prepared in a file."""
    data = np.load(file)
    return [Fabric(*moduli) for moduli in zip(data["alpha"], data["beta"], strict=True)]


class Clock:
    """Seconds and calls of parts of a program; on a device each part is waited for."""

    def __init__(self, device: str) -> None:
        self.seconds, self.calls = defaultdict(float), Counter()
        self.device = device

    def watch(self, owner: object, attribute: str, name: Callable[..., str] | str) -> Callable:
        """Replace a function by one that is timed; the function."""
        function = getattr(owner, attribute)

        def timed(*args: object, **options: object) -> object:
            key = name(*args) if callable(name) else name
            self.wait()
            began = time.perf_counter()
            try:
                return function(*args, **options)
            finally:
                self.wait()
                self.seconds[key] += time.perf_counter() - began
                self.calls[key] += 1

        setattr(owner, attribute, timed)
        return function

    def wait(self) -> None:
        """Until the device has done its work."""
        if self.device != "cpu":
            torch.cuda.synchronize()

    def table(self) -> dict[str, tuple[float, int]]:
        """Seconds and calls by name."""
        return {key: (round(self.seconds[key], 3), self.calls[key]) for key in self.seconds}


STAGES = ((batched, "lowered", "lowering"), (batched, "BatchedPotential", "potentials"),
          (batched, "prolonged", "prolongation"), (batched, "equilibrium_of", "results"),
          (batched, "self_intersections", "intersections"),
          (batched, "minimise", lambda p, *_: f"minimise {p.unknowns}"))
PARTS = ((BatchedPotential, "evaluate", "evaluate"), (BatchedPotential, "hessian", "hessian"),
         (BatchedPotential, "moved", "move"), (BatchedSolver, "factorise", "factorise"),
         (BatchedSolver, "solve", "solve"), (newton.Minimisation, "iterate", "iterations"))


@contextmanager
def watched(clock: Clock, places: tuple):
    """The functions at ``places`` timed by the ``clock``."""
    kept = [(owner, attribute, clock.watch(owner, attribute, name))
            for owner, attribute, name in places]
    try:
        yield
    finally:
        for owner, attribute, function in kept:
            setattr(owner, attribute, function)


def planned(rig, fabrics: list[Fabric], edge: float = EDGE) -> list[dict]:
    """The arguments of their drapes."""
    return [{"fabric": fabric, "rig": rig, "edge": edge, "seed": k * TOPOLOGIES}
            for k, fabric in enumerate(fabrics)]


def as_here(function: Callable[..., Drape], *arguments: object, **settings: object) -> Drape:
    """The result of a function, without self-intersections where they cannot be found."""
    if find_spec("ipctk") is None:
        equilibrium.self_intersections = lambda *_: ()
    return function(*arguments, **settings)


def on_cpu(plan: dict) -> Drape:
    """A drape by the simulator on the CPU."""
    return as_here(drape, **plan)


def on_cores(rig, fabrics: list[Fabric], cores: int, pool: Executor) -> dict:
    """Speed of processes on the CPU, as of :func:`sim.many.drape_many` once they have begun."""
    plans = planned(rig, fabrics)
    list(pool.map(on_cpu, [plans[0]] * 2 * cores))
    began = time.perf_counter()
    made = list(pool.map(on_cpu, plans))
    seconds = time.perf_counter() - began
    pattern = Cloth(made[0].scene, fabrics[0]).potential.pattern
    iterations = np.percentile([one.iterations for one in made], (0, 50, 90, 100))
    return {"cores": cores, "solver": type(make_solver(pattern)).__name__,
            "seconds": round(seconds, 2),
            "drapes_per_s": round(sum(one.converged for one in made) / seconds, 2),
            "verified": sum(one.converged for one in made),
            "cpu_s_per_drape": round(float(np.mean([one.outcome.seconds for one in made])), 3),
            "iterations": iterations.tolist()}


def in_lock(clock: Clock, drapes: list[Drape], slots: int) -> dict:
    """Steps of the slots, the mean number of a drape's, and their ratio for equal work."""
    steps, mean = clock.calls["iterations"], float(np.mean([one.iterations for one in drapes]))
    slots = min(slots, len(drapes))
    return {"slots": slots, "steps": steps, "steps_per_drape": round(mean, 1),
            "in_lock": round(steps * slots / len(drapes) / mean, 3)}


def counted(fabrics: list[Fabric], device: str, slots: int, edge: float) -> dict:
    """The steps of discs of some ``fabrics``."""
    clock = Clock(device)
    with watched(clock, PARTS[-1:]), as_they_are(0) as pool:
        drapes = batched.drape_batch(planned(DISC_RIG, fabrics, edge), device, pool=pool,
                                     slots=slots)
    return in_lock(clock, drapes, slots) | {
        "statuses": Counter(one.status.value for one in drapes)}


def measure(rig, fabrics: list[Fabric], device: str, slots: int) -> tuple[dict, np.ndarray]:
    """Speed of a batch, by stage, then by part of an iteration; its positions."""
    plans, report = planned(rig, fabrics), {}
    for kind, places in (("stages", STAGES), ("parts", PARTS)):
        if device != "cpu":
            torch.cuda.reset_peak_memory_stats()
        clock, began = Clock(device), time.perf_counter()
        with watched(clock, places):
            drapes = batched.drape_batch(plans, device, slots=slots)
        seconds = time.perf_counter() - began
        report[kind] = {"seconds": round(seconds, 2), "drapes_per_s": round(
            sum(one.converged for one in drapes) / seconds, 2), "of": clock.table()}
        if device != "cpu":
            report[kind]["peak_GB"] = round(torch.cuda.max_memory_allocated() / 1e9, 2)
    iterations = np.array([one.iterations for one in drapes])
    report |= {
        "drapes": len(drapes), "pool": in_lock(clock, drapes, slots),
        "verified": sum(one.converged for one in drapes),
        "statuses": Counter(one.status.value for one in drapes),
        "coarse": Counter("/".join(status.value for status in one.coarse) for one in drapes),
        "iterations": np.percentile(iterations, (0, 50, 90, 100)).tolist(),
        "worst_residual": max(one.outcome.residual for one in drapes if one.converged)}
    return report, np.array([one.positions for one in drapes], np.float32)


@contextmanager
def as_they_are(_: int):
    """In place of processes that continue unfinished drapes."""
    yield types.SimpleNamespace(submit=lambda _, made, *__: types.SimpleNamespace(
        result=lambda: made))


def compare(rig, fabrics: list[Fabric], minima: np.ndarray, device: str) -> dict:
    """Distances, m, of minima found from beside those of the CPU."""
    scene, rng = make_specimen(rig, edge=EDGE), np.random.default_rng(0)
    potential = BatchedPotential([Cloth(scene, fabric) for fabric in fabrics[: len(minima)]],
                                 device)
    start = minima + rng.normal(0, BESIDE, minima.shape) * ~scene.held[:, None]
    x = columns(list(start)).to(potential.free.device)
    found = newton.minimise(potential, x, potential.normals(x), TIGHT)
    distance = np.abs(found.x.cpu().numpy().transpose(2, 1, 0) - minima).max(axis=(1, 2))
    return {"distances": distance.tolist(),
            "statuses": [one.status.value for one in found.results]}


def run(
    file: Path, device: str, count: int, out: Path, *, slots: int, cores: int,
    pool: Executor | None
) -> None:
    """All measurements; the first, of few drapes, is to warm up."""
    intersections = find_spec("ipctk") is not None
    if not intersections:
        batched.self_intersections, batched.worker_pool = lambda *_: (), as_they_are
    data, fabrics = np.load(file), fabrics_of(file)
    report = {"torch": torch.__version__, "device": device if device == "cpu" else
              torch.cuda.get_device_name(), "intersections_checked": intersections}
    print(report, flush=True)
    positions = {}
    if pool:
        batched.worker_pool = lambda _: nullcontext(types.SimpleNamespace(
            submit=partial(pool.submit, as_here)))
        pool.submit(on_cpu, planned(RIGS[0], fabrics[:1])[0])  # compiles the simulator meanwhile
    for rig in RIGS:
        began = time.perf_counter()
        comparison = compare(rig, fabrics, data[rig.name], device)
        if device != "cpu":
            batched.drape_batch(planned(rig, fabrics[:2]), device)
        warm_up = time.perf_counter() - began
        measured, positions[rig.name] = measure(rig, fabrics[:count], device, slots)
        report[rig.name] = {"warm_up_s": round(warm_up, 2), "beside": comparison} | measured
        if pool:
            report[rig.name]["on_cores"] = on_cores(rig, fabrics[:count], cores, pool)
        print(rig.name, json.dumps(report[rig.name], indent=1), flush=True)
        (out / "gpu_drapes.json").write_text(json.dumps(report, indent=1))
        np.savez_compressed(out / "drapes.npz", **positions)


def check(out: Path) -> None:
    """Numbers of drapes that intersect themselves."""
    from sim.energies.self_contact import self_intersections

    for rig in RIGS:
        positions, faces = np.load(out / "drapes.npz")[rig.name], make_specimen(
            rig, edge=EDGE).mesh.faces
        crossing = [len(self_intersections(one.astype(float), faces)) > 0 for one in positions]
        print(rig.name, sum(crossing), "of", len(crossing), "intersect themselves")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("prepare", "run", "count", "check"))
    parser.add_argument("file", type=Path)
    parser.add_argument("--device", default="cuda")
    parser.add_argument("--count", type=int, default=256)
    parser.add_argument("--slots", type=int, default=batched.SLOTS)
    parser.add_argument("--edge-mm", type=float, default=1e3 * EDGE)
    parser.add_argument("--cores", type=int, default=0)
    parser.add_argument("--near", type=int, default=NEAR)
    parser.add_argument("--out", type=Path, default=Path(os.environ.get("OUT", ".")))
    words = parser.parse_args()
    if words.what == "prepare":
        prepare(words.file, FABRICS, words.near)
    elif words.what == "run":
        with worker_pool(words.cores) if words.cores else nullcontext() as pool:
            run(words.file, words.device, words.count, words.out, slots=words.slots,
                cores=words.cores, pool=pool)
    elif words.what == "count":
        print(json.dumps(counted(fabrics_of(words.file)[: words.count], words.device, words.slots,
                                 words.edge_mm / 1e3)))
    else:
        check(words.out)


if __name__ == "__main__":
    main()
