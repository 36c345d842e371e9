"""Picture of photographed strips."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from drapenet.measured.strips.photograph import PhotographedStrip

_WIDTH = 4.8  # inches, of a panel
_MARGIN = 0.2  # around a strip, of its extent
_CURVE, _CLAMP, _TIP = "#3cdc3c", "#ffc800", "#ff3c3c"


def strips_figure(strips: Sequence[PhotographedStrip]) -> Figure:
    """Each photograph around its strip, with the curve, the clamp's edge and the tip."""
    rows = -(-len(strips) // 2)
    figure = Figure(figsize=(2 * _WIDTH, 0.9 * _WIDTH * rows), dpi=100, layout="constrained")
    panels = figure.subplots(rows, 2, squeeze=False).ravel()
    for panel in panels:
        panel.set_axis_off()
    for panel, strip in zip(panels, strips, strict=False):
        panel.imshow(strip.picture, cmap="gray", vmin=0, vmax=255)
        panel.plot(*strip.pixels.T, "-", color=_CURVE, linewidth=1)
        for place, colour in ((strip.pixels[0], _CLAMP), (strip.pixels[-1], _TIP)):
            panel.plot(*place, "o", markersize=5, markerfacecolor="none", color=colour)
        low, high = strip.pixels.min(axis=0), strip.pixels.max(axis=0)
        margin = _MARGIN * (high - low).max()
        panel.set_xlim(low[0] - margin, high[0] + margin)
        panel.set_ylim(high[1] + margin, low[1] - margin)
        panel.set_title(_title(strip), fontsize=9)
    return figure


def _title(strip: PhotographedStrip) -> str:
    curve = 1e3 * strip.measured.curve
    length = np.linalg.norm(np.diff(curve, axis=0), axis=1).sum()
    face = "up" if strip.measured.sign > 0 else "down"
    return (f"{strip.name}: {strip.direction}, face {face}, {length:.1f} mm\n"
            f"(stated {1e3 * strip.measured.length:g}), tip {curve[-1, 0]:.1f} out and "
            f"{curve[-1, 1]:.1f} below, seen {1e3 * strip.band:.2f} mm thick")
