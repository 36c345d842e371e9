"""Variation of estimates between drapes and captures of one fabric (002, Figures 22 and 23)."""


import numpy as np
from matplotlib.figure import Figure

from data.dataset.config import STARTS
from data.render.setups import Setups
from drapenet.report.figures import COLOURS
from experiments.drapes import (
    capture_drape,
    drape_specimen,
    ideal_setups,
    infer,
    plan_specimen,
)
from experiments.report import Report, label_log_axes, rms, table
from experiments.study import CaseKeys, Sample, Study, samples_of
from sim.material import DIRECTIONS, LINEAR

FACTORS = {"starts": "other start", "orientations": "same drape, other orientation",
           "set-ups": "same drape, other camera, sensor and turns"}


class Keys(CaseKeys):
    fabrics: int = 10  # drawn from the prior
    starts: int = 8  # drapes per fabric, from different starts
    orientations: int = 12  # captures of the first drape
    edge_mm: float = 3.0  # mesh edge length at the rim
    seed: int = 404
    workers: int = 2


def fabric(rng: np.random.Generator, *, number: int, starts: int, orientations: int,
           edge_mm: float, seed: int) -> Sample:
    """Posterior means of log alpha (captures, 3) of one fabric by varied factor, and the truth."""
    plan = plan_specimen(number, seed=seed)
    shapes = [drape_specimen(plan, edge=1e-3 * edge_mm, start=STARTS[k % len(STARTS)], seed=k)
              for k in range(starts)]
    captures = {
        "starts": [capture_drape(shape, ideal_setups(), rng) for shape in shapes],
        "orientations": [capture_drape(shapes[0], ideal_setups(), rng)
                         for _ in range(orientations)],
        "set-ups": [capture_drape(shapes[0], Setups.load("real"), rng)
                    for _ in range(orientations)]}
    return {"theta": plan.theta.tolist(), **{
        factor: [infer(one).estimate.samples[:, LINEAR].mean(axis=0).tolist() for one in members]
        for factor, members in captures.items()}}


def run(keys: Keys) -> Report:
    """Run all fabrics."""
    return {"fabrics": samples_of(fabric, keys, keys.fabrics, kind="fabric")}


def _variation(log_alpha: np.ndarray | list) -> np.ndarray:
    """Coefficients of variation (3,) of alpha, %, from log alpha (N, 3)."""
    alpha = np.exp(log_alpha)
    return 100 * np.std(alpha, axis=0, ddof=1) / np.mean(alpha, axis=0)


def variations(report: Report) -> dict[str, np.ndarray]:
    """Coefficients of variation (F, 3) of alpha, %, by varied factor."""
    return {factor: np.array([_variation(one[factor]) for one in report["fabrics"].values()])
            for factor in FACTORS}


def _common_error(report: Report) -> float:
    """Root mean square over fabrics of the error of log alpha averaged over starts."""
    return rms([np.mean(one["starts"], axis=0) - one["theta"][:3]
                for one in report["fabrics"].values()])


def block(report: Report) -> str:
    """Summary and table."""
    found = {factor: np.median(values) for factor, values in variations(report).items()}
    text = (f"The coefficient of variation of α (median over fabrics) is {found['starts']:.1f} % "
            f"over starts, {found['orientations']:.1f} % over orientations of one drape and "
            f"{found['set-ups']:.1f} % over set-ups. The mean over a fabric's starts still has an "
            f"error of {100 * _common_error(report):.0f} % (root mean square): most of the error "
            "is common to all drapes of a fabric.")
    rows = [[FACTORS[factor], *(f"{np.median(v):.1f}, {v.max():.1f}" for v in values.T)]
            for factor, values in variations(report).items()]
    head = ["varied factor", *(f"{name}: median, largest, %" for name in DIRECTIONS)]
    return f"{text}\n\n{table(head, rows)}"


def draw(report: Report) -> Figure:
    """Plot estimated over true alpha by fabric."""
    figure = Figure(figsize=(10, 3.6), layout="constrained")
    for axes, factor in zip(figure.subplots(1, len(FACTORS), sharey=True), FACTORS, strict=True):
        for place, one in enumerate(report["fabrics"].values()):
            ratio = np.exp(np.array(one[factor]) - one["theta"][:3])
            for k, colour in enumerate(COLOURS):
                axes.plot(np.full(len(ratio), place + 0.22 * (k - 1)), ratio[:, k], ".", ms=4,
                          color=colour, label=DIRECTIONS[k] if place == 0 else None)
        axes.axhline(1.0, color="0.6", lw=0.8)
        axes.set(yscale="log", xlabel="fabric", ylim=(0.5, 2))
        axes.set_title(FACTORS[factor].replace(", ", ",\n", 1), fontsize=9)
        label_log_axes(axes.yaxis)
    figure.axes[0].set_ylabel("α estimated / true")
    figure.axes[0].legend(fontsize=8)
    return figure


STUDY = Study(Keys, run, block, draw)
