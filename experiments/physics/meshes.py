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

from itertools import combinations
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from matplotlib.figure import Figure

from common.errors import InputError
from data.render.shade import shade
from experiments.comparison import compare, same_folds
from experiments.physics.mesh_cases import (
    BETA_OVER_ALPHA_MM,
    DEFAULT_LAW,
    FABRICS,
    MESHES,
    case_name,
    common_start,
    drape_near,
    laws_for,
    plan,
)
from experiments.result import Config, Result, load_arrays, run_cases
from sim.measures import fold_outline
from sim.rig import Rig

MAX_DISPLACEMENT = 0.7  # mm, mean displacement between drapes with the same folds


class FinishedDrapes:
    """Results and shapes of finished drapes by name."""

    def __init__(self, folder: Path, results: dict[str, dict]) -> None:
        self.results = results
        self.shapes = {name: SimpleNamespace(**load_arrays(folder, name)) for name in results}
        # Computed once, because each drape is in several pairs; (720, 2) m.
        self.outlines = {name: fold_outline(shape.positions, shape.rest, Rig())
                         for name, shape in self.shapes.items()}

    def difference(self, one: str, two: str) -> dict:
        """Differences between the drapes ``one`` and ``two``."""
        found = compare(self.shapes[one], self.shapes[two])
        results = [self.results[name] for name in (one, two)]
        return {
            "drapes": [one, two],
            "mean_mm": 1e3 * found.displacement,
            "largest_mm": 1e3 * found.largest,
            "curvature": found.curvature,
            "folds": [r["folds"] for r in results],
            "same_folds": same_folds(self.outlines[one], self.outlines[two]),
            "drape_coefficients": [r["drape_coefficient"] for r in results],
            "converged": all(r["status"] == "converged" for r in results),
        }


def compare_meshes(finished: FinishedDrapes, fabric: str, law: str, edge_mm: float) -> list[dict]:
    """Differences between the three meshes of one resolution."""
    rows = []
    for one, two in combinations(MESHES, 2):
        names = [case_name(fabric, law, mesh, edge_mm) for mesh in (one, two)]
        rows.append({"fabric": fabric, "law": law, "edge_mm": edge_mm, "meshes": [one, two],
                     **finished.difference(*names)})
    return rows


def compare_returns(finished: FinishedDrapes, fabrics: list[str], config: dict) -> list[dict]:
    """Differences between two equilibria on one mesh with different starts."""
    return [
        {"fabric": fabric,
         **finished.difference(*(case_name(fabric, DEFAULT_LAW, mesh, config["edge_mm"])
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
