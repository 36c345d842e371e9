"""Pictures of a dataset: contact sheet of drapes, and histograms."""

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from data.dataset.inspect.figures import (
    PARAMETERS,
    UNITS,
    Drapes,
    draped_fabrics,
    in_display_units,
    spread,
)
from data.dataset.shards import Shard
from data.render.cameras import nominal_camera
from data.render.rays import DepthRenderer

ACROSS = 8  # drapes in a row of the contact sheet
WIDTH, CAPTION = 1.75, 0.25  # inches, width of a drape and height of its caption
DATASET, PRIOR, MARK = "#2f6da8", "#d9762b", "#b5403a"
STARTS = ("#2f6da8", "#8fb8d9", "#6b6b6b")


@dataclass(frozen=True)
class Shot:
    """A drape on the contact sheet.

    Attributes:
        caption: text above it.
        failed: whether it did not converge.
        view: (H, W) z-depth, m, background 0.
    """

    caption: str
    failed: bool
    view: np.ndarray


def take_shots(root: Path, manifest: dict, drapes: Drapes, *, count: int) -> list[Shot]:
    """Render ``count`` converged drapes, sorted by drape coefficient, and up to a row of failed
    ones, with the nominal cameras of their testers and the warp to the right.
    """
    converged = np.flatnonzero(drapes.converged)
    by_coefficient = converged[np.argsort(drapes.columns["drape_coefficient"][converged],
                                          kind="stable")]
    failed = np.flatnonzero(~drapes.converged)
    shots = [_shoot(root, drapes, int(drape)) for drape
             in [*spread(by_coefficient, count), *spread(failed, ACROSS)]]
    return [shot for shot in shots if shot is not None]


def _shoot(root: Path, drapes: Drapes, drape: int) -> Shot | None:
    """Render one drape; None for a failed drape without stored coordinates."""
    name, row = drapes.places[drape]
    shard = Shard(root / name)
    positions, rest, faces = shard.mesh(row)
    if not rest.any():
        return None
    columns = {key: values[drape] for key, values in drapes.columns.items()}
    failed = columns["status"] != "converged"
    caption = columns["status"] if failed else (
        f"{100 * columns['drape_coefficient']:.0f} %, {columns['folds']} folds")
    return Shot(f"{columns['index']}: {caption}", failed,
                DepthRenderer(positions, faces).view(nominal_camera(shard.rig(row))))


def contact_sheet(shots: list[Shot]) -> bytes:
    """PNG of all shots, cropped to the cloth of all of them; nearer is brighter."""
    views = np.stack([shot.view for shot in shots])
    rows, columns = np.nonzero((views > 0).any(axis=0))
    if len(rows):
        views = views[:, rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
    views = np.where(views > 0, views, np.nan)
    low, high = np.nanquantile(views, (0.01, 0.99)) if len(rows) else (0, 1)
    height, width = views.shape[1:]
    across = min(ACROSS, len(shots))
    down = -(-len(shots) // across)
    figure = Figure(figsize=(across * WIDTH, down * (WIDTH * height / width + CAPTION)), dpi=110,
                    layout="constrained")
    panels = figure.subplots(down, across, squeeze=False).ravel()
    for axes in panels:
        axes.set_axis_off()
    for axes, shot, view in zip(panels, shots, views, strict=False):
        axes.imshow(view, cmap="viridis_r", vmin=low, vmax=high, interpolation="nearest")
        axes.set_title(shot.caption, fontsize=7, color=MARK if shot.failed else "black")
    return _png(figure)


def histograms(drapes: Drapes, prior: np.ndarray) -> bytes:
    """PNG of histograms: parameters of the dataset and of samples (n, 6) of the prior, and measures
    of the drapes by initial state."""
    figure = Figure(figsize=(13, 9.5), dpi=110, layout="constrained")
    panels = figure.subplots(3, 4)
    fabrics = in_display_units(draped_fabrics(drapes))
    for k, (name, unit) in enumerate(zip(PARAMETERS, UNITS, strict=True)):
        _parameter(panels[k // 3, k % 3], fabrics[:, k], in_display_units(prior)[:, k],
                   f"{name.replace('_over_', '/').replace('_', ' ')} [{unit}]", logarithmic=k < 3)
    columns, converged = drapes.columns, drapes.converged
    groups = {start: converged & (columns["start"] == start)
              for start in np.unique(columns["start"]).tolist()}
    folds = columns["folds"][converged]
    integers = np.arange(*((folds.min(), folds.max() + 2) if len(folds) else (0, 2))) - 0.5
    _by_start(panels[2, 0], groups, 100 * columns["drape_coefficient"], "drape coefficient [%]", 20)
    _by_start(panels[2, 1], groups, columns["folds"], "folds", integers)
    _by_start(panels[2, 2], groups, 100 * drapes.stretch, "largest strain [%]", 20)
    _by_start(panels[2, 3], groups, columns["iterations"], "Newton iterations", 20)
    for panel, title in ((panels[0, 0], None), (panels[2, 0], "initial state")):
        panel.set_ylim(top=1.5 * panel.get_ylim()[1])  # room for the legend
        panel.legend(frameon=False, loc="upper left", title=title)
    _plane(panels[0, 3], fabrics, in_display_units(prior))
    _outcomes(panels[1, 3], columns["status"])
    return _png(figure)


def _parameter(axes: Axes, dataset: np.ndarray, prior: np.ndarray, label: str, *,
               logarithmic: bool) -> None:
    low, high = np.quantile(prior, (0.002, 0.998))
    if logarithmic:
        axes.set_xscale("log")
        edges = np.geomspace(low, high, 25)
    else:
        edges = np.linspace(low, high, 25)
    # Values beyond the range are counted in the outermost bars.
    for values, style in ((dataset, {"color": DATASET, "alpha": 0.75, "label": "dataset"}),
                          (prior, {"histtype": "step", "color": PRIOR, "lw": 1.5,
                                   "label": "prior"})):
        share = np.full(len(values), 1 / max(1, len(values)))
        axes.hist(np.clip(values, edges[0], edges[-1]), edges, weights=share, **style)
    axes.set(xlabel=label, ylabel="share of fabrics")


def _by_start(axes: Axes, groups: dict[str, np.ndarray], values: np.ndarray, label: str,
              bins: int | np.ndarray) -> None:
    axes.hist([values[group] for group in groups.values()], bins, stacked=True,
              color=[STARTS[k % len(STARTS)] for k in range(len(groups))], label=list(groups))
    axes.set(xlabel=label, ylabel="drapes")


def _plane(axes: Axes, fabrics: np.ndarray, prior: np.ndarray) -> None:
    axes.loglog(prior[:, 0], prior[:, 2], ".", color=PRIOR, ms=2, alpha=0.3)
    axes.loglog(fabrics[:, 0], fabrics[:, 2], ".", color=DATASET, ms=4)
    axes.set(xlabel="alpha warp [µN·m]", ylabel="alpha weft [µN·m]")


def _outcomes(axes: Axes, statuses: np.ndarray) -> None:
    names, counts = np.unique(statuses, return_counts=True)
    colours = [DATASET if name == "converged" else MARK for name in names]
    bars = axes.barh(names, counts, 0.5, color=colours)
    axes.bar_label(bars, padding=2)
    axes.margins(x=0.2, y=0.3)
    axes.set(xlabel="drapes")


def _png(figure: Figure) -> bytes:
    picture = io.BytesIO()
    figure.savefig(picture, format="png", metadata={"Software": None})
    return picture.getvalue()
