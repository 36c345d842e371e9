"""What finer meshes would change, and cost: ``python -m benchmarks.default_mesh [workers=2]``.

The fabrics of :mod:`benchmarks.speed`, draped on the mesh that the simulator chooses by itself;
then the equilibrium next to that drape on a fine mesh; then, put down next to the fine drape, that
of every other mesh, and of the chosen one again. So all have the same folds, and what lies between
two drapes is what their meshes make of them. Beside it, what a drape from a sine start costs on
each mesh.

Keys (``key=value``):

    drapes       fabrics
    seed         of the fabrics
    resolutions  vertices a side of the meshes beside the default one
    fine         vertices a side of the mesh all are compared with
    workers      processes, one thread each
    cases        folder of finished fabrics; an interrupted run goes on from there
    out          the report, JSON; a picture of the same name beside it
"""

import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from matplotlib.figure import Figure
from sim.specimens import make_specimen

from benchmarks.common import (
    REPORTS,
    parse_settings,
    run_cases,
    table,
    tick_short_scales,
    write_figure,
    write_report,
)
from benchmarks.speed import prior_fabrics
from common.cli import run_command
from sim.comparison import Draped, compare, same_folds
from sim.drape import FINE_OPTIONS, drape, scene_on
from sim.initial import interpolate_positions
from sim.material import MICRO, REFERENCE_DENSITY, Fabric
from sim.measures import fold_outline
from sim.scene import Rig, State
from sim.self_contact import find_free_equilibrium

LIMIT = 0.7  # mm, mean displacement between drapes of one fold configuration

DEFAULTS = {
    "drapes": 32,
    "seed": 77,
    "resolutions": [51, 61, 76, 101],
    "fine": 151,
    "workers": 1,
    "cases": "outputs/validation/default_mesh",
    "out": str(REPORTS / "default_mesh.json"),
}


def one_fabric(index: int, seed: int, resolutions: list[int], fine: int) -> dict:
    """How far the drapes of one fabric on several meshes lie from that on a fine one."""
    fabric = prior_fabrics(index + 1, seed)[index].at_density(REFERENCE_DENSITY)
    drape(fabric, resolution=16)  # compiles or loads the kernels, of all meshes
    own, own_cost = timed_drape(fabric, None, index)
    finest, converged = next_to(own, fabric, fine, index)
    rows = [distance(own, own.converged, finest, "default, as draped", own_cost)]
    put_down = next_to(finest, fabric, own.resolution, index)
    rows.append(distance(*put_down, finest, "default", own_cost))
    for n in resolutions:
        put_down = next_to(finest, fabric, n, index)
        _, cost = timed_drape(fabric, n, index)
        rows.append(distance(*put_down, finest, str(n), cost))
    return {"alpha_uN_m": (fabric.alpha / MICRO).tolist(), "resolution": own.resolution,
            "fine_converged": converged, "meshes": rows}


def timed_drape(fabric: Fabric, resolution: int | None, seed: int) -> tuple[Draped, float]:
    """A drape from a sine start, and its CPU-seconds."""
    began = time.process_time()
    result = drape(fabric, resolution=resolution, seed=seed)
    return result, time.process_time() - began


def next_to(near: Draped, fabric: Fabric, resolution: int, seed: int) -> tuple[Draped, bool]:
    """The equilibrium next to a drape on another mesh, and whether it was reached."""
    rig = Rig()
    specimen = make_specimen(rig, resolution=resolution, seed=seed)
    positions = interpolate_positions(near.rest, near.positions, specimen.mesh.rest)
    positions[specimen.held] = rig.place(specimen.mesh.rest[specimen.held])
    state, result = find_free_equilibrium(
        scene_on(specimen, rig, last=True), fabric, State.at(specimen.mesh, positions),
        options=FINE_OPTIONS)
    shape = SimpleNamespace(rest=specimen.mesh.rest, positions=state.positions,
                            faces=specimen.mesh.faces)
    return shape, result.status.value == "converged"


def distance(coarse: Draped, converged: bool, fine: Draped, mesh: str, cost: float) -> dict:
    """How far a drape lies from the fine one, in people's units."""
    outlines = (fold_outline(shape.positions, shape.rest, Rig()) for shape in (coarse, fine))
    return {"mesh": mesh, "apart_mm": 1e3 * compare(fine, coarse).displacement,
            "same_folds": same_folds(*outlines), "cpu_seconds": round(cost, 2),
            "converged": converged}


def summarise(fabrics: list[dict]) -> list[dict]:
    """A row a mesh, over the fabrics that keep their folds there; costs over all."""
    rows = []
    for meshes in zip(*(fabric["meshes"] for fabric in fabrics), strict=True):
        kept = [m["apart_mm"] for m in meshes if m["same_folds"] and m["converged"]]
        costs = [m["cpu_seconds"] for m in meshes]
        rows.append({
            "mesh": meshes[0]["mesh"],
            "same_folds": len(kept),
            "mean_mm": float(np.mean(kept)) if kept else None,
            "median_mm": float(np.median(kept)) if kept else None,
            "largest_mm": max(kept, default=None),
            "within_limit": sum(apart <= LIMIT for apart in kept),
            "mean_cpu_seconds": float(np.mean(costs)),
            "median_cpu_seconds": float(np.median(costs)),
        })
    return rows


def picture(fabrics: list[dict], fine: int) -> Figure:
    """Distance from the fine drape against the fabric's softest direction, a colour a mesh."""
    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    axis = figure.subplots()
    softest = [min(fabric["alpha_uN_m"]) for fabric in fabrics]
    meshes = zip(*(fabric["meshes"] for fabric in fabrics), strict=True)
    for number, rows in enumerate(meshes):
        name = rows[0]["mesh"]
        label = f"{name} × {name}" if name.isdigit() else name
        axis.scatter(softest, [m["apart_mm"] for m in rows], s=18, color=f"C{number}", label=label)
    axis.axhline(LIMIT, color="0.6", linewidth=0.8)
    axis.set(xscale="log", yscale="log", xlabel="α of the softest direction, µN·m",
             ylabel=f"from the drape on {fine} × {fine}, mm (mean)")
    tick_short_scales(axis.xaxis, axis.yaxis)
    axis.legend(frameon=False)
    return figure


def main(argv: list[str]) -> None:
    """Run what is missing, print the table, write report and picture."""
    config = parse_settings(DEFAULTS, argv)
    common = {k: config[k] for k in ("seed", "resolutions", "fine")}
    cases = {f"fabric_{i}": {"index": i, **common} for i in range(config["drapes"])}
    fabrics = list(run_cases(one_fabric, cases, folder=Path(config["cases"]),
                             workers=config["workers"]).values())
    rows = summarise(fabrics)
    print(table(
        ["vertices a side", "same folds", f"mean from {config['fine']}, mm", "median", "largest",
         f"within {LIMIT:g} mm", "CPU-seconds a drape, mean", "median"],
        [[r["mesh"], r["same_folds"], r["mean_mm"], r["median_mm"], r["largest_mm"],
          r["within_limit"], r["mean_cpu_seconds"], r["median_cpu_seconds"]] for r in rows]))
    settings = {k: v for k, v in config.items() if k not in ("out", "cases", "workers")}
    out = Path(config["out"])
    write_report(out, {"settings": settings, "limit_mm": LIMIT, "meshes": rows,
                       "fabrics": fabrics})
    write_figure(out.with_suffix(".png"), picture(fabrics, config["fine"]))


if __name__ == "__main__":
    run_command(main, usage=__doc__)
