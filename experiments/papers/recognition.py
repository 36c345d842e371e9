"""Identification of fabrics by descriptors of drapes (000, descriptors; 002, Figure 20)."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from data.dataset.config import STARTS
from experiments.comparison import mean_curvature
from experiments.drapes import (
    RIG,
    capture_drape,
    drape_specimen,
    ideal_setups,
    infer,
    plan_specimen,
)
from experiments.page import Section
from experiments.papers.descriptors import GridSpectrum, RingSpectrum
from experiments.result import Config, Report, Result, run_fabrics
from sim.material import LINEAR
from sim.measures import drape_coefficient, fold_angles, fold_outline
from sim.mesh import Mesh
from sim.rig import Rig

DESCRIPTORS = {
    "coefficient": "drape coefficient and number of folds",
    "shape": "mean height, mean squared curvature",
    "grid": "2-D spectrum (000, Eq. 9)",
    "rings": "spectrum along rings",
    "network": "the network's log α",
}
STANDARDISED = ("coefficient", "shape", "network")
"""Descriptors whose entries are divided by their standard deviations."""


def describe_drape(positions: np.ndarray, mesh: Mesh, rig: Rig) -> dict[str, list]:
    """All descriptors but the network's of a drape with vertices at positions (V, 3), m."""
    rest = mesh.rest
    outline = fold_outline(positions, rest, rig)
    curvature, area = mean_curvature(positions, mesh), mesh.vertex_areas
    inner = np.isfinite(curvature)
    return {
        "coefficient": [drape_coefficient(positions, mesh.faces, rig), len(fold_angles(outline))],
        "shape": [float(area @ positions[:, 2] / area.sum()),
                  float(np.log(area[inner] @ curvature[inner] ** 2 / area[inner].sum()))],
        "grid": GridSpectrum(rest, rig).describe(positions).tolist(),
        "rings": RingSpectrum(rest, rig).describe(positions).tolist()}


def fabric_case(*, number: int, starts: int, edge_mm: float, seed: int) -> dict[str, Any]:
    """Descriptors of all drapes of one fabric."""
    plan = plan_specimen(number, seed=seed)
    rig, rng = RIG, np.random.default_rng([seed, number])
    found = []
    for k in range(starts):
        shape = drape_specimen(plan, edge=1e-3 * edge_mm, start=STARTS[k % len(STARTS)], seed=k)
        one = describe_drape(shape.positions, shape.mesh, rig)
        samples = infer(capture_drape(shape, ideal_setups(), rng)).estimate.samples
        found.append(one | {"network": samples[:, LINEAR].mean(axis=0).tolist()})
    return {"drapes": found, "log_alpha": plan.theta[LINEAR].tolist()}


def run(config: Config) -> Result:
    """Drape all fabrics; identify each drape's fabric."""
    found = run_fabrics(fabric_case, config)
    drapes = [one for result in found.values() for one in result["drapes"]]
    return Result(identification_rates(drapes, np.repeat(np.arange(len(found)), config["starts"])))


def identification_rates(found: list[dict], fabric: np.ndarray) -> dict[str, Any]:
    """Fractions of drapes, of the fabrics (N,), whose nearest neighbour is of the same fabric."""
    other = ~np.eye(len(found), dtype=bool)
    same = other & (fabric[:, None] == fabric)
    shares = {}
    for name in DESCRIPTORS:
        values = np.array([one[name] for one in found], float)
        if name in STANDARDISED:
            values = values / values.std(axis=0)
        distances = np.where(other, np.linalg.norm(values[:, None] - values, axis=-1), np.inf)
        shares[name] = float(np.mean(fabric[distances.argmin(axis=1)] == fabric))
    return {"drapes": len(found), "fabrics": len(np.unique(fabric)),
            "chance": float((same.sum(axis=1) / other.sum(axis=1)).mean()), "shares": shares}


def summarise(report: Report) -> str:
    """Summary in sentences."""
    shares = report["shares"]
    best = max((key for key in shares if key != "network"), key=shares.get)
    return ("The nearest neighbour of a drape is of the same fabric: "
            f"{shares[best]:.0%} with the best descriptor without a network "
            f"({DESCRIPTORS[best]}), {shares['network']:.0%} with the network's α, "
            f"{report['chance']:.0%} by chance.")


def rows(report: Report) -> tuple[list[str], list[list[object]]]:
    """Table of identification rates by descriptor."""
    head = ["descriptor", f"identified ({report['drapes']} drapes, {report['fabrics']} fabrics)"]
    return head, [*([label, f"{report['shares'][key]:.0%}"] for key, label in DESCRIPTORS.items()),
                  ["chance", f"{report['chance']:.0%}"]]


def draw(report: Report) -> Figure:
    """Plot identification rates as bars."""
    figure = Figure(figsize=(8, 2.4), layout="constrained")
    axes = figure.subplots()
    axes.barh(list(DESCRIPTORS.values()), [100 * report["shares"][key] for key in DESCRIPTORS])
    axes.axvline(100 * report["chance"], color="k", lw=1, ls=":", label="chance")
    axes.set(xlabel="drapes whose nearest neighbour is of the same fabric [%]", xlim=(0, 100))
    axes.invert_yaxis()
    axes.legend(frameon=False)
    return figure


SECTION = Section(
    "Fabric identification without a network", "000, Figure 7; 002, Figure 20",
    "How well do drape coefficient, folds, curvature and spectra identify a fabric?",
    summarise, rows, draw,
    "finds distances of spectra larger between fabrics than within one (000, Figure 7), and a "
    "network less accurate on boundary curves than on depth (002, Figure 20). Only qualitatively "
    "comparable.",
    "Drapes of a fabric differ in their start only: simulated specimens have no "
    "nuisances, and captures have no faults. Drapes of real cloth, which vary more, were "
    "not available.")
