"""Check and time the batched direct solver: ``python -m benchmarks.linear [key=value ...]``.

Hessians of drapes of one unstructured mesh in all stages are solved in batches and, one after
another, by the sparse solvers of single drapes: residuals, agreement on which matrices are
positive definite, time and memory.

Keys (``key=value``):

    matrices     Hessians of the check; more than the largest batch
    edge         mean length of the check's edges, mm
    edges        likewise, of the timing
    batches      samples at a time
    threads      of the batched solver; the others have a single thread
    repeats      of each timing, of which the fastest counts
    device       of the batched solver: cpu or cuda
    out          the report, JSON; the picture beside it
"""

import os

# The other solvers have one thread, and PyTorch what `threads` says.
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
from sim.drape import scene_on  # noqa: E402
from sim.equilibrium import find_equilibrium  # noqa: E402
from sim.initial import initial_positions  # noqa: E402
from sim.linear import SparsePattern, available_solvers, make_solver  # noqa: E402
from sim.linear.fronts import front_flops  # noqa: E402
from sim.linear.multifrontal import FrontalSolver  # noqa: E402
from sim.material import REFERENCE_DENSITY  # noqa: E402
from sim.mesh.specimens import make_specimen  # noqa: E402
from sim.newton import NewtonOptions  # noqa: E402
from sim.scene import Rig  # noqa: E402

DEFAULTS = {
    "matrices": 100,
    "edge": 9.0,
    "edges": [7.0, 4.5],
    "batches": [1, 4, 16],
    "threads": [1, 2],
    "repeats": 4,
    "device": "cpu",
    "out": str(REPORTS / "linear.json"),
}
STAGES = (0, 3, 10, 400)  # Newton steps; the last reach equilibrium


@dataclass(frozen=True)
class Systems:
    """Hessians of drapes of one mesh.

    Attributes:
        pattern: of all.
        places: (n, 2) of the unknowns on the flat specimen, m.
        exact, convex: (B, nnz) CSR data.
    """

    pattern: SparsePattern
    places: np.ndarray
    exact: np.ndarray
    convex: np.ndarray


def make_systems(count: int, edge: float, stages: tuple[int, ...]) -> Systems:
    """Hessians of ``count`` fabrics of the prior, stage after stage; ``edge`` in mm."""
    prior, rig = load_prior("gaussian"), Rig()
    scene = scene_on(make_specimen(rig, edge=1e-3 * edge), rig)
    mesh, held = scene.mesh, scene.held
    everywhere = np.concatenate([np.repeat(mesh.rest, 3, axis=0),
                                 mesh.rest[mesh.edges].mean(axis=1)])
    exact, convex = [], []
    for seed in range(count):
        fabric = fabric_from_theta(
            sample_admissible(prior, stream(77, Stream.FABRIC, seed))[0]
        ).at_density(REFERENCE_DENSITY)
        positions = initial_positions(mesh.rest, rig=rig, start="sine",
                                      rng=np.random.default_rng(seed))
        positions[held] = rig.place(mesh.rest[held])
        state = scene.state(positions)
        steps = stages[seed % len(stages)]
        if steps:
            options = NewtonOptions(residual=1e-4, step=1e-4, max_iterations=steps)
            state = find_equilibrium(scene, fabric, state, options=options).state
        potential = Cloth(scene, fabric).potential
        exact.append(potential.hessian(state.q))
        convex.append(potential.hessian(state.q, 1.0))
    return Systems(potential.pattern, potential.free_unknowns(everywhere), np.stack(exact),
                   np.stack(convex))


def check(systems: Systems, device: str) -> dict:
    """Residuals of both solvers for definite Hessians; which exact ones are so for both."""
    solver = FrontalSolver(systems.pattern, systems.places, device=device)
    other = make_solver(systems.pattern)
    rng = np.random.default_rng(0)
    residuals, of_other, definite, agree = [], [], 0, 0
    for first in range(0, len(systems.exact), 10):
        for kind in ("convex", "exact"):
            data = getattr(systems, kind)[first : first + 10]
            found = solver.factorise(torch.from_numpy(data).to(device)).tolist()
            rhs = rng.standard_normal((len(data), systems.pattern.size))
            solutions = solver.solve(torch.from_numpy(rhs).to(device)).cpu().numpy()
            for row, b, x, good in zip(data, rhs, solutions, found, strict=True):
                same = good == other.factorise(row)
                if good and same:
                    matrix, size = systems.pattern.symmetric(row), np.linalg.norm(b)
                    residuals.append(np.linalg.norm(matrix @ x - b) / size)
                    of_other.append(np.linalg.norm(matrix @ other.solve(b) - b) / size)
                elif kind == "convex":
                    residuals.append(np.inf)
                if kind == "exact":
                    definite += good
                    agree += same
    return {
        "matrices": len(systems.exact),
        "systems_solved": len(residuals),
        "largest_residual": float(max(residuals)),
        "median_residual": float(np.median(residuals)),
        "single_largest_residual": float(max(of_other)),
        "single_median_residual": float(np.median(of_other)),
        "exact_positive_definite": definite,
        "definiteness_agrees": agree,
    }


def counts(solver: FrontalSolver, pattern: SparsePattern) -> dict:
    """What the analysis says of a factorisation."""
    groups = solver.fronts.groups
    p, u = solver.fronts.sizes.T.astype(np.float64)
    padded = [g.count * front_flops(float(g.pivots), float(g.others)) for g in groups]
    return {
        "unknowns": pattern.size,
        "matrix_entries": len(pattern.indices),
        "factor_entries": int((p * (p + 1) / 2 + p * u).sum()),
        "largest_front": int((p + u).max()),
        "fronts": len(p),
        "groups": len(groups),
        "gflop": float((front_flops(p, u) - p * u**2).sum()) / 1e9,  # one triangle of updates
        "gflop_carried_out": sum(padded) / 1e9,
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


def time_batches(edge: float, systems: Systems, solver: FrontalSolver, config: dict) -> list[dict]:
    """Milliseconds a sample for each batch size and number of threads, all solvers."""
    pattern, device = systems.pattern, config["device"]
    matrix, right = systems.convex[0], np.ones(pattern.size)
    others = {name: make_solver(pattern, name) for name in available_solvers()}
    memory = {name: _memory_of(name, pattern, matrix) for name in others}
    work = [call for other in others.values()
            for call in (lambda other=other: other.factorise(matrix),
                         lambda other=other: other.solve(right))]
    rows, largest = [], 0
    for threads in config["threads"]:
        torch.set_num_threads(threads)
        for batch in config["batches"]:
            chosen = np.arange(batch) % len(systems.convex)
            values = torch.from_numpy(systems.convex[chosen]).to(device)
            rhs = torch.ones(batch, pattern.size, dtype=torch.float64, device=device)

            def factorise(values=values) -> bool:
                return bool(solver.factorise(values).all())  # waits for the device

            def solve(rhs=rhs) -> float:
                return solver.solve(rhs).sum().item()

            seconds = fastest([factorise, solve, *work], config["repeats"])
            largest = max(largest, batch)  # for which the solver has kept memory
            row = {
                "edge_mm": edge,
                "threads": threads,
                "batch": batch,
                "factor_ms": 1e3 * seconds[0] / batch,
                "solve_ms": 1e3 * seconds[1] / batch,
                "memory_MiB": solver.nbytes / largest / 2**20,
            }
            for k, name in enumerate(others):
                row |= {f"{name}_factor_ms": 1e3 * seconds[2 + 2 * k],
                        f"{name}_solve_ms": 1e3 * seconds[3 + 2 * k],
                        f"{name}_memory_MiB": memory[name]}
            rows.append(row)
    torch.set_num_threads(1)
    return rows


def _memory_of(name: str, pattern: SparsePattern, matrix: np.ndarray) -> float:
    """MiB of one solver with its factor."""
    # Several at a time, so that memory set free before cannot hide them.
    began, solvers = _resident(), [make_solver(pattern, name) for _ in range(4)]
    for solver in solvers:
        solver.factorise(matrix)
    return (_resident() - began) / len(solvers)


def _resident() -> float:
    """Memory of this process in use now, MiB."""
    ctypes.CDLL(None).malloc_trim(0)
    with open("/proc/self/statm", encoding="ascii") as file:
        return int(file.read().split()[1]) * resource.getpagesize() / 2**20


def picture(systems: Systems, solver: FrontalSolver, rows: list[dict], path: Path) -> None:
    """The order in which a mesh's unknowns are eliminated, and the times."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 5))
    groups = solver.fronts.groups
    for number, group in enumerate(groups):
        unknowns = group.own.cpu().numpy()
        unknowns = unknowns[unknowns < systems.pattern.size]
        left.scatter(*systems.places[unknowns].T, s=3, c=np.full(len(unknowns), number),
                     cmap="viridis_r", vmin=0, vmax=len(groups), linewidths=0)
    left.set_aspect("equal")
    left.set_title("order of elimination: the darker, the later")
    left.set_axis_off()
    single = available_solvers()[0]
    for edge in dict.fromkeys(row["edge_mm"] for row in rows):
        of_edge = [row for row in rows if row["edge_mm"] == edge]
        for threads in dict.fromkeys(row["threads"] for row in rows):
            chosen = [row for row in of_edge if row["threads"] == threads]
            right.plot([row["batch"] for row in chosen],
                       [row["factor_ms"] + row["solve_ms"] for row in chosen], "o-",
                       label=f"{edge:g} mm, {threads} thread{'s' * (threads > 1)}")
        least = min(row[f"{single}_factor_ms"] + row[f"{single}_solve_ms"] for row in of_edge)
        right.axhline(least, color="0.5", linestyle=":", label=f"{edge:g} mm, {single}")
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
    report = {"dtype": "float64", "single_solvers": available_solvers(),
              "settings": {k: v for k, v in config.items() if k != "out"}}
    systems = make_systems(config["matrices"], config["edge"], STAGES)
    report["check"] = check(systems, config["device"])
    print(", ".join(f"{k} {v:.3g}" for k, v in report["check"].items()), flush=True)
    report["counts"], report["times"] = [], []
    for edge in config["edges"]:
        systems = make_systems(4, edge, (0,))
        began = time.perf_counter()
        solver = FrontalSolver(systems.pattern, systems.places, device=config["device"])
        found = {"edge_mm": edge, "analysis_s": time.perf_counter() - began,
                 **counts(solver, systems.pattern)}
        report["counts"].append(found)
        print(", ".join(f"{k} {v:.4g}" for k, v in found.items()), flush=True)
        report["times"] += time_batches(edge, systems, solver, config)
    print(table(report["times"][0], [row.values() for row in report["times"]]))
    path = Path(config["out"])
    picture(systems, solver, report["times"], path.with_suffix(".png"))
    write_report(path, report)


if __name__ == "__main__":
    run_command(main, usage=__doc__)
