"""Variation of estimates between drapes and captures of one fabric (002, Figures 22 and 23)."""

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.common import ESTIMATOR_SOURCES, label_log_axes, load_arrays, table
from data.cameras import CameraRig
from data.sampling import STARTS
from data.setups import Setups, SyntheticCapture
from drapenet.convention import COLOURS, LINEAR, WARP_WEFT
from drapenet.maps import Maps, compressed
from drapenet.training import CaptureSet
from studies.captured import RIG, Reading, draped, ideal, read, seen, specimen
from studies.learned import Training, judged, kept, train_all
from studies.stacked_views import StackedSet, shrunk
from studies.study import Report, Study, over_fabrics

WAYS = {"starts": "other start", "orientations": "same drape, other orientation",
        "set-ups": "same drape, other camera, sensor and turns"}
NETWORKS: dict[str, tuple[str, Training]] = {
    "one start": ("map, drapes from sine starts only", Training("starts", start="sine", keep=True)),
    "several starts": ("map, as many drapes from sine, fold and ring starts",
                       Training("starts", starts=1, keep=True)),
    "one orientation": ("stacked views, specimens in one orientation",
                        Training(sees="views", network="resnet18", fixed=True, keep=True)),
    "any orientation": ("stacked views, in any orientation",
                        Training(sees="views", network="resnet18", keep=True))}
"""Small networks that are compared: what they see and learn from."""


def case(*, number: int, starts: int, orientations: int, edge_mm: float, seed: int) -> dict:
    """Posterior means of log alpha of one fabric, (captures, 3) by what varies, and the truth; as
    arrays, what other networks see of the same captures.
    """
    plan = specimen(number, seed=seed)
    rng = np.random.default_rng([seed, number])
    shapes = [draped(plan, edge=1e-3 * edge_mm, start=STARTS[k % len(STARTS)], seed=k)
              for k in range(starts)]
    captures = {
        "starts": [seen(shape, ideal(), rng) for shape in shapes],
        "orientations": [seen(shapes[0], ideal(), rng) for _ in range(orientations)],
        "set-ups": [seen(shapes[0], Setups.load("real"), rng) for _ in range(orientations)]}
    found = {way: [read(one) for one in members] for way, members in captures.items()}
    arrays: dict[str, np.ndarray] = {}
    for way in ("starts", "orientations"):
        arrays |= {f"{way}.{name}": value
                   for name, value in _seen_of(captures[way], found[way], plan.theta).items()}
    return {"theta": plan.theta.tolist(), "arrays": arrays,
            **{way: [one.theta[LINEAR].tolist() for one in readings]
               for way, readings in found.items()}}


def _seen_of(
    captures: list[SyntheticCapture], readings: list[Reading], theta: np.ndarray
) -> dict[str, np.ndarray]:
    """The fields of :class:`Maps` of the captures, and what :class:`StackedSet` needs of them."""
    count, orientation = len(captures), np.array([one.orientation for one in captures])
    found = [one.inferred.found for one in readings]
    distance, weight = compressed(found)
    maps = Maps(distance, weight, np.tile(theta, (count, 1)),
                orientation - [one.zero for one in found], np.zeros((count, 8)),
                np.full(count, 4), np.zeros(count, int), np.arange(count), np.zeros(count, bool))
    focal = CameraRig.load(RIG).intrinsics.fx
    return {**{field.name: getattr(maps, field.name) for field in fields(Maps)},
            "pictures": np.array([shrunk(one.views) for one in captures]),
            "focal": np.array([one.intrinsics.fx / focal - 1 for one in captures]),
            "orientation": orientation}


def run(config: dict[str, Any]) -> Report:
    """All fabrics, by the bundled network and by those of :data:`NETWORKS`."""
    fabrics = over_fabrics(case, config, sources=ESTIMATOR_SOURCES)
    learned = config["learned"] | {"workers": config["workers"]}
    trainings = {name: replace(one, steps=learned["steps"]) for name, (_, one) in NETWORKS.items()}
    results = train_all(trainings, learned)
    networks = {name: {"error": results[name]["unseen"]["fabrics"]["log_alpha"]["rmse"],
                       **{way: {} for way in ("starts", "orientations")}} for name in NETWORKS}
    for name, one in trainings.items():
        made = kept(one, results[name], learned)
        for fabric in fabrics:
            arrays = load_arrays(Path(config["cases"]), fabric)
            for way in ("starts", "orientations"):
                part = {key.partition(".")[2]: value for key, value in arrays.items()
                        if key.startswith(f"{way}.")}
                maps = Maps(*(part[field.name] for field in fields(Maps)))
                captures = (StackedSet(maps, part["pictures"], part["focal"], part["orientation"],
                                       scale=made.scale) if one.sees == "views"
                            else CaptureSet(maps, scale=made.scale, disc=False))
                estimates, _ = judged(made, captures, posterior=False)
                networks[name][way][fabric] = estimates[:, LINEAR].tolist()
    return {"fabrics": fabrics, "networks": networks}


def _variation(log_alpha: np.ndarray | list) -> np.ndarray:
    """(3,) coefficients of variation of alpha, %, of log alpha (N, 3)."""
    alpha = np.exp(log_alpha)
    return 100 * np.std(alpha, axis=0, ddof=1) / np.mean(alpha, axis=0)


def variations(report: Report) -> dict[str, np.ndarray]:
    """(F, 3) coefficients of variation of alpha, %, by what varies."""
    return {way: np.array([_variation(one[way]) for one in report["fabrics"].values()])
            for way in WAYS}


def _of_networks(report: Report) -> dict[str, dict[str, float]]:
    """Median coefficient of variation, %, of each small network, by what varies."""
    return {name: {way: float(np.median([_variation(values) for values in one[way].values()]))
                   for way in ("starts", "orientations")}
            for name, one in report["networks"].items()}


def answer(report: Report) -> str:
    """Summary in sentences."""
    found = {way: np.median(values) for way, values in variations(report).items()}
    small = _of_networks(report)
    return (f"The coefficient of variation of α (median over fabrics) is {found['starts']:.1f} % "
            f"over starts, {found['orientations']:.1f} % over orientations of one drape and "
            f"{found['set-ups']:.1f} % over set-ups. The mean over a fabric's starts still has an "
            f"error of {100 * _common(report):.0f} % (root mean square): most of the error is "
            "common to all drapes of a fabric. A small network trained on one start varies by "
            f"{small['one start']['starts']:.1f} % over starts, one trained on several by "
            f"{small['several starts']['starts']:.1f} %; trained on one orientation it varies by "
            f"{small['one orientation']['orientations']:.1f} % over orientations, on all by "
            f"{small['any orientation']['orientations']:.1f} %.")


def _common(report: Report) -> float:
    """Root mean square of what all starts of a fabric have in common of the error of log alpha."""
    return float(np.sqrt(np.mean([np.square(np.mean(one["starts"], axis=0) - one["theta"][:3])
                                  for one in report["fabrics"].values()])))


def rows(report: Report) -> tuple[list[str], list[list[object]]]:
    """Medians and largest values."""
    return (["what varies", *(f"{name}: median, largest, %" for name in WARP_WEFT)],
            [[WAYS[way], *(f"{np.median(v):.1f}, {v.max():.1f}" for v in values.T)]
             for way, values in variations(report).items()])


def small_networks(report: Report) -> str:
    """The second table."""
    return table(["small network sees, and learned from", "error of log α, unseen fabrics",
                  "variation over starts, %", "over orientations, %"],
                 [[NETWORKS[name][0], f"{report['networks'][name]['error']:.2f}",
                   f"{one['starts']:.1f}", f"{one['orientations']:.1f}"]
                  for name, one in _of_networks(report).items()])


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
        label_log_axes(axes.yaxis)
    figure.axes[0].set_ylabel("α estimated / true")
    figure.axes[0].legend(fontsize=8)
    return figure


STUDY = Study(
    "repeatability", "Repeatability", "002, Figures 22 and 23",
    "How much do estimates of one fabric vary with its folds, its orientation and the camera's "
    "position?",
    run, answer, rows, draw,
    "reports low coefficients of variation, five points higher for a network trained on one "
    "start, without a table; not comparable, because its fabrics are real and draped by hand.",
    "The fabrics have no friction, which adds to the variation of real cloth. The small networks "
    "were trained for minutes (`studies/learned.py`) and shrink towards the mean, so that they "
    "vary less than their error; their variation is that of the stiffer and the softer yarns.",
    more=small_networks)
