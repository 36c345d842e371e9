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
from studies.captured import RIG, draped, fabric_and_sample, ideal, over_scans, read, seen, specimen
from studies.descriptors import GridSpectrum, RingSpectrum
from studies.study import Report, Study, over_fabrics

DESCRIPTIONS = {
    "coefficient": "drape coefficient and number of folds",
    "shape": "mean height, mean squared curvature",
    "grid": "2-D spectrum (000, Eq. 9)",
    "rings": "spectrum along rings",
    "network": "the network's log α",
}
SCALED = ("coefficient", "shape", "network")
"""Descriptions of several quantities, each divided by its standard deviation."""


def described(positions: np.ndarray, mesh: Mesh, rig: Rig) -> dict[str, list]:
    """All descriptions but the network's, of a drape with vertices at positions (V, 3), m."""
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


def simulated(*, number: int, starts: int, edge_mm: float, seed: int) -> dict[str, Any]:
    """Descriptions of all drapes of one fabric."""
    plan = specimen(number, seed=seed)
    rig, rng = Rig.from_name(RIG), np.random.default_rng([seed, number])
    found = []
    for k in range(starts):
        shape = draped(plan, edge=1e-3 * edge_mm, start=STARTS[k % len(STARTS)], seed=k)
        one = described(shape.positions, shape.mesh, rig)
        found.append(one | {"network": read(seen(shape, ideal(), rng)).theta[LINEAR].tolist()})
    return {"drapes": found, "log_alpha": plan.theta[LINEAR].tolist()}


def scanned(*, path: str, seed: int) -> dict[str, Any]:
    """Descriptions of one scan."""
    scan = read_scan(Path(path), DISC_RIG)
    capture = Setups.load("real").capture(
        scan.positions, scan.faces, np.random.default_rng([seed, *map(ord, Path(path).stem)]),
        nominal=CameraRig.load(DISC_RIG.name).intrinsics)
    header = read_header(bundled(DISC_RIG.name))
    estimate = estimate_views(capture.views, capture.intrinsics, header)
    one = described(scan.positions, Mesh(scan.rest, scan.faces), DISC_RIG)
    return one | {"network": estimate.samples[:, LINEAR].mean(axis=0).tolist()}


def run(config: dict[str, Any]) -> Report:
    """Simulated drapes, and scans where there are some."""
    found = over_fabrics(simulated, config, sources=ESTIMATOR_SOURCES, inside="simulated")
    drapes = [one for result in found.values() for one in result["drapes"]]
    fabric = np.repeat(np.arange(len(found)), config["starts"])
    sets = {"simulated": nearest(drapes, fabric, np.arange(len(drapes)))}
    if config["scans"]:
        described_scans = over_scans(scanned, config)
        names = np.array([fabric_and_sample(name) for name in described_scans])
        sample = names[:, 0] * 1000 + names[:, 1]
        sets["scans, other sample"] = nearest(list(described_scans.values()), names[:, 0], sample)
    return {"sets": sets}


def nearest(found: list[dict], fabric: np.ndarray, sample: np.ndarray) -> dict[str, Any]:
    """Share of drapes whose nearest drape of another sample is of the same fabric.

    Only drapes whose fabric has another sample count.
    """
    other = sample[:, None] != sample
    possible = (other & (fabric[:, None] == fabric)).any(axis=1)
    shares = {}
    for name in DESCRIPTIONS:
        values = np.array([one[name] for one in found], float)
        if name in SCALED:
            values = values / values.std(axis=0)
        apart = np.where(other, np.linalg.norm(values[:, None] - values, axis=-1), np.inf)
        shares[name] = float(np.mean(fabric[apart.argmin(axis=1)][possible] == fabric[possible]))
    chance = ((other & (fabric[:, None] == fabric)).sum(axis=1) / other.sum(axis=1))[possible]
    return {"drapes": int(possible.sum()), "fabrics": len(np.unique(fabric)),
            "chance": float(chance.mean()), "shares": shares}


def answer(report: Report) -> str:
    """Summary in sentences."""
    parts = []
    for name, one in report["sets"].items():
        shares = one["shares"]
        best = max((key for key in shares if key != "network"), key=shares.get)
        parts.append(f"{name}, {shares[best]:.0%} with the best descriptor without a network "
                     f"({DESCRIPTIONS[best]}), {shares['network']:.0%} with the network's α, "
                     f"{one['chance']:.0%} by chance")
    return "The nearest neighbour of a drape is of the same fabric: " + "; ".join(parts) + "."


def rows(report: Report) -> tuple[list[str], list[list[object]]]:
    """By description and set."""
    sets = report["sets"]
    head = ["description", *(f"{name} ({one['drapes']} drapes, {one['fabrics']} fabrics)"
                             for name, one in sets.items())]
    return head, [*([DESCRIPTIONS[key], *(f"{one['shares'][key]:.0%}" for one in sets.values())]
                    for key in DESCRIPTIONS),
                  ["chance", *(f"{one['chance']:.0%}" for one in sets.values())]]


def draw(report: Report) -> Figure:
    """Shares as bars."""
    figure = Figure(figsize=(8, 3), layout="constrained")
    axes = figure.subplots()
    height = 0.8 / len(report["sets"])
    for k, (name, one) in enumerate(report["sets"].items()):
        places = np.arange(len(DESCRIPTIONS)) + k * height
        axes.barh(places, [100 * one["shares"][key] for key in DESCRIPTIONS], height, label=name)
    axes.set_yticks(np.arange(len(DESCRIPTIONS)) + 0.2, list(DESCRIPTIONS.values()))
    axes.set(xlabel="drapes whose nearest neighbour is of the same fabric [%]", xlim=(0, 100))
    axes.invert_yaxis()
    axes.legend(frameon=False)
    return figure


STUDY = Study(
    "recognition", "Recognition without a network", "000, Figure 7; 002, Figure 20",
    "How well do drape coefficient, folds, curvature and spectra identify a fabric?",
    run, answer, rows, draw,
    "finds distances of spectra larger between fabrics than within one (000, Figure 7); a network "
    "worse on boundary curves alone than on depth (002, Figure 20). Comparable in kind only.",
    "Simulated fabrics have no friction and captures no faults. Neighbours of a scan must be of "
    "another sample, because two captures of one sample share its cut and history. With 60 scans, "
    "a share has a standard error of about 6 points.")
