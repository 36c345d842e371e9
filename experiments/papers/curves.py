"""Torque spline compared with the parabola, both fitted to cantilever strips (004, section 5)."""

from collections.abc import Callable
from itertools import product
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from common.errors import InputError
from data.fabrics.fabrics import fabric_from_theta
from experiments.comparison import compare
from experiments.drapes import RIG, plan_specimen
from experiments.page import Section
from experiments.physics.testers import LENGTHS, add_noise
from experiments.result import Config, Report, Result, label_log_axes, rms, run_fabrics
from sim.cantilever.elastica import strip_shape, tabulated_law
from sim.cantilever.moduli import fit_torque_curve, match
from sim.cantilever.strip import bending_length
from sim.cloth import Laws
from sim.drape import drape, follow
from sim.energies.bending_variants import TorqueLaw
from sim.material import Fabric, torque
from sim.rig import GRAVITY

FITS = {"parabola": "parabola (α, β)", "spline": "spline"}
KINDS = {"parabola": "parabola", "yielding": "stiff at first, then yielding",
         "stiffening": "stiffening"}
"""Kinds of true torque: the law of the simulator; yarns that stick and slip, with a torque of
``_SLIP`` times alpha in addition to the linear part; cloth that jams at a curvature of ``_JAM``."""
_SLIP, _STICK, _JAM = 30.0, 15.0, 100.0  # 1/m; 30 is HB/B of denims (docs/physics.md)
_LONG_STRIP = 3.5  # bending lengths, of the strip whose shape is predicted
_STRIP_POINTS = 81  # of a strip's curve
_CURVATURES = np.linspace(0, 600, 1201)  # 1/m, at which laws are tabulated

Torque = Callable[[np.ndarray], np.ndarray]


def true_torque(kind: str, alpha: float, ratio: float) -> Torque:
    """Torque, N, as a function of curvature, 1/m, for approximate alpha, N·m, and beta/alpha, m."""
    if kind == "yielding":
        return lambda k: alpha * (0.6 * k + 0.6 * _SLIP * np.tanh(k / _STICK))
    if kind == "stiffening":
        return lambda k: alpha * (k + k**3 / _JAM**2)
    return lambda k: torque(k, alpha, ratio * alpha)


def fit_torque(
    name: str, strips: list[np.ndarray], *, weight: float, knots: int
) -> tuple[Torque, float] | None:
    """Fit torque over curvature; return it and the largest curvature, 1/m, or None if it fails."""
    try:
        if name == "parabola":
            found = match(strips, weight=weight)
            return lambda k: torque(k, found.alpha, found.beta), found.curvature
        curve = fit_torque_curve(strips, weight=weight, knots=knots)
        return TorqueLaw(curve.curvature, curve.torque).spline, curve.reached
    except InputError:
        return None


def case(
    *, number: int, edge_mm: float, noise_mm: list[float], knots: int, seed: int
) -> dict[str, Any]:
    """Errors of both fits of one fabric, by kind of torque and noise; None where a fit failed."""
    plan = plan_specimen(number, seed=seed)
    plate = fabric_from_theta(plan.theta)
    alpha, ratio = float(np.exp(plan.theta[:3].mean())), float(plan.theta[3:].mean())
    weight, unit = plate.density * GRAVITY, bending_length(alpha, plate.density)
    fabric, result = Fabric(np.full(3, alpha)), {}

    def law(one: Torque) -> TorqueLaw:
        return TorqueLaw(_CURVATURES, one(_CURVATURES))

    def strip(one: Torque, lengths: float) -> np.ndarray:
        return strip_shape(tabulated_law(_CURVATURES, one(_CURVATURES)), weight=weight,
                           length=lengths * unit, points=_STRIP_POINTS)

    for kind in KINDS:
        true = true_torque(kind, alpha, ratio)
        clean = {"strips": [strip(true, x) for x in LENGTHS]}
        shape = drape(fabric, rig=RIG, edge=1e-3 * edge_mm, start=plan.fallback,
                      seed=plan.seed, laws=Laws(bending=law(true)))
        result[kind] = {}
        for noise in noise_mm:
            rng = np.random.default_rng([seed, number])
            strips = add_noise(clean, 1e-3 * noise, rng)["strips"]
            for name in FITS:
                fit = fit_torque(name, strips, weight=weight, knots=knots)
                result[kind][f"{name}, {noise:g} mm"] = None
                if fit is None:
                    continue
                found, reached = fit
                bent = np.linspace(0, reached, 26)[1:]
                other = follow(shape, fabric, laws=Laws(bending=law(found)))
                apart = compare(shape, other).row if shape.converged and other.converged else None
                gap = np.linalg.norm(strip(found, _LONG_STRIP) - strip(true, _LONG_STRIP), axis=1)
                result[kind][f"{name}, {noise:g} mm"] = {
                    "curvature": bent.tolist(), "ratio": (found(bent) / true(bent)).tolist(),
                    "torque": _relative_error(found(bent), true(bent)),
                    "strip_mm": 1e3 * rms(gap),
                    "drape": apart}
    return result


def _relative_error(values: np.ndarray, true: np.ndarray) -> float:
    """Root mean square of the error, relative to that of the truth, %."""
    return 100 * rms(values - true) / rms(true)


def run(config: Config) -> Result:
    """Run all fabrics."""
    return Result({"fabrics": run_fabrics(case, config, sources=("sim", "drapenet"))})


def _medians(report: Report) -> dict[tuple[str, str, float], dict[str, Any]]:
    """Medians of errors over fabrics by kind of torque, fit and noise in mm."""
    found = {}
    for kind, name, noise in product(KINDS, FITS, report["settings"]["noise_mm"]):
        every = [fit for one in report["fabrics"].values()
                 if (fit := one[kind][f"{name}, {noise:g} mm"])]
        drapes = np.array([one["drape"] for one in every if one["drape"]]).reshape(-1, 2)
        found[kind, name, noise] = {
            "torque": float(np.median([one["torque"] for one in every])),
            "strip": float(np.median([one["strip_mm"] for one in every])),
            "drape": np.median(drapes, axis=0)}
    return found


def summarise(report: Report) -> str:
    """Summary in sentences."""
    found, noises = _medians(report), report["settings"]["noise_mm"]

    def better(noise: float) -> int:
        return sum(found[kind, "spline", noise]["drape"][0]
                   < found[kind, "parabola", noise]["drape"][0] for kind in KINDS)

    parts = [f"with {noise:g} mm of noise in {better(noise)}" if noise
             else f"without noise in {better(noise)}" for noise in noises]
    worst = max(KINDS, key=lambda kind: found[kind, "parabola", noises[-1]]["drape"][0])
    one, two = (found[worst, name, noises[-1]]["drape"][0] for name in FITS)
    return (f"Of {len(KINDS)} kinds of torque, the spline gives drapes closer to the true fabric's "
            f"{', '.join(parts)}. The parabola is worst for the {KINDS[worst]} torque: its drapes "
            f"lie {one:.2f} mm (median) from the true fabric's, the spline's {two:.2f} mm "
            f"({noises[-1]:g} mm of noise).")


def rows(report: Report) -> tuple[list[str], list[list[object]]]:
    """Table of errors by kind of torque, fit and noise."""
    return (["true torque", "fitted", "noise, mm", "torque, %", "longer strip, mm", "drape, mm",
             "curvature, %"],
            [[KINDS[kind], FITS[name], f"{noise:g}", f"{one['torque']:.1f}", f"{one['strip']:.2f}",
              *(f"{x:.2f}" if k == 0 else f"{x:.1f}" for k, x in enumerate(one["drape"]))]
             for (kind, name, noise), one in _medians(report).items()])


def draw(report: Report) -> Figure:
    """Plot fitted / true torque at the largest noise, one line per fabric, and displacements."""
    figure = Figure(figsize=(11, 3.4), layout="constrained")
    panels = figure.subplots(1, len(KINDS) + 1, width_ratios=[1] * len(KINDS) + [1.3])
    colours = dict(zip(FITS, ("#b5403a", "#2f6da8"), strict=True))
    noises = report["settings"]["noise_mm"]
    for axes, kind in zip(panels, KINDS, strict=False):
        for k, one in enumerate(report["fabrics"].values()):
            for name, colour in colours.items():
                if curve := one[kind][f"{name}, {noises[-1]:g} mm"]:
                    axes.plot(curve["curvature"], curve["ratio"], color=colour, lw=1, alpha=0.7,
                              label=FITS[name] if k == 0 else None)
        axes.axhline(1.0, color="0.6", lw=0.8)
        axes.set(ylim=(0.5, 1.7), xlabel="curvature [1/m]")
        axes.set_title(KINDS[kind].replace(", ", ",\n"), fontsize=9)
    panels[0].set_ylabel(f"fitted / true torque, noise {noises[-1]:g} mm")
    panels[0].legend(fontsize=8, frameon=False)
    axes = panels[-1]
    for place, kind in enumerate(KINDS):
        for k, (name, noise) in enumerate(product(FITS, noises)):
            values = [drapes[0] for one in report["fabrics"].values()
                      if (fit := one[kind][f"{name}, {noise:g} mm"])
                      and (drapes := fit["drape"])]
            axes.plot(np.full(len(values), place + 0.18 * (k - 1.5)), values,
                      "o" if noise else "x", ms=3.5, color=colours[name],
                      label=f"{FITS[name]}, {noise:g} mm" if place == 0 else None)
    axes.set(yscale="log", ylabel="drape's displacement [mm]", xlim=(-0.5, len(KINDS) - 0.5))
    axes.set_ylim(bottom=1e-3)  # omits those of the exact law
    axes.set_xticks(range(len(KINDS)), KINDS)
    axes.legend(fontsize=7, loc="lower right")
    label_log_axes(axes.yaxis)
    return figure


SECTION = Section(
    "Torque spline and parabola", "004, section 5",
    "Is the parabola of α and β sufficient, or are drapes more accurate with a spline of torque "
    "over curvature fitted to the same noisy strips?",
    summarise, rows, draw,
    "fits splines of up to five points to every component, with residuals of 21 and 22 mm (root "
    "mean square) for bent strips of a knit in warp and weft; not comparable, because its strips "
    "are real, 100 mm long, pushed over the edge of a table, with hysteresis.",
    "Fabrics are isotropic, because the spline has no anisotropic law. Strips bend cylindrically "
    "and have lengths of 1.5 and 2.5 bending lengths; the predicted *longer strip* has 3.5. Drapes "
    "are the equilibria nearest to the true drape, so that folds are the same. Torques are "
    "compared up to the largest curvature in the strips.")
