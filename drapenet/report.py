"""``report.png``: the capture, the estimated laws, and the drape that they give."""

import io
import math

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from drapenet.estimate import Estimate
from drapenet.resimulate import Resimulation
from sim.material import MICRO, NANO, torque

LARGEST_CURVATURE = 400.0  # 1/m, about the sharpest folds of a drape
COLOURS = ("#b5403a", "#6b6b6b", "#2f6da8")  # stiff, bias, soft


def draw_report(
    estimate: Estimate,
    views: np.ndarray,
    resimulation: Resimulation | None,
    *,
    title: str,
    typical_error: dict[str, dict[str, float]],
) -> bytes:
    """The report as a PNG file.

    Args:
        views: (4, H, W) captured z-depth, m.
        resimulation: None if the estimate could not be draped.
        typical_error: as in ``estimate.json``, for the bands of the curves.
    """
    matplotlib.use("Agg")
    figure = Figure(figsize=(13, 12.5), layout="constrained")
    grid = figure.add_gridspec(4, 4, height_ratios=(1, 1, 1, 1.5))
    limits = tuple(np.quantile(views[views > 0], (0.01, 0.99)))
    drapes = [views] if resimulation is None else [views, resimulation.views]
    window = _window(np.concatenate(drapes))
    views = views[window]
    for k in range(4):
        _depth(figure.add_subplot(grid[0, k]), views[k], limits, f"captured, view {k}")
        simulated, silhouette = (figure.add_subplot(grid[row, k]) for row in (1, 2))
        if resimulation is None:
            for axes in (simulated, silhouette):
                axes.axis("off")
            continue
        drape = resimulation.views[window][k]
        _depth(simulated, drape, limits, f"simulated with the estimate, view {k}")
        _silhouettes(silhouette, views[k], drape)
    _stiff_axis(figure.axes[0], estimate)
    _torques(figure.add_subplot(grid[3, :2]), estimate, typical_error)
    _profiles(figure.add_subplot(grid[3, 2], projection="polar"), resimulation)
    _figures(figure.add_subplot(grid[3, 3]), estimate, resimulation)
    figure.suptitle(title, fontsize=13)
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=100)
    return picture.getvalue()


def _window(views: np.ndarray) -> tuple[slice, slice, slice]:
    """Slices of all pictures that hold the cloth of views (N, H, W), with a small margin."""
    cloth = (views > 0).any(axis=0)
    slices = [slice(None)]
    for axis in (1, 0):
        places = np.flatnonzero(cloth.any(axis=axis))
        slices.append(slice(max(places[0] - 6, 0), places[-1] + 7))
    return tuple(slices)


def _depth(axes: Axes, view: np.ndarray, limits: tuple[float, float], title: str) -> None:
    axes.imshow(np.where(view > 0, view, np.nan), cmap="viridis_r", vmin=limits[0], vmax=limits[1])
    axes.set_title(title, fontsize=9)
    axes.axis("off")


def _silhouettes(axes: Axes, captured: np.ndarray, simulated: np.ndarray) -> None:
    picture = np.ones((*captured.shape, 3))
    picture[captured > 0] = 0.78
    axes.imshow(picture)
    axes.contour(simulated > 0, levels=[0.5], colors=["#d9762b"], linewidths=1.2)
    axes.set_title("captured (grey), simulated (line)", fontsize=9)
    axes.axis("off")


def _stiff_axis(axes: Axes, estimate: Estimate) -> None:
    """A needle in the first view's corner: the stiff axis, seen from above."""
    angle, confidence = estimate.prediction.axis, estimate.prediction.axis_confidence
    inset = axes.inset_axes((0.0, 0.72, 0.21, 0.28))
    x, y = math.cos(angle), math.sin(angle)
    inset.plot([-x, x], [-y, y], color=COLOURS[0], lw=2.5, alpha=0.15 + 0.85 * confidence)
    inset.set(xlim=(-1.3, 1.3), ylim=(-1.3, 1.3), aspect="equal", xticks=[], yticks=[])
    inset.set_title(f"{estimate.names[0]}, from above", fontsize=6, pad=2)


def _torques(
    axes: Axes, estimate: Estimate, typical_error: dict[str, dict[str, float]]
) -> None:
    curvature = np.linspace(0, LARGEST_CURVATURE, 400)
    fabric = estimate.fabric
    for name, alpha, beta, colour in zip(
        estimate.names, fabric.alpha, fabric.beta, COLOURS, strict=True
    ):
        error = typical_error[name]["alpha_percent"] / 100
        curve = torque(curvature, alpha, beta) * 1e3
        axes.plot(curvature, curve, color=colour, lw=2, label=name)
        axes.fill_between(curvature, curve / (1 + error), curve * (1 + error), color=colour,
                          alpha=0.12, lw=0)
        if beta < 0 and -alpha / (2 * beta) < LARGEST_CURVATURE:
            peak = -alpha / (2 * beta)
            parabola = (alpha * curvature + beta * curvature**2) * 1e3
            shown = (curvature > 0.8 * peak) & (parabola > 0)
            axes.plot(curvature[shown], parabola[shown], color=colour, lw=1, ls=":")
    axes.set(xlabel="curvature [1/m]", ylabel="torque per width [mN]", xlim=(0, LARGEST_CURVATURE),
             ylim=(0, None))
    axes.set_title("torque: full law (solid), parabola past it (dotted), typical error of alpha "
                   "(band)", fontsize=9)
    axes.legend(frameon=False)


def _profiles(axes: Axes, resimulation: Resimulation | None) -> None:
    axes.set_title("radius 40 mm below the plate [mm]", fontsize=9)
    axes.tick_params(labelsize=7)
    if resimulation is None:
        return
    azimuth = np.linspace(0, 2 * np.pi, len(resimulation.profiles[0]) + 1)
    for profile, folds, name, colour in zip(
        resimulation.profiles, resimulation.folds, ("captured", "simulated"),
        ("#7a7a7a", "#d9762b"), strict=True,
    ):
        closed = np.append(profile, profile[0]) * 1e3
        axes.plot(azimuth, closed, color=colour, label=f"{name}: {folds} folds")
    axes.set_ylim(0, None)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, -0.25), frameon=False, fontsize=8)


def _figures(axes: Axes, estimate: Estimate, resimulation: Resimulation | None) -> None:
    fabric = estimate.fabric
    lines = [f"at {fabric.density * 1e3:g} g/m² ({estimate.convention})", "",
             f"{'':6}{'alpha':>8}{'beta':>9}", f"{'':6}{'µN·m':>8}{'nN·m²':>9}"]
    lines += [f"{name:6}{alpha / MICRO:8.2f}{beta / NANO:9.1f}" for name, alpha, beta in
              zip(estimate.names, fabric.alpha, fabric.beta, strict=True)]
    lines.append("")
    if resimulation is None:
        lines.append("no simulated drape converged")
    else:
        captured, simulated = resimulation.folds
        lines += [f"folds: {captured} captured,", f"       {simulated} simulated",
                  f"silhouettes overlap {resimulation.overlap:.0%}"]
    if estimate.warnings:
        lines += ["", f"{len(estimate.warnings)} warnings, see estimate.json"]
    axes.text(0, 0.95, "\n".join(lines), family="monospace", fontsize=10, va="top",
              transform=axes.transAxes)
    axes.axis("off")
