"""Influence of the mesh on a drape (paper's Figure 12).

Each of six fabrics is draped once, and from this shape the equilibrium on every mesh is found: two
of the default graded triangulations and a mesh with about as many triangles of uniform size.
"""

from itertools import combinations
from pathlib import Path

import numpy as np

from common.errors import InputError
from experiments.comparison import Shape, compare, equilibrium_near, same_folds
from experiments.report import Report
from experiments.study import CaseKeys, Sample, Study, folder_of, samples_of
from sim.draping import drape
from sim.material import MICRO, Fabric
from sim.measures import fold_outline
from sim.mesh import Mesh
from sim.mesh.specimen import TOPOLOGIES
from sim.rig import Rig
from sim.scene import Scene, make_specimen
from sim.solver.newton import Status

# Moduli warp, bias, weft in µN·m at 300 g/m²; beta/alpha of a typical fabric, mm.
FABRICS = {
    "soft": (5.0, 5.0, 5.0),
    "median": (20.0, 20.0, 20.0),
    "stiff": (100.0, 100.0, 100.0),
    "warp-stiff": (40.0, 18.0, 10.0),
    "weft-stiff": (8.0, 16.0, 40.0),
    "bias-soft": (50.0, 14.0, 40.0),
}
BETA_OVER_ALPHA_MM = -2.5
MESHES = ("graded", "other", "uniform")
MAX_DISPLACEMENT = 0.7  # mm, mean displacement between drapes with the same folds


class Keys(CaseKeys):
    fabrics: tuple[str, ...] = tuple(FABRICS)
    edge_mm: float = 1.0  # mesh edges at the rim
    start_mm: float = 1.0  # mesh edges of the common start, on another triangulation
    seed: int = 0  # of the meshes; that of the common start is larger by 2


def common_start(fabric: str, start_mm: float, seed: int) -> Sample:
    """Drape a fabric as the common start of its cases."""
    # On another triangulation, because on that of the cases the start is already the equilibrium.
    made = drape(_fabric(fabric), edge=1e-3 * start_mm, seed=seed + 2, start="sine")
    return _results(made.mesh, made.positions, made.status)


def drape_near(fabric: str, mesh: str, edge_mm: float, seed: int, begin: str) -> Sample:
    """Find the equilibrium on a mesh, started from the drape in the npz file ``begin``."""
    near = Shape.load(Path(begin).parent, Path(begin).stem)
    specimen = specimen_on(mesh, 1e-3 * edge_mm, seed)
    found = equilibrium_near(near, specimen, Rig(), _fabric(fabric))
    return _results(specimen.mesh, found.state.positions, found.status)


def specimen_on(kind: str, edge: float, seed: int) -> Scene:
    """Specimen on a mesh of :data:`MESHES`, with edges of ``edge``, m, at the rim."""
    rig = Rig()
    if kind != "uniform":
        return make_specimen(rig, edge=edge, topology=(seed + (kind == "other")) % TOPOLOGIES)
    graded = make_specimen(rig, edge=edge, topology=seed % TOPOLOGIES)
    moving = ~graded.held[graded.mesh.faces].all(axis=1)
    alike = np.sqrt(4 / np.sqrt(3) * graded.mesh.areas[moving].mean())
    return make_specimen(rig, edge=float(alike), topology=seed % TOPOLOGIES, grading=1.0)


def _fabric(name: str) -> Fabric:
    moduli = np.array(FABRICS[name]) * MICRO
    return Fabric(moduli, BETA_OVER_ALPHA_MM * 1e-3 * moduli)


def _results(mesh: Mesh, positions: np.ndarray, status: Status) -> Sample:
    return {"status": status.value, "triangles": len(mesh.faces),
            "arrays": {"rest": mesh.rest, "positions": positions, "faces": mesh.faces}}


def difference(folder: Path, results: dict[str, Sample], one: str, two: str) -> Report:
    """Difference between two drapes of a fabric."""
    shapes = [Shape.load(folder, name) for name in (one, two)]
    outlines = (fold_outline(shape.positions, shape.rest, Rig()) for shape in shapes)
    apart = compare(*shapes)
    return {"drapes": [one, two], "mean_mm": 1e3 * apart.displacement,
            "largest_mm": 1e3 * apart.largest, "same_folds": same_folds(*outlines),
            "converged": all(results[name]["status"] == Status.CONVERGED.value
                             for name in (one, two))}


def run(keys: Keys) -> Report:
    """Simulate and compare all drapes."""
    folder, fabrics = folder_of(keys), keys.fabrics
    if unknown := set(fabrics) - set(FABRICS):
        raise InputError(f"unknown fabric '{min(unknown)}'; choose from {', '.join(FABRICS)}")
    samples_of(common_start, keys, {f"{fabric}_start": {"fabric": fabric} for fabric in fabrics})
    results = samples_of(drape_near, keys, {f"{fabric}_{mesh}": {
        "fabric": fabric, "mesh": mesh, "begin": str(folder / f"{fabric}_start")}
        for fabric in fabrics for mesh in MESHES})
    rows = [difference(folder, results, *(f"{fabric}_{mesh}" for mesh in pair))
            for fabric in fabrics for pair in combinations(MESHES, 2)]
    same = [row["mean_mm"] for row in rows if row["same_folds"] and row["converged"]]
    largest = max(same, default=None)
    return {"limit_mm": MAX_DISPLACEMENT, "pairs": len(rows), "same_folds": len(same),
            "mean_mm": float(np.mean(same)) if same else None, "largest_mean_mm": largest,
            "passed": largest is not None and largest < MAX_DISPLACEMENT, "meshes": rows}


STUDY = Study(Keys, run)
