"""Check and time the batched direct solver: ``python -m benchmarks.linear [key=value ...]``.

Hessians of drapes in all stages are solved in batches and, one after another, by the sparse solver
of single drapes: residuals, agreement on which matrices are positive definite, time and memory.

Keys (``key=value``):

    matrices     Hessians of the residual's check; more than the largest batch
    edge_mm      edges at the rim of their mesh
    edges_mm     the same of the timing
    batches      samples at a time
    threads      of the batched solver; the other one has a single thread
    repeats      of each timing, of which the fastest counts
    device       of the batched solver: cpu or cuda
    out          the report, JSON; the picture beside it
"""

import os

# The other solver has one thread, and PyTorch what `threads` says.
for _name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[_name] = "1"

import ctypes  # noqa: E402
import resource  # noqa: E402
import time  # noqa: E402
from collections.abc import Callable  # noqa: E402
from dataclasses import dataclass, replace  # noqa: E402
from pathlib import Path  # noqa: E402

import matplotlib  # noqa: E402
import numpy as np  # noqa: E402
import torch  # noqa: E402

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402

from benchmarks.common import (  # noqa: E402
    REPORTS,
    parse_settings,
    table,
    tick_short_scales,
    write_figure,
    write_report,
)
from common.cli import run_command  # noqa: E402
from common.errors import InputError  # noqa: E402
from data.fabrics import fabric_from_theta  # noqa: E402
from data.prior import load_prior, sample_admissible  # noqa: E402
from data.sampling import Stream, stream  # noqa: E402
from sim.cloth import Cloth  # noqa: E402
from sim.drape import drape, scene_on, start_positions  # noqa: E402
from sim.linear import SparsePattern, available_solvers, make_solver  # noqa: E402
from sim.linear.multifrontal import FrontalSolver  # noqa: E402
from sim.material import REFERENCE_DENSITY  # noqa: E402
from sim.mesh.specimens import TOPOLOGIES, make_specimen  # noqa: E402
from sim.newton import NewtonOptions  # noqa: E402
from sim.potential import Potential  # noqa: E402
from sim.scene import Rig  # noqa: E402
from sim.sensitivity.parameters import hessian_product  # noqa: E402

DEFAULTS = {
    "matrices": 100,
    "edge_mm": 4.0,
    "edges_mm": [4.0, 2.0],
    "batches": [1, 4, 16],
    "threads": [1, 2],
    "repeats": 4,
    "device": "cpu",
    "out": str(REPORTS / "linear.json"),
}
STAGES = (0, 3, 10, 400)  # Newton steps on the final mesh; the last reach equilibrium


@dataclass(frozen=True)
class Sample:
    """A drape's Hessians.

    Attributes:
        potential, q: whose and where.
        exact, convex: CSR data in the potential's pattern.
    """

    potential: Potential
    q: np.ndarray
    exact: np.ndarray
    convex: np.ndarray

    def residual(self, x: np.ndarray, rhs: np.ndarray, *, convex: bool) -> float:
        """Relative residual of a solution x (m,) for a right-hand side (m,).

        The Hessian is summed from the energies' own blocks.
        """
        potential = self.potential
        product = hessian_product(potential.energies, self.q, potential.all_unknowns(x),
                                  convex=convex)
        error = potential.free_unknowns(product) - rhs
        return float(np.linalg.norm(error) / np.linalg.norm(rhs))


@dataclass(frozen=True)
class Samples:
    """Hessians on one mesh: their pattern, the places (m, 2) of their unknowns, and each one."""

    pattern: SparsePattern
    places: np.ndarray
    drapes: list[Sample]

    def data(self, kind: str) -> np.ndarray:
        """(B, nnz) data of the Hessians, ``kind`` "exact" or "convex"."""
        return np.stack([getattr(sample, kind) for sample in self.drapes])


def make_samples(count: int, edge_mm: float, stages: tuple[int, ...]) -> Samples:
    """Hessians of ``count`` fabrics of the prior on one mesh, stage after stage."""
    prior, rig, edge = load_prior("gaussian"), Rig(), 1e-3 * edge_mm
    specimen = make_specimen(rig, edge=edge)
    scene, mesh = scene_on(specimen, rig), specimen.mesh
    drapes = []
    for number in range(count):
        theta, _ = sample_admissible(prior, stream(77, Stream.FABRIC, number))
        fabric = fabric_from_theta(theta).at_density(REFERENCE_DENSITY)
        steps = stages[number % len(stages)]
        seed = TOPOLOGIES * number  # all on the first triangulation
        if steps:
            options = NewtonOptions(residual=1e-4, step=1e-4, max_iterations=steps)
            state = drape(fabric, rig=rig, edge=edge, seed=seed, options=options).state
        else:
            state = scene.state(
                start_positions(specimen, rig, coarse=None, start="sine", seed=seed))
        potential = Cloth(scene, fabric).potential
        exact, convex = (potential.hessian(state.q, c) for c in (0.0, 1.0))
        drapes.append(Sample(potential, state.q, exact, convex))
    middles = mesh.rest[mesh.edges].mean(axis=1)
    places = np.concatenate([np.repeat(mesh.rest, 3, axis=0), middles])
    free = potential.free_unknowns(np.arange(potential.unknowns))
    return Samples(potential.pattern, places[free], drapes)


def check(samples: Samples, device: str) -> dict:
    """Residuals of convex Hessians; which exact ones are positive definite for both solvers."""
    solver = FrontalSolver(samples.pattern, samples.places, device=device)
    rng = np.random.default_rng(0)
    residuals, definite, agree = [], 0, 0
    for first in range(0, len(samples.drapes), 10):
        part = replace(samples, drapes=samples.drapes[first : first + 10])
        for kind in ("convex", "exact"):
            values = torch.from_numpy(part.data(kind)).to(device)
            found = solver.factorise(values).tolist()
            rhs = rng.standard_normal((len(part.drapes), len(samples.places)))
            x = solver.solve(torch.from_numpy(rhs).to(device)).cpu().numpy()
            for k, sample in enumerate(part.drapes):
                if found[k]:
                    residuals.append(sample.residual(x[k], rhs[k], convex=kind == "convex"))
                if kind == "exact":
                    definite += found[k]
                    agree += found[k] == make_solver(samples.pattern).factorise(sample.exact)
                elif not found[k]:
                    residuals.append(np.inf)
    return {
        "matrices": len(samples.drapes),
        "systems_solved": len(residuals),
        "largest_residual": float(max(residuals)),
        "median_residual": float(np.median(residuals)),
        "exact_positive_definite": definite,
        "definiteness_agrees": agree,
    }


def counts(solver: FrontalSolver, pattern: SparsePattern) -> dict:
    """What the analysis says of a factorisation."""
    return {
        "unknowns": pattern.size,
        "matrix_entries": len(pattern.indices),
        "factor_entries": solver.fronts.factor_entries,
        "gflop": solver.fronts.flops / 1e9,
        "gflop_carried_out": solver.fronts.padded_flops / 1e9,
    }


def fastest(work: list[Callable[[], object]], repeats: int) -> list[float]:
    """Least seconds of each, taken in turns, so that a busy machine is the same to all."""
    least = [np.inf] * len(work)
    for _ in range(repeats + 1):
        for k, one in enumerate(work):
            began = time.perf_counter()
            one()
            least[k] = min(least[k], time.perf_counter() - began)
    return least


def time_batches(
    edge_mm: float, samples: Samples, solver: FrontalSolver, config: dict
) -> list[dict]:
    """Milliseconds a sample for each batch size and number of threads, both solvers."""
    sample, device = samples.drapes[0], config["device"]
    # Several at a time, so that memory set free before cannot hide them.
    began = _resident()
    others = [make_solver(samples.pattern) for _ in range(4)]
    for other in others:
        other.factorise(sample.convex)
    other_memory = (_resident() - began) / len(others)
    del others
    data = samples.data("convex")
    right = np.ones(len(samples.places))
    rows = []
    for threads in config["threads"]:
        torch.set_num_threads(threads)
        for batch in config["batches"]:
            values = torch.from_numpy(data[np.arange(batch) % len(data)]).to(device)
            rhs = torch.ones(batch, len(right), dtype=torch.float64, device=device)

            def factorise(values=values) -> bool:
                return bool(solver.factorise(values).all())  # waits for the device

            def solve(rhs=rhs) -> float:
                return solver.solve(rhs).sum().item()

            seconds = fastest(
                [factorise, solve, lambda: other.factorise(sample.convex),
                 lambda: other.solve(right)],
                config["repeats"],
            )
            rows.append({
                "edge_mm": edge_mm,
                "threads": threads,
                "batch": batch,
                "factor_ms": 1e3 * seconds[0] / batch,
                "solve_ms": 1e3 * seconds[1] / batch,
                "memory_MiB": solver.nbytes / batch / 2**20,
                "single_factor_ms": 1e3 * seconds[2],
                "single_solve_ms": 1e3 * seconds[3],
                "single_memory_MiB": other_memory,
            })
    torch.set_num_threads(1)
    return rows


def _resident() -> float:
    """Memory of this process in use now, MiB."""
    ctypes.CDLL(None).malloc_trim(0)
    with open("/proc/self/statm", encoding="ascii") as file:
        return int(file.read().split()[1]) * resource.getpagesize() / 2**20


def picture(rows: list[dict], path: Path) -> None:
    """Times against batch size, a line a mesh and number of threads."""
    figure, axis = plt.subplots(figsize=(6, 5))
    for edge_mm in dict.fromkeys(row["edge_mm"] for row in rows):
        own = [row for row in rows if row["edge_mm"] == edge_mm]
        for threads in dict.fromkeys(row["threads"] for row in own):
            chosen = [row for row in own if row["threads"] == threads]
            axis.plot([r["batch"] for r in chosen],
                      [r["factor_ms"] + r["solve_ms"] for r in chosen], "o-",
                      label=f"{edge_mm:g} mm, {threads} thread{'s' * (threads > 1)}")
        least = min(r["single_factor_ms"] + r["single_solve_ms"] for r in own)
        axis.axhline(least, color="0.5", linestyle=":", label=f"{edge_mm:g} mm, one by one")
    axis.set(xscale="log", yscale="log", xlabel="batch", ylabel="factor and solve, ms a sample")
    tick_short_scales(axis.xaxis, axis.yaxis)
    axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.13), ncol=3, fontsize="small")
    figure.tight_layout()
    write_figure(path, figure)


def main(argv: list[str]) -> None:
    """Run, print the tables, and write the report."""
    config = parse_settings(DEFAULTS, argv)
    if config["device"] == "cuda" and not torch.cuda.is_available():
        raise InputError("device=cuda: PyTorch finds no such device here")
    torch.set_num_threads(1)
    report = {"dtype": "float64", "single_solver": available_solvers()[0],
              "settings": {k: v for k, v in config.items() if k != "out"}}
    samples = make_samples(config["matrices"], config["edge_mm"], STAGES)
    report["check"] = check(samples, config["device"])
    print(", ".join(f"{k} {v:.3g}" for k, v in report["check"].items()), flush=True)
    report["counts"], report["times"] = [], []
    for edge_mm in config["edges_mm"]:
        samples = make_samples(4, edge_mm, (0,))
        began = time.perf_counter()
        solver = FrontalSolver(samples.pattern, samples.places, device=config["device"])
        found = {"edge_mm": edge_mm, **counts(solver, samples.pattern),
                 "analysis_s": time.perf_counter() - began}
        report["counts"].append(found)
        print(", ".join(f"{k} {v:.4g}" for k, v in found.items()), flush=True)
        report["times"] += time_batches(edge_mm, samples, solver, config)
    print(table(report["times"][0], [row.values() for row in report["times"]]))
    path = Path(config["out"])
    picture(report["times"], path.with_suffix(".png"))
    write_report(path, report)


if __name__ == "__main__":
    run_command(main, usage=__doc__)
