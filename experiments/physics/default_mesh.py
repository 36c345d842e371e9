"""Displacement of drapes on the default mesh from drapes on a fine mesh, and their cost.

The fabrics of :mod:`experiments.speed.speed` are draped on their default meshes. From each drape
the equilibrium on a mesh with at least four times as many triangles is found, and from this the
equilibria on all other meshes, including the default one. All have the same folds, so that their
displacements are due to the meshes. The cost is that of a drape from a sine start.
"""

import time

import numpy as np

from experiments.comparison import Draped, Shape, compare, equilibrium_near, same_folds
from experiments.drapes import prior_fabric
from experiments.result import Config, Result, run_cases
from sim.draping import Drape, drape
from sim.material import MICRO, REFERENCE_DENSITY, Fabric
from sim.measures import fold_outline
from sim.mesh.specimen import EDGE_RANGE, GRADING, TOPOLOGIES
from sim.rig import DISC_RIG, Rig
from sim.scene import Scene, make_specimen

MAX_DISPLACEMENT = 0.8  # mm, mean displacement between drapes with the same folds
MIN_TRIANGLE_RATIO = 4  # number of triangles of the fine mesh over that of the default mesh
RIGS = {rig.name: rig for rig in (Rig(), DISC_RIG)}


def one_fabric(index: int, seed: int, rig: str, edges_mm: list[float]) -> dict:
    """Displacements of the drapes of one fabric on several meshes from that on a fine mesh."""
    fabric = prior_fabric(index, seed).at_density(REFERENCE_DENSITY)
    tester = RIGS[rig]
    drape(fabric, rig=tester, edge=0.01)  # compiles or loads the kernels of all meshes
    default, default_cost = timed_drape(fabric, tester, None, index)
    specimen = fine_specimen(tester, default, index % TOPOLOGIES)
    found = equilibrium_near(default, specimen, tester, fabric, self_contact=True)
    finest = Shape.of(specimen, found.state.positions)
    rows = [difference(default, default.converged, finest, tester, "default, as draped",
                       default_cost)]
    for name, edge in (("default", default.edge), *((f"{mm:g}", 1e-3 * mm) for mm in edges_mm)):
        coarse = make_specimen(tester, edge=edge, topology=index % TOPOLOGIES)
        placed = equilibrium_near(finest, coarse, tester, fabric, self_contact=True)
        cost = default_cost if name == "default" else timed_drape(fabric, tester, edge, index)[1]
        rows.append(difference(Shape.of(coarse, placed.state.positions), placed.converged, finest,
                               tester, name, cost))
    return {"rig": rig, "alpha_uN_m": (fabric.alpha / MICRO).tolist(),
            "edge_mm": 1e3 * default.edge, "triangles": len(default.faces),
            "fine_triangles": len(finest.faces), "fine_converged": found.converged,
            "meshes": rows}


def timed_drape(
    fabric: Fabric, rig: Rig, edge: float | None, seed: int
) -> tuple[Drape, float]:
    """Simulate a drape from a sine start; return it and its CPU-seconds."""
    began = time.process_time()
    result = drape(fabric, rig=rig, edge=edge, seed=seed, start="sine")
    return result, time.process_time() - began


def fine_specimen(rig: Rig, default: Drape, topology: int) -> Scene:
    """Specimen on a mesh with :data:`MIN_TRIANGLE_RATIO` times the triangles of ``default``.

    Its edges are half as long at the rim; the grading is reduced until the number is reached.
    """
    edge = max(default.edge / 2, EDGE_RANGE[0])
    for grading in np.linspace(GRADING, 1.0, 9):
        specimen = make_specimen(rig, edge=edge, topology=topology, grading=float(grading))
        if len(specimen.mesh.faces) >= MIN_TRIANGLE_RATIO * len(default.faces):
            break
    return specimen


def difference(
    coarse: Draped, converged: bool, fine: Draped, rig: Rig, mesh: str, cost: float
) -> dict:
    """Displacement, mm, and folds of a drape compared with the fine one."""
    outlines = (fold_outline(shape.positions, shape.rest, rig) for shape in (coarse, fine))
    return {"mesh": mesh, "apart_mm": 1e3 * compare(fine, coarse).displacement,
            "same_folds": same_folds(*outlines), "cpu_seconds": round(cost, 3),
            "converged": converged}


def summarise(fabrics: list[dict]) -> list[dict]:
    """One row per mesh: displacements over converged drapes with the same folds, mean costs."""
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
            "within_limit": sum(apart <= MAX_DISPLACEMENT for apart in kept),
            "mean_cpu_seconds": float(np.mean(costs)),
            "median_cpu_seconds": float(np.median(costs)),
        })
    return rows


def run(config: Config) -> Result:
    """Simulate and compare all drapes."""
    settings = {k: config[k] for k in ("seed", "edges_mm")}
    counts = dict(zip(RIGS, (config["drapes"], config["discs"]), strict=True))
    cases = {f"{rig}_{i}": {"index": i, "rig": rig, **settings}
             for rig, count in counts.items() for i in range(count)}
    found = run_cases(one_fabric, cases, config)
    fabrics = {rig: [f for f in found.values() if f["rig"] == rig]
               for rig, count in counts.items() if count}
    rows = {rig: summarise(results) for rig, results in fabrics.items()}
    return Result({"limit_mm": MAX_DISPLACEMENT, "meshes": rows, "fabrics": list(found.values())})
