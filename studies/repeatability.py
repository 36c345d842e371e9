"""Does the same fabric give the same moduli, whichever way it drapes? (002, Figures 22 and 23)."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.common import ESTIMATOR, tick_short_scales
from data.sampling import STARTS
from drapenet.convention import COLOURS, LINEAR, WARP_WEFT
from studies.captured import draped, ideal, read, seen, specimen
from studies.study import Report, Study, over_fabrics

WAYS = {"starts": "other start", "orientations": "same drape, other orientation",
        "set-ups": "same drape, other camera, sensor and turns"}


def case(*, number: int, starts: int, orientations: int, edge_mm: float, seed: int) -> dict:
    """Posterior means of log alpha of one fabric, (captures, 3) by what varies, and the truth."""
    from data.setups import Setups

    plan = specimen(number, seed=seed)
    rng = np.random.default_rng([seed, number])
    shapes = [draped(plan, edge=1e-3 * edge_mm, start=STARTS[k % len(STARTS)], seed=k)
              for k in range(starts)]
    found = {
        "starts": [read(seen(shape, ideal(), rng)) for shape in shapes],
        "orientations": [read(seen(shapes[0], ideal(), rng)) for _ in range(orientations)],
        "set-ups": [read(seen(shapes[0], Setups.load("real"), rng)) for _ in range(orientations)]}
    return {"theta": plan.theta.tolist(),
            **{way: [one.theta[LINEAR].tolist() for one in readings]
               for way, readings in found.items()}}


def run(config: dict[str, Any]) -> Report:
    """All fabrics."""
    return {"fabrics": over_fabrics(case, config, sources=ESTIMATOR)}


def variations(report: Report) -> dict[str, np.ndarray]:
    """(F, 3) coefficients of variation of alpha, %, by what varies."""
    return {way: np.array([100 * np.std(np.exp(one[way]), axis=0, ddof=1)
                           / np.mean(np.exp(one[way]), axis=0)
                           for one in report["fabrics"].values()]) for way in WAYS}


def answer(report: Report) -> str:
    """In sentences."""
    found = {way: np.median(values) for way, values in variations(report).items()}
    return (f"The coefficient of variation of α is {found['starts']:.1f} % over starts (median "
            f"over fabrics), {found['orientations']:.1f} % over orientations of one drape and "
            f"{found['set-ups']:.1f} % over set-ups. The mean over a fabric's starts still has an "
            f"error of {100 * _common(report):.0f} % (root mean square): most of the error is "
            "common to all drapes of a fabric, and more drapes do not remove it.")


def _common(report: Report) -> float:
    """Root mean square of what all starts of a fabric have in common of the error of log alpha."""
    return float(np.sqrt(np.mean([np.square(np.mean(one["starts"], axis=0) - one["theta"][:3])
                                  for one in report["fabrics"].values()])))


def rows(report: Report) -> tuple[list[str], list[list[object]]]:
    """Medians and largest values."""
    return (["what varies", *(f"{name}: median, largest, %" for name in WARP_WEFT)],
            [[WAYS[way], *(f"{np.median(v):.1f}, {v.max():.1f}" for v in values.T)]
             for way, values in variations(report).items()])


def draw(report: Report) -> Figure:
    """Estimated over true alpha, one column a fabric."""
    figure = Figure(figsize=(10, 3.6), layout="constrained")
    for axes, way in zip(figure.subplots(1, len(WAYS), sharey=True), WAYS, strict=True):
        for place, one in enumerate(report["fabrics"].values()):
            ratio = np.exp(np.array(one[way]) - one["theta"][:3])
            for k, colour in enumerate(COLOURS):
                axes.plot(np.full(len(ratio), place + 0.22 * (k - 1)), ratio[:, k], ".", ms=4,
                          color=colour, label=WARP_WEFT[k] if place == 0 else None)
        axes.axhline(1.0, color="0.6", lw=0.8)
        axes.set(yscale="log", xlabel="fabric", ylim=(0.5, 2))
        axes.set_title(WAYS[way].replace(", ", ",\n", 1), fontsize=9)
        tick_short_scales(axes.yaxis)
    figure.axes[0].set_ylabel("α estimated / true")
    figure.axes[0].legend(fontsize=8)
    return figure


STUDY = Study(
    "repeatability", "Repeatability", "002, Figures 22 and 23",
    "How much do estimates of one fabric vary with its folds, its orientation and the camera's "
    "position?", run, answer, rows, draw,
    "low coefficients of variation, five points higher for a network trained on one start; no "
    "table. Not comparable: theirs are of real fabrics draped by hand.",
    "Simulated fabrics without friction, which in real cloth adds to the scatter. Networks trained "
    "on one start or on one orientation were not compared: each takes two hours of training.")
