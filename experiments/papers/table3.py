"""Comparison of estimation methods by simulated drapes of their estimates (002, Table 3)."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from common.configs import read_option
from common.errors import InputError
from data.fabrics.fabrics import fabric_from_theta
from data.fabrics.prior import load_prior
from drapenet.config import EstimateOptions
from experiments.comparison import compare
from experiments.drapes import (
    capture_drape,
    drape_specimen,
    header,
    ideal_setups,
    infer,
    plan_specimen,
    spread,
)
from experiments.report import Report, label_log_axes, rms, table
from experiments.study import CaseKeys, Sample, Study, samples_of
from sim.cantilever.moduli import estimate_moduli, fabric_of
from sim.cantilever.strip import simulate_strips
from sim.draping import Drape, drape, follow
from sim.material import DIRECTIONS, REFERENCE_DENSITY, Fabric, gravity_length
from sim.rig import HUNG_SQUARE

NETWORK, REFINED = "network", "refined"
PRIOR, OTHER_DRAPE = "mean of the prior", "another drape of the fabric"
METHODS = ("strips, regression", "strips, table", NETWORK, REFINED, PRIOR, OTHER_DRAPE)
LENGTHS = (1.5, 2.5)  # of the two strips of a direction, in bending lengths
SHAPES = {"drape": "cylinder", "hung": "hung"}
Difference = list[float] | None
"""Mean displacement, mm, and difference of mean curvature, %; None without convergence."""


def estimate_strips(
    fabric: Fabric, *, noise: float, cells: int, seed: int
) -> dict[str, Fabric]:
    """Fabrics estimated from noisy free cantilever strips, by method that did not fail."""
    found: dict[str, Fabric] = {}
    lengths = {direction: [x * gravity_length(alpha, fabric.density) for x in LENGTHS]
               for direction, alpha in zip(DIRECTIONS, fabric.alpha, strict=True)}
    try:
        strips = simulate_strips(fabric, lengths, cells=cells, seed=seed)
    except InputError:
        return found
    rng, noisy = np.random.default_rng(seed), {}
    for direction, curves in strips.items():  # but for the edge of the clamp
        noisy[direction] = [np.vstack([[0.0, 0.0], one[1:]]) for one in (
            curve + rng.normal(0.0, noise, curve.shape) for curve in curves)]
    for method in ("regression", "table"):
        try:
            found[f"strips, {method}"] = fabric_of(
                estimate_moduli(noisy, density=fabric.density, method=method), fabric.density)
        except InputError:
            continue
    return found


class Keys(CaseKeys):
    fabrics: int = 10  # drawn from the prior; a minute each
    edge_mm: float = 3.0  # at the rim, of compared drapes; captured drapes have half of it
    hung_mm: float = 10.0  # mesh edge length of the hung square
    noise_mm: float = 0.3  # standard deviation, of the points of a strip's curve
    cells: int = 20  # mesh cells per bending length of strips, and points of their curves
    refined: bool = True  # whether to refine estimates
    seed: int = 303
    workers: int = 2


def fabric(
    rng: np.random.Generator, *, number: int, edge_mm: float, hung_mm: float, noise_mm: float,
    cells: int, refined: bool, seed: int
) -> Sample:
    """Errors of log alpha and differences of drapes of one fabric by method."""
    from drapenet.fabric.stages import estimate_capture

    edge, plan = 1e-3 * edge_mm, plan_specimen(number, seed=seed)
    truth = fabric_from_theta(plan.theta)
    shape = drape_specimen(plan, edge=0.5 * edge)  # finer than the drapes of the estimates
    captured = capture_drape(shape, ideal_setups(), rng)
    strips = estimate_strips(truth, noise=1e-3 * noise_mm, cells=cells, seed=seed + number)
    reading = infer(captured)
    found = strips | {NETWORK: fabric_from_theta(reading.estimate.samples.mean(axis=0)),
                      PRIOR: fabric_from_theta(load_prior("gaussian").mean)}
    if refined:
        one = estimate_capture(reading.capture, header(), EstimateOptions(
            refine=read_option("refine", "simulation"), drapes=0)).estimate
        found[REFINED] = fabric_from_theta(one.samples.mean(axis=0))
    ways: dict[str, Any] = {}
    # Start and folds differ from those of the captured drape.
    start = {"edge": edge, "start": "ring", "seed": plan.seed + 1}
    true = drape(truth, **start)
    hung = drape(truth, rig=HUNG_SQUARE, edge=1e-3 * hung_mm)
    for name, one in found.items():
        error = np.log(one.at_density(REFERENCE_DENSITY).alpha / truth.alpha) / spread()[:3]
        ways[name] = {"error": error.tolist(), "drape": _difference(true, drape(one, **start)),
                      "hung": _difference(hung, follow(hung, one))}
    other_drape = drape(truth, **start | {"seed": plan.seed + 2})
    other_hung = drape(truth, rig=HUNG_SQUARE, edge=1e-3 * hung_mm, seed=1)
    ways[OTHER_DRAPE] = {"drape": _difference(true, other_drape, turned=True),
                         "hung": _difference(hung, other_hung)}
    return {"ways": ways}


def _difference(reference: Drape, other: Drape, *, turned: bool = False) -> Difference:
    if not (reference.converged and other.converged):
        return None
    return compare(reference, other, turned=turned).row


def run(keys: Keys) -> Report:
    """Run all fabrics."""
    refused: dict[str, str] = {}
    return {"fabrics": samples_of(fabric, keys, keys.fabrics, refused=refused, kind="fabric"),
            "refused": refused}


def _simulated(report: Report, method: str) -> list[dict[str, Any]]:
    """Results of a method for all fabrics."""
    return [one["ways"][method] for one in report["fabrics"].values()
            if method in one["ways"]]


def _distances(report: Report, shape: str, method: str) -> np.ndarray:
    """Displacements, mm, and differences of curvature, %, (N, 2) of a method for a key of
    :data:`SHAPES`."""
    found = [one[shape] for one in _simulated(report, method)]
    return np.array([one for one in found if one is not None]).reshape(-1, 2)


def block(report: Report) -> str:
    """Median errors and displacements by method."""
    lines = []
    for method in METHODS:
        found = _simulated(report, method)
        error = np.array([one["error"] for one in found if "error" in one])
        known = f", {rms(error):.2f}" if error.any() else ""
        if found:
            lines.append([method, f"{len(found)}{known}",
                          *(_cell(_distances(report, shape, method)) for shape in SHAPES)])
    return table(["moduli from", "fabrics, error of log α",
                  *(f"{shape}, mm (95 %); %" for shape in SHAPES.values())], lines)


def _cell(values: np.ndarray) -> str:
    """Medians of displacements, with the 95 % bootstrap interval over drapes, and of differences of
    curvature, (N, 2)."""
    if not len(values):
        return "–"
    drawn = np.random.default_rng(0).integers(len(values), size=(1000, len(values)))
    low, high = np.quantile(np.median(values[drawn, 0], axis=1), [0.025, 0.975])
    displacement, curvature = np.median(values, axis=0)
    return f"{displacement:.2f} ({low:.2f} to {high:.2f}); {curvature:.0f}"


def draw(report: Report) -> Figure:
    """Plot displacements of all fabrics by method."""
    figure = Figure(figsize=(10, 3.6), layout="constrained")
    axes = figure.subplots(1, len(SHAPES), sharey=True, sharex=True)
    for panel, (shape, title) in zip(axes, SHAPES.items(), strict=True):
        for k, method in enumerate(METHODS):
            values = _distances(report, shape, method)[:, 0]
            panel.plot(values, k + np.linspace(-0.25, 0.25, len(values)), ".", alpha=0.6)
            if len(values):
                panel.plot([np.median(values)] * 2, [k - 0.4, k + 0.4], "k", lw=1.5)
        panel.set(xscale="log", title=title, xlabel="mean displacement [mm]; bars: medians")
        panel.set_yticks(range(len(METHODS)), METHODS)
        label_log_axes(panel.xaxis)
        panel.tick_params(axis="x", labelsize=8)
    axes[0].set_ylim(len(METHODS) - 0.5, -0.5)
    return figure


STUDY = Study(Keys, run, block, draw)
