"""Variation of estimates between drapes and captures of one fabric (002, Figures 22 and 23)."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from data.dataset.config import STARTS
from data.render.setups import Setups, SyntheticCapture
from drapenet.inference import CaptureEstimate
from drapenet.report.figures import COLOURS
from drapenet.views.radial_map import compressed
from experiments.drapes import (
    RIG,
    capture_drape,
    drape_specimen,
    ideal_setups,
    infer,
    plan_specimen,
)
from experiments.page import Section
from experiments.papers.networks import CaptureSet, image
from experiments.papers.trainings import Training, load_trained, predict, train_all
from experiments.result import (
    Config,
    Report,
    Result,
    label_log_axes,
    load_arrays,
    run_fabrics,
    table,
)
from sim.material import DIRECTIONS, LINEAR

FACTORS = {"starts": "other start", "orientations": "same drape, other orientation",
           "set-ups": "same drape, other camera, sensor and turns"}
NETWORKS: dict[str, tuple[str, Training]] = {
    "one start": ("map, drapes from sine starts only",
                  Training("starts", start="sine", keep_weights=True)),
    "several starts": ("map, as many drapes from sine, fold and ring starts",
                       Training("starts", starts=1, keep_weights=True)),
    "one orientation": ("stacked views, specimens in one orientation",
                        Training(input="views", network="resnet18", fixed=True, keep_weights=True)),
    "any orientation": ("stacked views, in any orientation",
                        Training(input="views", network="resnet18", keep_weights=True))}
"""Small networks for comparison: label of inputs and training data, and training."""


def case(*, number: int, starts: int, orientations: int, edge_mm: float, seed: int) -> dict:
    """Posterior means of log alpha (captures, 3) of one fabric by varied factor, and the truth.

    "arrays" has the inputs of the small networks for the same captures.
    """
    plan = plan_specimen(number, seed=seed)
    rng = np.random.default_rng([seed, number])
    shapes = [drape_specimen(plan, edge=1e-3 * edge_mm, start=STARTS[k % len(STARTS)], seed=k)
              for k in range(starts)]
    captures = {
        "starts": [capture_drape(shape, ideal_setups(), rng) for shape in shapes],
        "orientations": [capture_drape(shapes[0], ideal_setups(), rng)
                         for _ in range(orientations)],
        "set-ups": [capture_drape(shapes[0], Setups.load("real"), rng)
                    for _ in range(orientations)]}
    found = {factor: [infer(one) for one in members] for factor, members in captures.items()}
    arrays: dict[str, np.ndarray] = {}
    for factor in ("starts", "orientations"):
        inputs = _network_inputs(captures[factor], found[factor])
        arrays |= {f"{factor}.{name}": value for name, value in inputs.items()}
    return {"theta": plan.theta.tolist(), "arrays": arrays,
            **{factor: [one.estimate.samples[:, LINEAR].mean(axis=0).tolist() for one in readings]
               for factor, readings in found.items()}}


def _network_inputs(
    captures: list[SyntheticCapture], readings: list[CaptureEstimate]
) -> dict[str, np.ndarray]:
    """Inputs of the small networks, see :class:`CaptureSet`."""
    maps = [one.observation.map for one in readings]
    distance, weight = compressed(
        np.array([one.distance for one in maps]) / RIG.specimen_size,
        np.array([one.weight for one in maps]))
    return {"distance": distance, "weight": weight,
            "images": np.array([image(one.views, one.intrinsics.fx) for one in captures])}


def run(config: Config) -> Result:
    """Run all fabrics with the bundled network and those of :data:`NETWORKS`."""
    fabrics = run_fabrics(case, config)
    learned = config["learned"] | {"workers": config["workers"]}
    trainings = {name: replace(one, steps=learned["steps"]) for name, (_, one) in NETWORKS.items()}
    results = train_all(trainings, learned)
    networks = {name: {"error": results[name]["unseen"]["fabrics"]["log_alpha"]["rmse"],
                       "starts": {}, "orientations": {}} for name in NETWORKS}
    for name, one in trainings.items():
        experiment = load_trained(one, results[name], learned)
        for fabric in fabrics:
            arrays = load_arrays(Path(config["cases"]), fabric)
            for factor in ("starts", "orientations"):
                names = ["images"] if one.input == "views" else ["distance", "weight"]
                inputs = [arrays[f"{factor}.{part}"] for part in names]
                make = CaptureSet.of_images if one.input == "views" else CaptureSet.of_maps
                many, scale = len(inputs[0]), experiment.training.scale
                captures = make(*inputs, np.tile(fabrics[fabric]["theta"], (many, 1)),
                                np.zeros(many, int), scale)
                estimates, _ = predict(experiment.network, captures, posterior=False)
                networks[name][factor][fabric] = scale.decode(estimates)[:, LINEAR].tolist()
    return Result({"fabrics": fabrics, "networks": networks})


def _variation(log_alpha: np.ndarray | list) -> np.ndarray:
    """Coefficients of variation (3,) of alpha, %, from log alpha (N, 3)."""
    alpha = np.exp(log_alpha)
    return 100 * np.std(alpha, axis=0, ddof=1) / np.mean(alpha, axis=0)


def variations(report: Report) -> dict[str, np.ndarray]:
    """Coefficients of variation (F, 3) of alpha, %, by varied factor."""
    return {factor: np.array([_variation(one[factor]) for one in report["fabrics"].values()])
            for factor in FACTORS}


def _network_variations(report: Report) -> dict[str, dict[str, float]]:
    """Median coefficient of variation, %, of each small network, by varied factor."""
    return {name: {factor: float(np.median([_variation(values) for values in one[factor].values()]))
                   for factor in ("starts", "orientations")}
            for name, one in report["networks"].items()}


def summarise(report: Report) -> str:
    """Summary in sentences."""
    found = {factor: np.median(values) for factor, values in variations(report).items()}
    small = _network_variations(report)
    return (f"The coefficient of variation of α (median over fabrics) is {found['starts']:.1f} % "
            f"over starts, {found['orientations']:.1f} % over orientations of one drape and "
            f"{found['set-ups']:.1f} % over set-ups. The mean over a fabric's starts still has an "
            f"error of {100 * _common_error(report):.0f} % (root mean square): most of the error "
            "is common to all drapes of a fabric. A small network trained on one start varies by "
            f"{small['one start']['starts']:.1f} % over starts, one trained on several by "
            f"{small['several starts']['starts']:.1f} %; trained on one orientation it varies by "
            f"{small['one orientation']['orientations']:.1f} % over orientations, on all by "
            f"{small['any orientation']['orientations']:.1f} %.")


def _common_error(report: Report) -> float:
    """Root mean square over fabrics of the error of log alpha averaged over starts."""
    return float(np.sqrt(np.mean([np.square(np.mean(one["starts"], axis=0) - one["theta"][:3])
                                  for one in report["fabrics"].values()])))


def rows(report: Report) -> tuple[list[str], list[list[object]]]:
    """Table of medians and largest values over fabrics."""
    return (["varied factor", *(f"{name}: median, largest, %" for name in DIRECTIONS)],
            [[FACTORS[factor], *(f"{np.median(v):.1f}, {v.max():.1f}" for v in values.T)]
             for factor, values in variations(report).items()])


def small_networks(report: Report) -> str:
    """Table of the small networks."""
    return table(["input and training data of a small network", "error of log α, unseen fabrics",
                  "variation over starts, %", "over orientations, %"],
                 [[NETWORKS[name][0], f"{report['networks'][name]['error']:.2f}",
                   f"{one['starts']:.1f}", f"{one['orientations']:.1f}"]
                  for name, one in _network_variations(report).items()])


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


SECTION = Section(
    "Repeatability", "002, Figures 22 and 23",
    "How much do estimates of one fabric vary with its folds, its orientation and the camera's "
    "position?",
    summarise, rows, draw,
    "reports low coefficients of variation, five points higher for a network trained on one "
    "start, without a table; not comparable, because its fabrics are real and draped by hand.",
    "The fabrics have no hysteresis, which adds to the variation of real cloth. The small networks "
    "were trained for minutes (`experiments/papers/trainings.py`) and their estimates shrink "
    "towards the mean, so that their variation is smaller than their error; it is "
    "that of the stiffer and the softer yarns.",
    second_table=small_networks)
