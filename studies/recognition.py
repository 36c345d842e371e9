"""Identification of fabrics by descriptors of drapes (000, descriptors; 002, Figure 20)."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.common import ESTIMATOR_SOURCES
from benchmarks.comparison import mean_curvature
from benchmarks.known import estimate_views
from data.cameras import CameraRig
from data.sampling import STARTS
from data.scans import read_scan
from data.setups import Setups
from drapenet.checkpoint import bundled, read_header
from drapenet.convention import LINEAR
from sim.measures import drape_coefficient, fold_angles, fold_outline
from sim.mesh import Mesh
from sim.scene import DISC_RIG, Rig
from studies.captured import (
    RIG,
    capture_drape,
    drape_specimen,
    fabric_and_sample,
    ideal_setups,
    infer,
    run_scans,
    specimen,
)
from studies.descriptors import GridSpectrum, RingSpectrum
from studies.study import Report, Study, run_fabrics

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
    plan = specimen(number, seed=seed)
    rig, rng = RIG, np.random.default_rng([seed, number])
    found = []
    for k in range(starts):
        shape = drape_specimen(plan, edge=1e-3 * edge_mm, start=STARTS[k % len(STARTS)], seed=k)
        one = describe_drape(shape.positions, shape.mesh, rig)
        estimate = infer(capture_drape(shape, ideal_setups(), rng))
        found.append(one | {"network": estimate.theta[LINEAR].tolist()})
    return {"drapes": found, "log_alpha": plan.theta[LINEAR].tolist()}


def scan_case(*, path: str, seed: int) -> dict[str, Any]:
    """Descriptors of one scan."""
    scan = read_scan(Path(path), DISC_RIG)
    capture = Setups.load("real").capture(
        scan.positions, scan.faces, np.random.default_rng([seed, *map(ord, Path(path).stem)]),
        nominal=CameraRig.load(DISC_RIG))
    header = read_header(bundled(DISC_RIG))
    estimate = estimate_views(capture.views, capture.intrinsics, header)
    one = describe_drape(scan.positions, Mesh(scan.rest, scan.faces), DISC_RIG)
    return one | {"network": estimate.samples[:, LINEAR].mean(axis=0).tolist()}


def run(config: dict[str, Any]) -> Report:
    """Run simulated drapes, and scans if their folder is given."""
    found = run_fabrics(fabric_case, config, sources=ESTIMATOR_SOURCES, subfolder="simulated")
    drapes = [one for result in found.values() for one in result["drapes"]]
    fabric = np.repeat(np.arange(len(found)), config["starts"])
    sets = {"simulated": identification_rates(drapes, fabric, np.arange(len(drapes)))}
    if config["scans"]:
        scans = run_scans(scan_case, config)
        names = np.array([fabric_and_sample(name) for name in scans])
        sample = names[:, 0] * 1000 + names[:, 1]
        sets["scans, other sample"] = identification_rates(
            list(scans.values()), names[:, 0], sample)
    return {"sets": sets}


def identification_rates(
    found: list[dict], fabric: np.ndarray, sample: np.ndarray
) -> dict[str, Any]:
    """Fractions of drapes whose nearest neighbour of another sample is of the same fabric.

    Drapes of fabrics with one sample are not counted.
    """
    other = sample[:, None] != sample
    counted = (other & (fabric[:, None] == fabric)).any(axis=1)
    shares = {}
    for name in DESCRIPTORS:
        values = np.array([one[name] for one in found], float)
        if name in STANDARDISED:
            values = values / values.std(axis=0)
        distances = np.where(other, np.linalg.norm(values[:, None] - values, axis=-1), np.inf)
        shares[name] = float(np.mean(fabric[distances.argmin(axis=1)][counted] == fabric[counted]))
    chance = ((other & (fabric[:, None] == fabric)).sum(axis=1) / other.sum(axis=1))[counted]
    return {"drapes": int(counted.sum()), "fabrics": len(np.unique(fabric)),
            "chance": float(chance.mean()), "shares": shares}


def summarise(report: Report) -> str:
    """Summary in sentences."""
    parts = []
    for name, one in report["sets"].items():
        shares = one["shares"]
        best = max((key for key in shares if key != "network"), key=shares.get)
        parts.append(f"{name}, {shares[best]:.0%} with the best descriptor without a network "
                     f"({DESCRIPTORS[best]}), {shares['network']:.0%} with the network's α, "
                     f"{one['chance']:.0%} by chance")
    return "The nearest neighbour of a drape is of the same fabric: " + "; ".join(parts) + "."


def rows(report: Report) -> tuple[list[str], list[list[object]]]:
    """Table of identification rates by descriptor and set."""
    sets = report["sets"]
    head = ["descriptor", *(f"{name} ({one['drapes']} drapes, {one['fabrics']} fabrics)"
                             for name, one in sets.items())]
    return head, [*([DESCRIPTORS[key], *(f"{one['shares'][key]:.0%}" for one in sets.values())]
                    for key in DESCRIPTORS),
                  ["chance", *(f"{one['chance']:.0%}" for one in sets.values())]]


def draw(report: Report) -> Figure:
    """Plot identification rates as bars."""
    figure = Figure(figsize=(8, 3), layout="constrained")
    axes = figure.subplots()
    height = 0.8 / len(report["sets"])
    for k, (name, one) in enumerate(report["sets"].items()):
        places = np.arange(len(DESCRIPTORS)) + k * height
        axes.barh(places, [100 * one["shares"][key] for key in DESCRIPTORS], height, label=name)
    axes.set_yticks(np.arange(len(DESCRIPTORS)) + 0.2, list(DESCRIPTORS.values()))
    axes.set(xlabel="drapes whose nearest neighbour is of the same fabric [%]", xlim=(0, 100))
    axes.invert_yaxis()
    axes.legend(frameon=False)
    return figure


STUDY = Study(
    "recognition", "Fabric identification without a network", "000, Figure 7; 002, Figure 20",
    "How well do drape coefficient, folds, curvature and spectra identify a fabric?",
    run, summarise, rows, draw,
    "finds distances of spectra larger between fabrics than within one (000, Figure 7), and a "
    "network less accurate on boundary curves than on depth (002, Figure 20). Only qualitatively "
    "comparable.",
    "Simulated fabrics have no friction, and captures have no faults. Neighbours of a scan must be "
    "of another sample, because two captures of one sample share its cut and history. With 60 "
    "scans, a rate has a standard error of about 6 points.")
