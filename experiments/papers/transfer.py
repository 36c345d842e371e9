"""Transfer of an estimated fabric to simulators with hinges (002, Figure 24, section 7.4)."""

from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from data.fabrics.fabrics import fabric_from_theta
from drapenet.export.material import hinge_ratio
from experiments.comparison import Shape, compare, equilibrium_near
from experiments.drapes import RIG, drape_specimen, plan_specimen
from experiments.report import Report, label_log_axes, table
from experiments.study import CaseKeys, Sample, Study, samples_of
from sim.cloth import Laws
from sim.draping import Drape
from sim.mesh.specimen import TOPOLOGIES
from sim.scene import Scene, make_specimen
from sim.solver.newton import Status

LAWS = {"hinges along the edge": "hinge_edge", "hinges, mean modulus": "hinge"}
OTHER_MESH = "the plate's law on another mesh"
RATIO = hinge_ratio("unstructured", cells=30)
"""Ratio of hinge modulus to plate modulus for the same strip shape on unstructured meshes."""


class Keys(CaseKeys):
    fabrics: int = 10  # drawn from the prior
    edge_mm: float = 2.5  # mesh edge length at the rim
    seed: int = 707
    workers: int = 2


def fabric(*, number: int, edge_mm: float, seed: int) -> Sample:
    """Displacement, mm, and difference of mean curvature, %, from the drape of the plate law to the
    nearest equilibrium of each model of one fabric; None without convergence.
    """
    plan, rig, edge = plan_specimen(number, seed=seed), RIG, 1e-3 * edge_mm
    bending = fabric_from_theta(plan.theta)
    plate = drape_specimen(plan, edge=edge)
    equivalent = replace(bending, alpha=RATIO * bending.alpha, beta=RATIO * bending.beta)
    same = Scene(plate.mesh, plate.held)
    cases = {f"{name}, {model}": (same, one, Laws(bending=law)) for name, law in LAWS.items()
             for model, one in (("α as estimated", bending), ("equivalent α", equivalent))}
    cases[OTHER_MESH] = (make_specimen(rig, edge=edge, topology=(plan.seed + 1) % TOPOLOGIES),
                         bending, Laws())
    result: dict[str, Any] = {}
    for name, (mesh, one, laws) in cases.items():
        equilibrium = equilibrium_near(plate, mesh, rig, one, laws)
        result[name] = None
        if equilibrium.status is Status.CONVERGED:
            result[name] = _difference(plate, equilibrium.state.positions, mesh)
    return result


def _difference(plate: Drape, positions: np.ndarray, mesh: Scene) -> list[float]:
    """Displacement, mm, and difference of mean curvature, %, of positions (V, 3), m."""
    return compare(plate, Shape.of(mesh, positions)).row


def run(keys: Keys) -> Report:
    """Run all fabrics."""
    return {"ratio": RATIO, "fabrics": samples_of(fabric, keys, keys.fabrics, kind="fabric")}


def _by_model(report: Report) -> dict[str, tuple[np.ndarray, int]]:
    """Displacements and differences of curvature (F, 2), and number of fabrics, by model; those of
    the stored report in Newton's Style3D, too."""
    found = {}
    for fabrics in (report["fabrics"], report.get("style3d", {})):
        for model in next(iter(fabrics.values()), {}):
            if model != "motion":
                values = [one[model] for one in fabrics.values() if one[model] is not None]
                found[model] = np.array(values).reshape(-1, 2), len(fabrics)
    return found


def block(report: Report) -> str:
    """Summary and table."""
    text = (f"The equivalent modulus is {report['ratio']:.3f} α ([exports](exports.md)). Hinges "
            "along the edge have the modulus of its direction.")
    rows = [[model, f"{len(values)} of {tried}",
             f"{np.median(values[:, 0]):.2f}, {values[:, 0].max():.2f}" if len(values) else "–",
             f"{np.median(values[:, 1]):.1f}" if len(values) else "–"]
            for model, (values, tried) in _by_model(report).items()]
    head = ["simulated with", "converged", "displacement, mm: median, largest",
            "curvature, %: median"]
    return f"{text}\n\n{table(head, rows)}"


def draw(report: Report) -> Figure:
    """Plot displacements by model."""
    figure = Figure(figsize=(8, 3.4), layout="constrained")
    axes = figure.subplots()
    found = _by_model(report)
    for k, (values, _) in enumerate(found.values()):
        if len(values):
            axes.plot(values[:, 0], np.full(len(values), k), "o", alpha=0.6)
            axes.plot(np.median(values[:, 0]), k, "k|", ms=22, mew=2)
    axes.set(xscale="log", xlabel="mean displacement from the plate's drape [mm]",
             ylim=(len(found) - 0.5, -0.5))
    axes.set_yticks(range(len(found)), list(found))
    label_log_axes(axes.xaxis)
    return figure


STUDY = Study(Keys, run, block, draw)
