"""Influence of the mesh on a drape (paper's Figure 12).

Six fabrics, three of them anisotropic. The folds of a drape depend on small perturbations;
therefore each fabric is draped once, and from this shape the equilibrium on every mesh and with
every law is found, without coarser meshes before it. The comparisons are

- two of the default graded triangulations and a mesh with about as many triangles of uniform size,
  for the default law and for hinge laws;
- the same for the default law on coarser meshes;
- a graded mesh started from the common shape and from the drape on the uniform mesh: this
  displacement is between minima caused by the mesh.

Two drapes have the same folds when they have as many folds and each is within a quarter of the mean
fold spacing of the corresponding one (:func:`experiments.comparison.same_folds`).
"""

import time
from itertools import combinations
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from common.errors import InputError
from data.render.shade import shade
from experiments.comparison import FinishedDrapes, Shape, compare, equilibrium_near
from experiments.result import Config, Result, run_cases
from sim.cloth import Laws
from sim.drape import drape
from sim.energies.membrane import Corotational
from sim.material import MICRO, Fabric
from sim.measures import drape_coefficient, fold_angles, fold_outline
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
"""Two graded triangulations, and a mesh with about as many triangles of uniform size."""
DEFAULT_LAW = "midedge"


def common_start(alpha: list[float], edge_mm: float, membrane: float, seed: int) -> dict:
    """Drape a fabric of moduli ``alpha`` (3,), µN·m, as the common start of its cases."""
    laws = Laws(membrane=Corotational(stiffness=membrane))
    result = drape(_fabric(alpha), edge=1e-3 * edge_mm, seed=seed, laws=laws, start="sine")
    return _results(result.mesh, result.positions, result.status, result.seconds)


def drape_near(
    alpha: list[float], law: str, mesh: str, edge_mm: float, membrane: float, seed: int, begin: str
) -> dict:
    """Find the equilibrium on a mesh, started from the drape in the npz file ``begin``."""
    began = time.perf_counter()
    near = Shape.load(Path(begin).parent, Path(begin).stem)
    specimen = specimen_on(mesh, 1e-3 * edge_mm, seed)
    found = equilibrium_near(near, specimen, Rig(), _fabric(alpha), Laws(
        bending=law, membrane=Corotational(stiffness=membrane)))
    return _results(specimen.mesh, found.state.positions, found.status,
                    time.perf_counter() - began)


def specimen_on(kind: str, edge: float, seed: int) -> Scene:
    """Specimen on a mesh of :data:`MESHES`, with edges of ``edge``, m, at the rim."""
    rig = Rig()
    if kind != "uniform":
        return make_specimen(rig, edge=edge, topology=(seed + (kind == "other")) % TOPOLOGIES)
    graded = make_specimen(rig, edge=edge, topology=seed % TOPOLOGIES)
    moving = ~graded.held[graded.mesh.faces].all(axis=1)
    alike = np.sqrt(4 / np.sqrt(3) * graded.mesh.areas[moving].mean())
    return make_specimen(rig, edge=float(alike), topology=seed % TOPOLOGIES, grading=1.0)


def _fabric(alpha: list[float]) -> Fabric:
    moduli = np.array(alpha) * MICRO
    return Fabric(moduli, BETA_OVER_ALPHA_MM * 1e-3 * moduli)


def _results(mesh: Mesh, positions: np.ndarray, status: Status, seconds: float) -> dict:
    """Stored results of a drape."""
    return {
        "status": status.value,
        "triangles": len(mesh.faces),
        "folds": len(fold_angles(fold_outline(positions, mesh.rest, Rig()))),
        "drape_coefficient": drape_coefficient(positions, mesh.faces, Rig()),
        "seconds": round(seconds, 2),
        "arrays": {"rest": mesh.rest, "positions": positions, "faces": mesh.faces},
    }


def plan(fabric: str, config: dict) -> tuple[dict[str, dict], dict[str, dict], dict[str, dict]]:
    """Cases of one fabric by name, in three groups that depend on the previous ones.

    The common start, the drapes started from it, and the return from the uniform mesh.
    """
    common = {"alpha": list(FABRICS[fabric]), "seed": config["seed"],
              "membrane": config["membrane"]}
    folder, edge = Path(config["cases"]), config["edge_mm"]
    start = f"{fabric}_start_{config['start_mm']:g}"
    wanted = {(law, mesh, edge) for law in laws_for(fabric, config) for mesh in MESHES}
    wanted |= {(DEFAULT_LAW, mesh, mm) for mesh in MESHES for mm in config["refinement_mm"]}
    drapes = {
        case_name(fabric, law, mesh, mm): {
            **common, "law": law, "mesh": mesh, "edge_mm": mm, "begin": str(folder / start)
        }
        for law, mesh, mm in sorted(wanted)
    }
    far = case_name(fabric, DEFAULT_LAW, "uniform", edge)
    back = {
        case_name(fabric, DEFAULT_LAW, "return", edge): {
            **common, "law": DEFAULT_LAW, "mesh": "graded", "edge_mm": edge,
            "begin": str(folder / far),
        }
    }
    # On another triangulation, because on that of the cases the start is already the equilibrium.
    own = {**common, "seed": config["seed"] + 2, "edge_mm": config["start_mm"]}
    return {start: own}, drapes, back


def laws_for(name: str, config: dict) -> list[str]:
    """Laws to compare; for isotropic fabrics without those that differ only by direction."""
    laws = list(dict.fromkeys([DEFAULT_LAW, *config["laws"]]))
    isotropic = len(set(FABRICS[name])) == 1
    return [law for law in laws if not (isotropic and law.endswith("_edge"))]


def case_name(fabric: str, law: str, mesh: str, edge_mm: float) -> str:
    """Name of the files of a case."""
    return f"{fabric}_{law}_{mesh}_{edge_mm:g}"


MAX_DISPLACEMENT = 0.7  # mm, mean displacement between drapes with the same folds


def difference(finished: FinishedDrapes, one: str, two: str) -> dict:
    """Differences between the drapes ``one`` and ``two``."""
    apart = compare(finished.shapes[one], finished.shapes[two])
    results = [finished.results[name] for name in (one, two)]
    return {
        "drapes": [one, two],
        "mean_mm": 1e3 * apart.displacement,
        "largest_mm": 1e3 * apart.largest,
        "curvature": apart.curvature,
        "folds": [r["folds"] for r in results],
        "same_folds": finished.same_folds(one, two),
        "drape_coefficients": [r["drape_coefficient"] for r in results],
        "converged": finished.converged(one, two),
    }


def compare_meshes(finished: FinishedDrapes, fabric: str, law: str, edge_mm: float) -> list[dict]:
    """Differences between the three meshes of one resolution."""
    rows = []
    for one, two in combinations(MESHES, 2):
        names = [case_name(fabric, law, mesh, edge_mm) for mesh in (one, two)]
        rows.append({"fabric": fabric, "law": law, "edge_mm": edge_mm, "meshes": [one, two],
                     **difference(finished, *names)})
    return rows


def compare_returns(finished: FinishedDrapes, fabrics: list[str], config: dict) -> list[dict]:
    """Differences between two equilibria on one mesh with different starts."""
    return [
        {"fabric": fabric,
         **difference(finished, *(case_name(fabric, DEFAULT_LAW, mesh, config["edge_mm"])
                                 for mesh in ("graded", "return")))}
        for fabric in fabrics
    ]


def summarise(rows: list[dict]) -> dict[str, dict]:
    """Number of pairs with the same folds, and their displacements, by law."""
    summary = {}
    for law in dict.fromkeys(row["law"] for row in rows):
        chosen = [row for row in rows if row["law"] == law]
        same = [row["mean_mm"] for row in chosen if row["same_folds"] and row["converged"]]
        summary[law] = {
            "pairs": len(chosen),
            "not_converged": sum(not row["converged"] for row in chosen),
            "same_folds": len(same),
            "mean_mm": float(np.mean(same)) if same else None,
            "largest_mean_mm": max(same) if same else None,
        }
    return summary


def run(config: Config) -> Result:
    """Simulate and compare all drapes."""
    folder, fabrics = Path(config["cases"]), config["fabrics"]
    if unknown := set(fabrics) - set(FABRICS):
        raise InputError(f"unknown fabric '{min(unknown)}'; choose from {', '.join(FABRICS)}")
    plans = [plan(fabric, config) for fabric in fabrics]
    results: dict[str, dict] = {}
    for work, group in zip((common_start, drape_near, drape_near), zip(*plans, strict=True),
                           strict=True):
        cases = {name: settings for cases in group for name, settings in cases.items()}
        results |= run_cases(work, cases, config, folder=folder)
    finished = FinishedDrapes(folder, results)
    of_laws = [(fabric, law, config["edge_mm"])
               for fabric in fabrics for law in laws_for(fabric, config)]
    of_spacings = [(fabric, DEFAULT_LAW, mm)
                   for fabric in fabrics for mm in sorted(config["refinement_mm"], reverse=True)]
    pairs = {key: compare_meshes(finished, *key) for key in dict.fromkeys(of_laws + of_spacings)}
    meshes, spacings = ([row for key in keys for row in pairs[key]]
                        for keys in (of_laws, of_spacings))
    returns = compare_returns(finished, fabrics, config)
    summary = summarise(meshes)
    pairs = [row for row in meshes if row["law"] == DEFAULT_LAW
             and row["meshes"] == ["graded", "other"]]
    worst = summarise(pairs)[DEFAULT_LAW]["largest_mean_mm"]
    return Result({
        "fabrics_alpha_uN_m": {name: FABRICS[name] for name in fabrics},
        "beta_over_alpha_mm": BETA_OVER_ALPHA_MM,
        "limit_mm": MAX_DISPLACEMENT, "passed": worst is not None and worst < MAX_DISPLACEMENT,
        "summary": summary,
        "meshes": meshes, "spacings": spacings, "returns": returns, "drapes": results,
    }, draw(finished, fabrics, config))


def draw(finished: FinishedDrapes, fabrics: list[str], config: Config) -> Figure:
    """Show the drapes from above, one row per fabric, and their outlines."""
    laws = config["laws"][:2]
    columns = [(law, mesh) for law in laws for mesh in MESHES]
    wide = len(columns) + len(laws) + 1
    figure = Figure(figsize=(1.75 * wide, 1.8 * len(fabrics) + 0.3), layout="constrained")
    axes = figure.subplots(len(fabrics), wide, squeeze=False)
    for row, fabric in zip(axes, fabrics, strict=True):
        for axis, (law, mesh) in zip(row, columns, strict=False):
            name = case_name(fabric, law, mesh, config["edge_mm"])
            if shape := finished.shapes.get(name):
                axis.imshow(shade(shape.positions, shape.faces, plate_radius=Rig().plate_radius,
                                  elevation=90.0, size=(260, 260), field=0.31))
            axis.set_title(f"{law}\n{mesh}", fontsize=7)
        groups = {law: {mesh: case_name(fabric, law, mesh, config["edge_mm"])
                        for mesh in MESHES} for law in laws}
        groups["refinement"] = {f"{mm:g} mm": case_name(fabric, DEFAULT_LAW, "graded", mm)
                                for mm in sorted(config["refinement_mm"], reverse=True)}
        for axis, (title, group) in zip(row[len(columns):], groups.items(), strict=True):
            for label, name in group.items():
                if name in finished.shapes:
                    outline = 1e3 * finished.outlines[name]
                    axis.plot(*np.vstack([outline, outline[:1]]).T, lw=0.8, label=label)
            if axis.lines:
                axis.legend(fontsize=4.5, frameon=False, loc="center")
            axis.set_aspect("equal")
            axis.set_title(title, fontsize=7)
        row[0].set_ylabel(fabric, fontsize=8)
        for axis in row:
            axis.set_xticks([])
            axis.set_yticks([])
    return figure
