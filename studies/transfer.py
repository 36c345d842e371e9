"""An estimated fabric in a simulator made of hinges (002, Figure 24 and section 7.4)."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.common import next_to, tick_short_scales
from data.fabrics import fabric_from_theta
from drapenet.comparison import compare
from sim.cantilever.equivalent import equivalent_modulus
from sim.laws import Laws
from sim.mesh import strip
from sim.mesh.specimens import TOPOLOGIES, Specimen, make_specimen
from sim.newton import Status
from sim.scene import Rig
from studies.captured import RIG, draped, specimen
from studies.study import Report, Study, over_fabrics

_CELLS, _SAMPLES = 30, 6  # of the strips from which the ratio of moduli is taken
LAWS = {"hinges along the edge": "hinge_edge", "hinges, mean modulus": "hinge"}
OTHER_MESH = "the plate's law on another mesh"


@cache
def ratio() -> float:
    """Modulus of hinges on unstructured meshes over that of the plate that they hang like."""
    length = 0.09
    edge = length / _CELLS
    found = [equivalent_modulus(*strip(
        length=length, width=round(_CELLS / 2) * edge, edge=edge, clamp=2 * edge,
        diagonals="random", jitter=0.2, seed=seed), gamma=10.0) for seed in range(_SAMPLES)]
    return float(np.mean([one.ratio for one in found if one.found]))


def case(*, number: int, edge_mm: float, seed: int) -> dict[str, Any]:
    """Displacement, mm, and difference of mean curvature, %, of the drapes of one fabric next to
    that of the plate's law; None where there is none.
    """
    plan, rig, edge = specimen(number, seed=seed), Rig.from_name(RIG), 1e-3 * edge_mm
    fabric = fabric_from_theta(plan.theta)
    plate = draped(plan, edge=edge)
    more = replace(fabric, alpha=ratio() * fabric.alpha, beta=ratio() * fabric.beta)
    same = Specimen(plate.mesh, plate.held)
    cases = {f"{name}, {way}": (same, one, Laws(bending=law)) for name, law in LAWS.items()
             for way, one in (("α as estimated", fabric), ("equivalent α", more))}
    cases[OTHER_MESH] = (make_specimen(rig, edge=edge, topology=(plan.seed + 1) % TOPOLOGIES),
                         fabric, Laws())
    result: dict[str, Any] = {}
    for name, (mesh, one, laws) in cases.items():
        near = next_to(plate.rest, plate.positions, mesh, rig, one, laws)
        result[name] = None
        if near.status is Status.CONVERGED:
            found = compare(plate, SimpleNamespace(positions=near.state.positions,
                                                   rest=mesh.mesh.rest, faces=mesh.mesh.faces))
            result[name] = [1e3 * found.displacement, 100 * found.curvature]
    return result


def run(config: dict[str, Any]) -> Report:
    """All fabrics."""
    return {"ratio": ratio(), "fabrics": over_fabrics(case, config, sources=("sim",))}


def _by_way(report: Report) -> dict[str, np.ndarray]:
    """(F, 2) displacements and differences of curvature by way."""
    first = next(iter(report["fabrics"].values()))
    return {way: np.array([one[way] for one in report["fabrics"].values() if one[way] is not None])
            for way in first}


def answer(report: Report) -> str:
    """In sentences."""
    found = {way: float(np.median(values[:, 0])) for way, values in _by_way(report).items()
             if len(values)}
    plain, equal = (found.get(f"hinges along the edge, {way}", np.nan)
                    for way in ("α as estimated", "equivalent α"))
    return (f"Drapes by hinges, each with the modulus across its edge, lie {plain:.2f} mm (median) "
            f"from those by the plate's law with α as estimated, and {equal:.2f} mm with the "
            f"equivalent modulus ({report['ratio']:.3f} α, docs/exports.md); the plate's law on "
            f"another mesh lies {found[OTHER_MESH]:.2f} mm away. The bias of hinges depends on "
            "the direction of folds on the mesh, which a single factor does not correct.")


def rows(report: Report) -> tuple[list[str], list[list[object]]]:
    """By law and modulus."""
    return (["simulated with", "converged", "displacement, mm: median, largest",
             "curvature, %: median"],
            [[way, f"{len(values)} of {len(report['fabrics'])}",
              f"{np.median(values[:, 0]):.2f}, {values[:, 0].max():.2f}" if len(values) else "–",
              f"{np.median(values[:, 1]):.1f}" if len(values) else "–"]
             for way, values in _by_way(report).items()])


def draw(report: Report) -> Figure:
    """Displacements by way."""
    figure = Figure(figsize=(8, 2.8), layout="constrained")
    axes = figure.subplots()
    found = _by_way(report)
    for k, values in enumerate(found.values()):
        if len(values):
            axes.plot(values[:, 0], np.full(len(values), k), "o", alpha=0.6)
            axes.plot(np.median(values[:, 0]), k, "k|", ms=22, mew=2)
    axes.set(xscale="log", xlabel="mean displacement from the plate's drape [mm]",
             ylim=(len(found) - 0.5, -0.5))
    axes.set_yticks(range(len(found)), list(found))
    tick_short_scales(axes.xaxis)
    return figure


STUDY = Study(
    "transfer", "Transfer to hinges", "002, Figure 24 and section 7.4",
    "Does a fabric drape alike in a simulator that bends at hinges, as ARCSim and many games do?",
    run, answer, rows, draw,
    "at most 0.1 mm between three simulators with the same bending model and parameters. Not "
    "comparable: there all three have one discrete law on one mesh; here two laws are compared.",
    "Each drape starts from that by the plate's law on the same mesh, so that folds are the same. "
    "The modulus is scaled as for unstructured meshes. The estimate was not given to "
    "another simulator here: drapes of Newton's Style3D on the cylinder are in *Moduli of another "
    "simulator's drape*, strips in docs/exports.md.")
