"""Effect of faults of the set-up on estimates, and their detection (002, section 7.3.2)."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy import ndimage

from common.errors import InputError
from data.fabrics.nuisances import Nuisances
from data.render.setups import SyntheticCapture
from experiments.drapes import (
    capture_drape,
    drape_specimen,
    ideal_setups,
    infer,
    plan_specimen,
    spread,
)
from experiments.report import Report, rms, table
from experiments.study import CaseKeys, Sample, Study, samples_of
from sim.material import LINEAR

Rng = np.random.Generator
Fault = Callable[[SyntheticCapture, float, Rng], SyntheticCapture]


def _scale_focal_length(found: SyntheticCapture, percent: float, rng: Rng) -> SyntheticCapture:
    scale = 1 + percent / 100
    return replace(found, intrinsics=replace(found.intrinsics, fx=found.intrinsics.fx * scale,
                                             fy=found.intrinsics.fy * scale))


def _quantise(found: SyntheticCapture, mm: float, rng: Rng) -> SyntheticCapture:
    return replace(found, views=(np.rint(found.views / (1e-3 * mm)) * 1e-3 * mm).astype(np.float32))


def _erode_mask(found: SyntheticCapture, pixels: float, rng: Rng) -> SyntheticCapture:
    views = found.views.copy()
    for view in views:
        view[(view > 0) & ~ndimage.binary_erosion(view > 0, iterations=int(pixels))] = 0.0
    return replace(found, views=views)


def _add_holes(found: SyntheticCapture, percent: float, rng: Rng) -> SyntheticCapture:
    lost = rng.random(found.views.shape) < percent / 100
    return replace(found, views=np.where(lost, np.float32(0.0), found.views))


SENSORS = ("smooth", "paper", "tof")
SETUP_FAULTS: dict[str, tuple[str, tuple[float, ...], Callable[[float], dict[str, Any]]]] = {
    "pitch": ("°", (20, 25, 50, 55, 60), lambda v: {"pitch": (np.radians(v),) * 2}),
    "distance": ("m", (0.35, 0.4, 0.7, 0.8, 1.0), lambda v: {"distance": (v, v)}),
    "turn": ("° (deviation)", (1, 2.5, 5, 10), lambda v: {"turn": np.radians(v)}),
    "sensor": ("", (1, 2, 3), lambda v: {"sensors": {SENSORS[int(v) - 1]: 1.0}}),
}
"""Faults of set-ups by name: unit, values, and changes of the set-up for a value."""
CAPTURE_FAULTS: dict[str, tuple[str, tuple[float, ...], Fault]] = {
    "focal length": ("%", (-10, -5, -2, 2, 5, 10), _scale_focal_length),
    "depth steps": ("mm", (1, 2, 4, 8), _quantise),
    "mask too small": ("pixels", (1, 2, 4, 6), _erode_mask),
    "holes": ("% of pixels", (5, 20, 50), _add_holes),
}
"""Faults added to a finished capture, by name: unit, values and function."""
SPECIMEN_FAULTS: dict[str, tuple[str, tuple[float, ...], Callable[[float], dict[str, Any]]]] = {
    "off-centre": ("mm", (2, 5, 10, 20), lambda v: {"offset": (1e-3 * v, 0.0)}),
    "specimen too large": ("mm", (-5, -2, 2, 5), lambda v: {"nuisances": Nuisances(size=1e-3 * v)}),
}
"""Faults of the specimen by name: unit, values, and changes of the drape for a value."""
UNITS = {name: unit for name, (unit, _, _) in
         (SETUP_FAULTS | CAPTURE_FAULTS | SPECIMEN_FAULTS).items()}


class Keys(CaseKeys):
    fabrics: int = 24  # drawn from the prior
    edge_mm: float = 3.0  # mesh edge length at the rim
    seed: int = 505
    workers: int = 2


def fabric(*, number: int, edge_mm: float, seed: int) -> Sample:
    """Errors of log alpha and number of warnings for one fabric, by fault and value."""
    plan, edge = plan_specimen(number, seed=seed), 1e-3 * edge_mm
    shape = drape_specimen(plan, edge=edge)
    truth = plan.theta[LINEAR]

    def evaluate(found: SyntheticCapture) -> list[Any]:
        try:
            result = infer(found)
        except InputError:
            return [None, None]
        mean = result.estimate.samples[:, LINEAR].mean(axis=0)
        warnings = [*result.estimate.warnings, *result.warnings]
        return [((mean - truth) / spread()[LINEAR]).tolist(), len(warnings)]

    def captured(drape: Any, **changes: Any) -> SyntheticCapture:  # same noise and orientation
        return capture_drape(drape, ideal_setups(**changes), np.random.default_rng([seed, number]))

    plain = captured(shape)
    result: dict[str, Any] = {"none": {"0": evaluate(plain)}}
    for name, (_, values, entries) in SETUP_FAULTS.items():
        result[name] = {str(v): evaluate(captured(shape, **entries(v))) for v in values}
    rng = np.random.default_rng([seed, number, 1])
    for name, (_, values, change) in CAPTURE_FAULTS.items():
        result[name] = {str(v): evaluate(change(plain, v, rng)) for v in values}
    for name, (_, values, changes) in SPECIMEN_FAULTS.items():
        drapes = {v: drape_specimen(plan, edge=edge, **changes(v)) for v in values}
        result[name] = {str(v): evaluate(captured(drape)) for v, drape in drapes.items()}
    return result


def run(keys: Keys) -> Report:
    """Run all fabrics."""
    found = samples_of(fabric, keys, keys.fabrics, kind="fabric")
    return {"faults": {name: {
        value: _summary([one[name][value] for one in found.values()]) for value in values}
        for name, values in next(iter(found.values())).items()}}


def _summary(cases: list[list[Any]]) -> dict[str, float | None]:
    """Error and bias of the captures that are read, and the shares that are refused, or that are
    refused or have a warning."""
    errors = np.array([error for error, _ in cases if error])
    return {"error": rms(errors) if len(errors) else None,
            "bias": float(errors.mean()) if len(errors) else None,
            "refused": 1 - len(errors) / len(cases),
            "doubted": float(np.mean([warnings != 0 for _, warnings in cases]))}


def _shown(name: str, value: str, *, unit: bool = True) -> str:
    """A value of a fault with or without its unit."""
    if name == "sensor":
        return SENSORS[int(value) - 1]
    return f"{value} {UNITS.get(name, '')}".strip() if unit else value


def block(report: Report) -> str:
    """Summary and table."""
    plain = report["faults"]["none"]["0"]["error"]
    doubted = {f"{name} {_shown(name, value)}": one["doubted"]
               for name, values in report["faults"].items() for value, one in values.items()
               if one["error"] and one["error"] > 1.5 * plain}
    missed = [name for name, share in doubted.items() if share < 0.5]
    noted = (f"the checks report fewer than half of the captures with {', '.join(missed)}"
             if missed else "the checks report each of them in at least half of the captures")
    text = (f"Without faults the error of log α is {plain:.2f}. Faults that raise it by more than "
            f"half: {', '.join(doubted) or 'none'}; {noted}. An error of the density changes all "
            "moduli in proportion.")
    head = ["fault", "values", "error of log α", "bias", "refused, %",
            "refused, or with a warning, %"]
    rows = [[f"{name}, {UNITS.get(name, '')}".strip(", "),
             ", ".join(_shown(name, value, unit=False) for value in values),
             *(", ".join(f"{scale * one[key]:{form}}" if one["error"] else "–"
                         for one in values.values())
               for key, scale, form in (("error", 1, ".3f"), ("bias", 1, "+.3f"),
                                        ("refused", 100, ".0f"), ("doubted", 100, ".0f")))]
            for name, values in report["faults"].items()]
    return f"{text}\n\n{table(head, rows)}"


def draw(report: Report) -> Figure:
    """Plot errors over values of faults; red: more than half of the captures have a warning."""
    faults = {name: values for name, values in report["faults"].items() if name != "none"}
    plain = report["faults"]["none"]["0"]["error"]
    figure = Figure(figsize=(11, 5), layout="constrained")
    panels = figure.subplots(2, -(-len(faults) // 2), sharey=True).ravel()
    for axes, (name, values) in zip(panels, faults.items(), strict=False):
        x = [float(value) for value in values]
        y = [one["error"] if one["error"] else np.nan for one in values.values()]
        axes.axhline(plain, color="0.7", lw=1)
        axes.plot(x, y, "-", color="#2f6da8")
        for place, value, one in zip(x, y, values.values(), strict=True):
            axes.plot(place, value, "o", color="#2f6da8",
                      mfc="#b5403a" if one["doubted"] > 0.5 else "white")
        axes.set(title=name, xlabel=UNITS[name])
        if name == "sensor":
            axes.set_xticks(x, SENSORS)
    for axes in panels[len(faults):]:
        axes.axis("off")
    panels[0].set_ylim(0, None)
    figure.supylabel("error of log α [spread over fabrics]", fontsize=10)
    figure.suptitle("red: more than half of the captures get a warning", fontsize=9)
    return figure


STUDY = Study(Keys, run, block, draw)
