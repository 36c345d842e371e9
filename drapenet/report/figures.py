"""Pictures of an estimate: ``report.png``, and ``torque.svg`` with the bending laws alone."""

import io
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LightSource
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.projections.polar import PolarAxes
from matplotlib.ticker import MaxNLocator
from PIL import Image, ImageOps

from common.types import DepthImage, Views
from data.captures.capture import Capture, DepthCapture, OutlineCapture
from data.captures.photograph import PhotographedOutline
from data.captures.preview import png
from data.render.cameras import nominal_camera
from data.render.raster import rasterise
from drapenet.measured.base import Quantity
from drapenet.report.drape import PROFILE_HEIGHT, Resimulation
from drapenet.result.document import EstimateDocument
from drapenet.result.estimate import Estimate

MAX_CURVATURE = 400.0  # 1/m, about the sharpest folds of a drape
COLOURS = ("#b5403a", "#6b6b6b", "#2f6da8")  # of the three directions of a fabric
DASHES = ("-", (0, (6, 1.5)), (0, (2, 1.5)))  # of their curves, which are also printed in grey
CAPTURED, SIMULATED, PLATE = "#8a8a8a", "#d9762b", "#f2b400"
_WIDE, _HIGH, _CURVES_HIGH, _DPI = 10.4, 6.4, 3.8, 125  # inches, and pixels of an inch
_SHAPE = 3  # size of the picture of a shape over that of a view


def draw_report(
    estimate: Estimate, document: EstimateDocument, capture: Capture,
    resimulation: Resimulation | None, *, title: str,
) -> bytes:
    """The report as a PNG file: the capture, and below it the curves; ``resimulation`` is None if
    no simulated drape converged."""
    seen = Figure(figsize=(_WIDE, _HIGH), layout="constrained")
    if isinstance(capture, OutlineCapture):
        _photograph(seen.subplots(), capture.outline, resimulation)
    elif isinstance(capture, DepthCapture):
        _views(seen, capture.views, resimulation)
    seen.suptitle(title, fontsize=14, parse_math=False)
    curves = Figure(figsize=(_WIDE, _CURVES_HIGH),
                    layout=ConstrainedLayoutEngine(w_pad=0.1, h_pad=0.12))
    grid = curves.add_gridspec(1, 3, width_ratios=(1.4, 1.1, 1.3))
    _torques(curves.add_subplot(grid[0]), estimate)
    above: Any = curves.add_subplot(grid[1], projection="polar")
    _from_above(above, capture, resimulation)
    _shape(curves.add_subplot(grid[2]), resimulation)
    about, count = document.capture, len(document.warnings)
    parts = [f"{about.density_g_m2:g} g/m²",
             *[f"drape coefficient {value:.1f} %"
               for value in [about.drape_coefficient_percent] if value is not None],
             *[f"{value} nodes" for value in [about.nodes] if value is not None],
             *[f"{count} warning{'s' * (count > 1)}"] * bool(count)]
    curves.supxlabel(", ".join(parts), fontsize=11)
    return _png(np.vstack([_pixels(seen), _pixels(curves)]))


def capture_and_curves(report: bytes) -> tuple[bytes, bytes]:
    """The two parts of a picture of :func:`draw_report`, PNG."""
    pixels = np.asarray(Image.open(io.BytesIO(report)).convert("RGB"))
    height = len(pixels) - round(_CURVES_HIGH * _DPI)
    return _png(pixels[:height]), _png(pixels[height:])


def side_by_side(capture: bytes, curves: bytes) -> bytes:
    """Both parts beside each other, PNG, equally high and without the margins of the first."""
    left, right = (Image.open(io.BytesIO(part)).convert("RGB") for part in (capture, curves))
    left = left.crop(ImageOps.invert(left).getbbox())
    width = round(left.width * right.height / left.height)
    return _png(np.hstack([np.asarray(left.resize((width, right.height))), np.asarray(right)]))


def _pixels(figure: Figure) -> np.ndarray:
    """A figure drawn, (H, W, 3) uint8."""
    figure.set_dpi(_DPI)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3]


def _png(pixels: np.ndarray) -> bytes:
    """PNG of pixels (H, W, 3)."""
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, format="PNG")
    return stream.getvalue()


def _views(figure: Figure, views: Views, resimulation: Resimulation | None) -> None:
    """Captured views above simulated ones and their silhouettes."""
    simulated = np.zeros_like(views) if resimulation is None else resimulation.views
    window = _window(np.concatenate([views, simulated]))
    limits = tuple(np.quantile(views[views > 0], (0.01, 0.99)) * 1e3)
    rows = ["captured", "simulated", "grey: captured\nline: simulated"]
    pictures = figure.subplots(len(rows), len(views), squeeze=False)
    for axes in pictures.flat:
        axes.set(xticks=[], yticks=[])
        axes.spines[:].set_visible(False)
    for axes, label in zip(pictures[:, 0], rows, strict=True):
        axes.set_ylabel(label)
    for k in range(len(views)):
        captured, drape = views[window][k], simulated[window][k]
        pictures[0, k].set_title(f"view {k}")
        image = _depth(pictures[0, k], captured, limits)
        _depth(pictures[1, k], drape, limits)
        _silhouettes(pictures[2, k], captured, drape)
    figure.colorbar(image, ax=pictures, label="depth [mm]", shrink=0.5, aspect=30)


def _photograph(
    axes: Axes, outline: PhotographedOutline, resimulation: Resimulation | None
) -> None:
    """The photograph, if there is one, with the outline and that of the simulated drape."""
    if outline.picture is not None:
        axes.imshow(outline.picture)
    axes.set(aspect="equal", xticks=[], yticks=[])
    closed = np.vstack([outline.curve, outline.curve[:1]])
    axes.plot(*outline.drawn(closed).T, color=CAPTURED, lw=2, label="photographed")
    if resimulation is not None:
        radius = resimulation.profiles[1]
        angle = (np.arange(len(radius) + 1) + 0.5) * (2 * np.pi / len(radius))
        curve = np.append(radius, radius[0])[:, None] * np.column_stack(
            [np.cos(angle), np.sin(angle)])
        axes.plot(*outline.drawn(curve).T, color=SIMULATED, lw=1.5, ls=DASHES[1],
                  label="simulated with the estimate")
    angle = np.linspace(0, 2 * np.pi, 90)
    rim = outline.rig.plate_radius * np.column_stack([np.cos(angle), np.sin(angle)])
    axes.plot(*outline.drawn(rim).T, color=PLATE, lw=1, ls=DASHES[2], label="plate")
    axes.legend(frameon=False, loc="upper center", bbox_to_anchor=(0.5, 0), ncols=3)


def draw_torques(estimate: Estimate) -> bytes:
    """Torque over curvature of the three directions as SVG, with text elements."""
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": "drapenet"}):
        figure = Figure(figsize=(6.5, 4), layout="constrained")
        _torques(figure.subplots(), estimate)
        picture = io.BytesIO()
        figure.savefig(picture, format="svg", transparent=True,
                       metadata={"Date": None, "Creator": None})
    return picture.getvalue()


def draw_spread(
    joint: EstimateDocument, names: Sequence[str], captures: Sequence[Sequence[Quantity]]
) -> bytes:
    """PNG: alpha of every capture, by its name, in the three directions, with its 68 % interval,
    and the fabric's as a band."""
    figure = Figure(figsize=(9, 2.2 + 0.22 * len(captures)), layout="constrained")
    panels = figure.subplots(1, 3, sharey=True)
    for k, (axes, name, colour) in enumerate(zip(panels, joint.names, COLOURS, strict=True)):
        band = joint.moduli[name].alpha_uN_m
        axes.axvspan(*band.interval_68, color=colour, alpha=0.2, lw=0)
        axes.axvline(band.median, color=colour, lw=1)
        for row, alphas in enumerate(captures):
            alpha = alphas[k]
            axes.plot(alpha.interval_68, [row, row], color=colour, lw=1.5)
            axes.plot(alpha.median, row, "o", color=colour, ms=4)
        axes.set(title=f"alpha {name} [µN·m]", ylim=(len(captures) - 0.4, -0.6))
        axes.set_yticks(range(len(captures)), names, fontsize=8, parse_math=False)
    return png(figure)


def _window(views: Views) -> tuple[slice, slice, slice]:
    """Slices of view, row and column that contain the cloth, with a small margin."""
    cloth = np.any(views > 0, axis=0)
    rows, columns = (np.flatnonzero(np.any(cloth, axis=axis)) for axis in (1, 0))
    down, across = (slice(max(places[0] - 6, 0), places[-1] + 7) for places in (rows, columns))
    return slice(None), down, across


def _depth(axes: Axes, view: DepthImage, limits: tuple[float, float]) -> AxesImage:
    """Draw a depth image; ``limits`` of the colours in mm."""
    millimetres = np.where(view > 0, view * 1e3, np.nan)
    return axes.imshow(millimetres, cmap="viridis_r", vmin=limits[0], vmax=limits[1])


def _silhouettes(axes: Axes, captured: DepthImage, simulated: DepthImage) -> None:
    picture = np.ones((*captured.shape, 3))
    picture[captured > 0] = 0.78
    axes.imshow(picture)
    if simulated.any():
        axes.contour(simulated > 0, levels=[0.5], colors=[SIMULATED], linewidths=1.2)


def _torques(axes: Axes, estimate: Estimate) -> None:
    curvature = np.linspace(0, MAX_CURVATURE, 100)
    for k, (name, colour, dashes) in enumerate(zip(estimate.names, COLOURS, DASHES, strict=True)):
        curves = estimate.torques(k, curvature) * 1e3
        axes.plot(curvature, np.median(curves, axis=0), color=colour, lw=2, ls=dashes, label=name)
        axes.fill_between(curvature, *np.quantile(curves, [0.16, 0.84], axis=0), color=colour,
                          alpha=0.15, lw=0)
    axes.set(xlabel="curvature [1/m]", ylabel="torque per width [mN]", xlim=(0, MAX_CURVATURE),
             ylim=(0, None))
    axes.set_title("torque of a bent strip; shaded: 68 % interval", fontsize=10)
    axes.legend(frameon=False, loc="upper left")


def _from_above(axes: PolarAxes, capture: Capture, resimulation: Resimulation | None) -> None:
    """Draw radius profiles and the first yarns; angles as in the first view, 0 to the right."""
    seen = isinstance(capture, OutlineCapture)
    depth = "" if seen else f" {-PROFILE_HEIGHT * 1e3:.0f} mm below the plate"
    axes.set_title(f"from above: radius{depth} [mm]", fontsize=10)
    axes.tick_params(labelsize=7)
    largest = 80.0
    if resimulation is not None:
        azimuth = np.linspace(0, 2 * np.pi, len(resimulation.profiles[0]) + 1)
        for profile, name, colour, dashes in zip(
                resimulation.profiles, ("captured", "simulated"), (CAPTURED, SIMULATED), DASHES,
                strict=False):
            axes.plot(azimuth, np.append(profile, profile[0]) * 1e3, color=colour, ls=dashes,
                      label=name)
        largest = 1.05e3 * np.nanmax(np.concatenate(resimulation.profiles), initial=largest / 1e3)
    warp = capture.warp_direction
    if warp is not None:
        axes.plot([warp, warp + math.pi], [largest] * 2, color=COLOURS[0], lw=2.5, label="warp")
        axes.set_rlabel_position(math.degrees(warp) + 90)
    axes.set_ylim(0, largest)
    axes.yaxis.set_major_locator(MaxNLocator(4))
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.08), frameon=False, fontsize=7.5,
                ncols=3, handlelength=1, columnspacing=1)


def _shape(axes: Axes, resimulation: Resimulation | None) -> None:
    """The simulated drape from the side, lit from the upper left."""
    axes.axis("off")
    axes.set_title("simulated with the estimate" if resimulation else
                   "no simulated drape converged", fontsize=10)
    if resimulation is None:
        return
    drape, camera = resimulation.drape, nominal_camera(resimulation.drape.rig)
    camera = camera.resized(_SHAPE * camera.width, _SHAPE * camera.height)
    depth = rasterise(resimulation.positions, drape.faces, camera, np.zeros(1))[0]
    shown = depth[_window(depth[None])[1:]]
    pixel = float(np.median(shown[shown > 0])) / camera.fx
    light = LightSource(azdeg=315, altdeg=50).hillshade(
        np.where(shown > 0, -shown, np.nan), dx=pixel, dy=pixel)
    axes.imshow(light, cmap="copper", vmin=-0.2, vmax=1.1)
