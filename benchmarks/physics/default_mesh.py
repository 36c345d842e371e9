"""Distance of drapes on the default mesh from those on a fine one, and their cost.

The fabrics of :mod:`benchmarks.speed.speed` are draped on their default meshes. The equilibrium
next to such a drape is found on a mesh with at least four times as many triangles, and next to that
one on every other mesh, the default one included. All then have the same folds, and the distances
between them are due to their meshes. The cost is that of a drape from a sine start.
"""

import time
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from benchmarks.common import Config, Result, next_to, run_cases, table, tick_short_scales
from benchmarks.comparison import Draped, compare, same_folds
from benchmarks.speed.speed import prior_fabrics
from sim.drape import DrapeResult, drape
from sim.material import MICRO, REFERENCE_DENSITY, Fabric
from sim.measures import fold_outline
from sim.mesh.specimens import EDGES, GRADING, TOPOLOGIES, Specimen, make_specimen
from sim.scene import DISC_RIG, Rig

LIMIT = 0.8  # mm, mean displacement between drapes of one fold configuration
FINER = 4  # times as many triangles has the fine mesh, at least
RIGS = {rig.name: rig for rig in (Rig(), DISC_RIG)}


def one_fabric(index: int, seed: int, rig: str, edges_mm: list[float]) -> dict:
    """How far the drapes of one fabric on several meshes lie from that on a fine one."""
    fabric = prior_fabrics(index + 1, seed)[index].at_density(REFERENCE_DENSITY)
    held = RIGS[rig]
    drape(fabric, rig=held, edge=0.01)  # compiles or loads the kernels, of all meshes
    own, own_cost = timed_drape(fabric, held, None, index)
    specimen = fine_specimen(held, own, index % TOPOLOGIES)
    found = next_to(own.rest, own.positions, specimen, held, fabric, self_contact=True)
    finest = Shape(specimen, found.state.positions)
    rows = [distance(own, own.converged, finest, held, "default, as draped", own_cost)]
    for name, edge in (("default", own.edge), *((f"{mm:g}", 1e-3 * mm) for mm in edges_mm)):
        there = make_specimen(held, edge=edge, topology=index % TOPOLOGIES)
        placed = next_to(finest.rest, finest.positions, there, held, fabric, self_contact=True)
        cost = own_cost if name == "default" else timed_drape(fabric, held, edge, index)[1]
        rows.append(distance(Shape(there, placed.state.positions), placed.converged, finest, held,
                             name, cost))
    return {"rig": rig, "alpha_uN_m": (fabric.alpha / MICRO).tolist(), "edge_mm": 1e3 * own.edge,
            "triangles": len(own.faces), "fine_triangles": len(finest.faces),
            "fine_converged": found.converged, "meshes": rows}


class Shape:
    """A specimen at positions (V, 3), m (:class:`benchmarks.comparison.Draped`)."""

    def __init__(self, specimen: Specimen, positions: np.ndarray) -> None:
        self.rest, self.faces, self.positions = specimen.mesh.rest, specimen.mesh.faces, positions


def timed_drape(
    fabric: Fabric, rig: Rig, edge: float | None, seed: int
) -> tuple[DrapeResult, float]:
    """A drape from a sine start, and its CPU-seconds."""
    began = time.process_time()
    result = drape(fabric, rig=rig, edge=edge, seed=seed)
    return result, time.process_time() - began


def fine_specimen(rig: Rig, own: DrapeResult, topology: int) -> Specimen:
    """A mesh with :data:`FINER` times the triangles of ``own`` or more.

    Its edges are half as long at the rim, and at the hem as short as it takes.
    """
    edge = max(own.edge / 2, EDGES[0])
    for grading in np.linspace(GRADING, 1.0, 9):
        specimen = make_specimen(rig, edge=edge, topology=topology, grading=float(grading))
        if len(specimen.mesh.faces) >= FINER * len(own.faces):
            break
    return specimen


def distance(
    coarse: Draped, converged: bool, fine: Draped, rig: Rig, mesh: str, cost: float
) -> dict:
    """How far a drape lies from the fine one, in people's units."""
    outlines = (fold_outline(shape.positions, shape.rest, rig) for shape in (coarse, fine))
    return {"mesh": mesh, "apart_mm": 1e3 * compare(fine, coarse).displacement,
            "same_folds": same_folds(*outlines), "cpu_seconds": round(cost, 3),
            "converged": converged}


def summarise(fabrics: list[dict]) -> list[dict]:
    """A row a mesh, over the fabrics that keep their folds there; costs over all."""
    rows = []
    for meshes in zip(*(fabric["meshes"] for fabric in fabrics), strict=True):
        kept = [m["apart_mm"] for m in meshes if m["same_folds"] and m["converged"]]
        costs = [m["cpu_seconds"] for m in meshes]
        rows.append({
            "mesh": meshes[0]["mesh"],
            "drapes": len(meshes),
            "same_folds": len(kept),
            "mean_mm": float(np.mean(kept)) if kept else None,
            "median_mm": float(np.median(kept)) if kept else None,
            "largest_mm": max(kept, default=None),
            "within_limit": sum(apart <= LIMIT for apart in kept),
            "mean_cpu_seconds": float(np.mean(costs)),
            "median_cpu_seconds": float(np.median(costs)),
        })
    return rows


def picture(fabrics: dict[str, list[dict]]) -> Figure:
    """Distance from the fine drape against the fabric's softest direction, a colour a mesh."""
    figure = Figure(figsize=(5.2 * len(fabrics), 4.0), layout="constrained")
    axes = figure.subplots(1, len(fabrics), squeeze=False)[0]
    for axis, (rig, own) in zip(axes, fabrics.items(), strict=True):
        softest = [min(fabric["alpha_uN_m"]) for fabric in own]
        meshes = zip(*(fabric["meshes"] for fabric in own), strict=True)
        for number, rows in enumerate(meshes):
            name = rows[0]["mesh"]
            axis.scatter(softest, [m["apart_mm"] for m in rows], s=18, color=f"C{number}",
                         label=name if name.startswith("default") else f"{name} mm at the rim")
        axis.axhline(LIMIT, color="0.6", linewidth=0.8)
        axis.set(xscale="log", yscale="log", xlabel="α of the softest direction, µN·m",
                 ylabel="from the fine drape, mm (mean)", title=rig)
        tick_short_scales(axis.xaxis, axis.yaxis)
    axes[0].legend(frameon=False)
    return figure


def run(config: Config) -> Result:
    """Drape and compare, and print the tables."""
    settings = {k: config[k] for k in ("seed", "edges_mm")}
    counts = dict(zip(RIGS, (config["drapes"], config["discs"]), strict=True))
    cases = {f"{rig}_{i}": {"index": i, "rig": rig, **settings}
             for rig, count in counts.items() for i in range(count)}
    found = run_cases(one_fabric, cases, folder=Path(config["cases"]), workers=config["workers"])
    fabrics = {rig: [f for f in found.values() if f["rig"] == rig]
               for rig, count in counts.items() if count}
    rows = {rig: summarise(own) for rig, own in fabrics.items()}
    for rig, own in rows.items():
        print(rig)
        print(table(
            ["edges at the rim, mm", "same folds", "mean from fine, mm", "median", "largest",
             f"within {LIMIT:g} mm", "CPU-seconds a drape, mean", "median"],
            [[r["mesh"], r["same_folds"], r["mean_mm"], r["median_mm"], r["largest_mm"],
              r["within_limit"], r["mean_cpu_seconds"], r["median_cpu_seconds"]] for r in own]))
    return Result({"limit_mm": LIMIT, "meshes": rows, "fabrics": list(found.values())},
                  picture(fabrics))
