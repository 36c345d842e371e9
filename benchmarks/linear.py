"""Check and time the batched direct solver: ``python -m benchmarks.linear [key=value ...]``.

Hessians of drapes in all stages are solved in batches and, one after another, by the sparse solver
of single drapes: residuals, agreement on which matrices are positive definite, time and memory.

Keys (``key=value``):

    matrices     Hessians of the residual's check; more than the largest batch
    vertices     a side, of the check
    resolutions  vertices a side, of the timing
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
from dataclasses import dataclass  # noqa: E402
from pathlib import Path  # noqa: E402

import matplotlib  # noqa: E402
import numpy as np  # noqa: E402
import torch  # noqa: E402

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402
from sim.specimens import make_specimen  # noqa: E402

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
from sim.drape import drape  # noqa: E402
from sim.energies.base import SeldomEnergy  # noqa: E402
from sim.equilibrium import build_potential  # noqa: E402
from sim.grid_unknowns import GridUnknowns  # noqa: E402
from sim.initial import initial_positions  # noqa: E402
from sim.linear import SparsePattern, available_solvers, make_solver  # noqa: E402
from sim.linear.multifrontal import LEAF, Analysis, BatchedCholesky, analyse  # noqa: E402
from sim.linear.nested_dissection import dissect  # noqa: E402
from sim.newton import NewtonOptions  # noqa: E402
from sim.potential import Potential  # noqa: E402
from sim.scene import Rig, Scene, State  # noqa: E402
from sim.sensitivity.parameters import hessian_product  # noqa: E402

DEFAULTS = {
    "matrices": 100,
    "vertices": 51,
    "resolutions": [51, 101],
    "batches": [1, 4, 16],
    "threads": [1, 2],
    "repeats": 4,
    "device": "cpu",
    "out": str(REPORTS / "linear.json"),
}
STAGES = (0, 3, 10, 400)  # Newton steps on the final mesh; the last reach equilibrium


@dataclass(frozen=True)
class Sample:
    """A drape's Hessians, in the frames of its edges.

    Attributes:
        potential, y: whose and where.
        pattern: of its own m unknowns.
        exact, convex: CSR data.
        rows: (m,) of the shared numbering.
    """

    potential: Potential
    y: np.ndarray
    pattern: SparsePattern
    exact: np.ndarray
    convex: np.ndarray
    rows: np.ndarray

    def residual(self, inside: np.ndarray, rhs: np.ndarray, convexity: float) -> float:
        """Relative residual of a solution in frames (m,), for a right-hand side by unknowns (m,).

        The Hessian is summed from the energies' own blocks by unknowns, which know of no frames.
        """
        q = self.potential.full(self.y)
        move = np.zeros(len(q))
        move[self.potential.free_part(np.arange(len(q)))] = self.potential.out_of_frames(
            self.y, inside)
        product = hessian_product(self.potential.energies, q, move, convexity=convexity)
        error = self.potential.free_part(product) - rhs
        return float(np.linalg.norm(error) / np.linalg.norm(rhs))


def make_samples(count: int, n: int, stages: tuple[int, ...]) -> tuple[GridUnknowns, list[Sample]]:
    """Hessians of ``count`` fabrics of the prior on meshes of their own, stage after stage.

    But for those of cloth that feels the limit of folds.
    """
    prior, rig = load_prior("gaussian"), Rig()
    specimens = [make_specimen(rig, resolution=n, seed=seed) for seed in range(count)]
    free = np.any([~specimen.held for specimen in specimens], axis=0)
    unknowns = GridUnknowns((n, n), free.reshape(n, n))
    samples = []
    for seed, specimen in enumerate(specimens):
        fabric = fabric_from_theta(
            sample_admissible(prior, stream(77, Stream.FABRIC, seed))[0]
        ).at_density(0.3)
        mesh, held = specimen.mesh, specimen.held
        steps = stages[seed % len(stages)]
        if steps:
            options = NewtonOptions(residual=1e-4, step=1e-4, max_iterations=steps)
            result = drape(fabric, rig=rig, resolution=n, seed=seed, options=options)
            state = State(result.positions, result.rotations)
        else:
            rng = np.random.default_rng(seed)
            positions = initial_positions(mesh.rest, rig=rig, start="sine", rng=rng)
            positions[held] = rig.place(mesh.rest[held])
            state = State.at(mesh, positions)
        scene = Scene(mesh=mesh, held=held, obstacles=rig.obstacles)
        potential = build_potential(scene, fabric, state)
        q = state.unknowns
        chosen = potential.free_part(np.arange(len(q)))
        mask = np.zeros(len(q), dtype=bool)
        mask[chosen] = True
        y = potential.free_part(q)
        if any(e.is_felt(q) for e in potential.energies if isinstance(e, SeldomEnergy)):
            continue  # its matrix has another pattern
        (pattern, exact), (_, convex) = (potential.hessian(y, c) for c in (0.0, 1.0))
        samples.append(Sample(potential, y, pattern, exact, convex,
                              unknowns.rows(mesh, mask)[chosen]))
    return unknowns, samples


def embedded(unknowns: GridUnknowns, samples: list[Sample], kind: str) -> np.ndarray:
    """(B, nnz) data of the samples' Hessians, ``kind`` "exact" or "convex"."""
    return np.stack([
        unknowns.embed(sample.pattern, getattr(sample, kind), sample.rows) for sample in samples
    ])


def check(unknowns: GridUnknowns, samples: list[Sample], device: str) -> dict:
    """Residuals of convex Hessians; which exact ones are positive definite for both solvers."""
    solver = BatchedCholesky(analyse(unknowns.pattern, unknowns.places, device=device))
    rng = np.random.default_rng(0)
    residuals, definite, agree = [], 0, 0
    for first in range(0, len(samples), 10):
        part = samples[first : first + 10]
        for kind in ("convex", "exact"):
            values = embedded(unknowns, part, kind)
            found = solver.factorise(torch.from_numpy(values).to(device)).tolist()
            right = [rng.standard_normal(len(sample.rows)) for sample in part]
            rhs = np.zeros((len(part), unknowns.size))
            for row, sample, own in zip(rhs, part, right, strict=True):
                row[sample.rows] = sample.potential.into_frames(sample.y, own)
            x = solver.solve(torch.from_numpy(rhs).to(device)).cpu().numpy()
            for k, sample in enumerate(part):
                if found[k]:
                    residuals.append(sample.residual(x[k][sample.rows], right[k],
                                                     float(kind == "convex")))
                if kind == "exact":
                    definite += found[k]
                    agree += found[k] == make_solver(sample.pattern).factorise(sample.exact)
                elif not found[k]:
                    residuals.append(np.inf)
    return {
        "matrices": len(samples),
        "systems_solved": len(residuals),
        "largest_residual": float(max(residuals)),
        "median_residual": float(np.median(residuals)),
        "exact_positive_definite": definite,
        "definiteness_agrees": agree,
    }


def counts(analysis: Analysis, pattern: SparsePattern) -> dict:
    """What the analysis says of a factorisation."""
    fronts = analysis.fronts
    return {
        "unknowns": fronts.size,
        "matrix_entries": len(pattern.indices),
        "factor_entries": fronts.factor_entries,
        "largest_front": fronts.largest,
        "front_sizes": fronts.distinct_sizes,
        "heights": len(fronts.levels),
        "groups": len(analysis.groups),
        "calls": analysis.calls,
        "gflop": fronts.flops / 1e9,
        "gflop_carried_out": analysis.padded_flops / 1e9,
        "index_MiB": analysis.index_bytes / 2**20,
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
    unknowns: GridUnknowns, samples: list[Sample], analysis: Analysis, config: dict
) -> list[dict]:
    """Milliseconds a sample for each batch size and number of threads, both solvers."""
    sample, device = samples[0], config["device"]
    # Several at a time, so that memory set free before cannot hide them.
    began = _resident()
    others = [make_solver(sample.pattern) for _ in range(4)]
    for other in others:
        other.factorise(sample.convex)
    other_memory = (_resident() - began) / len(others)
    del others
    data = embedded(unknowns, samples, "convex")
    right = np.ones(len(sample.rows))
    rows = []
    for threads in config["threads"]:
        torch.set_num_threads(threads)
        for batch in config["batches"]:
            values = torch.from_numpy(data[np.arange(batch) % len(data)]).to(device)
            rhs = torch.ones(batch, unknowns.size, dtype=torch.float64, device=device)
            solver = BatchedCholesky(analysis)

            def factorise(solver=solver, values=values) -> bool:
                return bool(solver.factorise(values).all())  # waits for the device

            def solve(solver=solver, rhs=rhs) -> float:
                return solver.solve(rhs).sum().item()

            seconds = fastest(
                [factorise, solve, lambda: other.factorise(sample.convex),
                 lambda: other.solve(right)],
                config["repeats"],
            )
            rows.append({
                "vertices": unknowns.shape[0],
                "threads": threads,
                "batch": batch,
                "factor_ms": 1e3 * seconds[0] / batch,
                "solve_ms": 1e3 * seconds[1] / batch,
                "memory_MiB": solver.nbytes / batch / 2**20,
                "single_factor_ms": 1e3 * seconds[2],
                "single_solve_ms": 1e3 * seconds[3],
                "single_memory_MiB": other_memory,
            })
            del solver
    torch.set_num_threads(1)
    return rows


def _resident() -> float:
    """Memory of this process in use now, MiB."""
    ctypes.CDLL(None).malloc_trim(0)
    with open("/proc/self/statm", encoding="ascii") as file:
        return int(file.read().split()[1]) * resource.getpagesize() / 2**20


def picture(unknowns: GridUnknowns, rows: list[dict], path: Path) -> None:
    """The heights at which a grid's unknowns are eliminated, and the times."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 5))
    pattern = unknowns.pattern
    tree = dissect(pattern.indptr, pattern.indices, unknowns.places, leaf=LEAF)
    for pivots, height in zip(tree.pivots, tree.height, strict=True):
        left.scatter(*unknowns.places[pivots].T, s=5, c=np.full(len(pivots), height),
                     cmap="viridis_r", vmin=0, vmax=tree.height.max(), linewidths=0)
    left.set_aspect("equal")
    left.set_title("order of elimination: the darker, the later")
    left.set_axis_off()
    for vertices in dict.fromkeys(row["vertices"] for row in rows):
        for threads in dict.fromkeys(row["threads"] for row in rows):
            chosen = [r for r in rows if (r["vertices"], r["threads"]) == (vertices, threads)]
            right.plot([r["batch"] for r in chosen],
                       [r["factor_ms"] + r["solve_ms"] for r in chosen], "o-",
                       label=f"{vertices} × {vertices}, {threads} thread{'s' * (threads > 1)}")
        least = min(r["single_factor_ms"] + r["single_solve_ms"]
                    for r in rows if r["vertices"] == vertices)
        right.axhline(least, color="0.5", linestyle=":",
                      label=f"{vertices} × {vertices}, one by one")
    right.set(xscale="log", yscale="log", xlabel="batch", ylabel="factor and solve, ms a sample")
    tick_short_scales(right.xaxis, right.yaxis)
    right.legend(loc="upper center", bbox_to_anchor=(0.5, -0.13), ncol=3, fontsize="small")
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
    unknowns, samples = make_samples(config["matrices"], config["vertices"], STAGES)
    report["check"] = check(unknowns, samples, config["device"])
    print(", ".join(f"{k} {v:.3g}" for k, v in report["check"].items()), flush=True)
    report["counts"], report["times"] = [], []
    shown = unknowns
    for n in config["resolutions"]:
        unknowns, samples = make_samples(4, n, (0,))
        began = time.perf_counter()
        analysis = analyse(unknowns.pattern, unknowns.places, device=config["device"])
        found = {"vertices": n, **counts(analysis, unknowns.pattern),
                 "analysis_s": time.perf_counter() - began}
        report["counts"].append(found)
        print(", ".join(f"{k} {v:.4g}" for k, v in found.items()), flush=True)
        report["times"] += time_batches(unknowns, samples, analysis, config)
    print(table(report["times"][0], [row.values() for row in report["times"]]))
    path = Path(config["out"])
    picture(shown, report["times"], path.with_suffix(".png"))
    write_report(path, report)


if __name__ == "__main__":
    run_command(main, usage=__doc__)
