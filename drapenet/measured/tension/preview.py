"""Picture of strips under weights: photographs with marks, loads and extensions with the law."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from data.readings.quantity import STANDARD_GRAVITY
from drapenet.measured.tension.law import compliance, load
from drapenet.measured.tension.photograph import PhotographedExtension
from drapenet.measured.tension.posterior import MeasuredExtension, TensionEvidence
from sim.material import DIRECTIONS

_WIDE, _HIGH, _CURVES_HIGH = 10.4, 3.2, 3.2  # inches
_PAIRS = 2  # of photographs in a row
_MARGIN = 0.3  # around the marks, of their distance
_MARK, _CURVE, _POINT = "#3cdc3c", "#2f6da8", "#b5403a"
_SAMPLES = 400  # of the estimate, for the band of a curve


def tension_figure(
    strips: Sequence[MeasuredExtension], photographs: Mapping[int, PhotographedExtension],
    found: TensionEvidence,
) -> Figure:
    """Both photographs of each strip that has some, by its number, with its marks, and for each
    direction the load over the extension, with the law of what was ``found`` and its interval of
    68 %."""
    across = min(_PAIRS, max(len(photographs), 1))
    rows = -(-len(photographs) // across)
    high = rows * _HIGH
    figure = Figure(figsize=(_WIDE, high + _CURVES_HIGH), dpi=100, layout="constrained")
    parts: Any = (figure.subfigures(2, 1, height_ratios=(high, _CURVES_HIGH)) if rows else
                  (None, figure))
    if rows:
        panels = parts[0].subplots(rows, 2 * across, squeeze=False).ravel()
        for panel in panels:
            panel.set_axis_off()
        for k, (number, pair) in enumerate(photographs.items()):
            for state in (0, 1):
                _photograph(panels[2 * k + state], pair, state, strips[number])
    directions = list(dict.fromkeys(DIRECTIONS[strip.direction] for strip in strips))
    for panel, name in zip(parts[1].subplots(1, len(directions), squeeze=False)[0], directions,
                           strict=True):
        _loads(panel, [strip for strip in strips if DIRECTIONS[strip.direction] == name], found)
        panel.set_title(f"along the {name}", fontsize=10)
    return figure


def _grams(strip: MeasuredExtension) -> float:
    return 1e3 * strip.load * strip.width / STANDARD_GRAVITY


def _photograph(panel: Axes, pair: PhotographedExtension, state: int, strip: MeasuredExtension
                ) -> None:
    """The photograph of a ``state``, 0 without and 1 with the weight, around its marks."""
    picture, courses = pair.pictures[state], pair.courses[state]
    panel.imshow(picture.photograph.colour)
    for course in courses:
        panel.plot(*course.T, "-", color=_MARK, linewidth=1.5)
    low, high = np.nanmin(courses, axis=(0, 1)), np.nanmax(courses, axis=(0, 1))
    margin = _MARGIN * (high - low).max()
    panel.set_xlim(low[0] - margin, high[0] + margin)
    panel.set_ylim(high[1] + margin, low[1] - margin)
    apart = 1e3 * (pair.gauge + state * pair.extension)
    weight = f"with {_grams(strip):.3g} g" if state else "without weight"
    panel.set_title(f"{DIRECTIONS[strip.direction]}, {weight}:\nmarks {apart:.1f} mm apart",
                    fontsize=9)


def _loads(panel: Axes, strips: list[MeasuredExtension], found: TensionEvidence) -> None:
    """Measured extensions of the strips of a direction, and the law between their marks."""
    direction, first = strips[0].direction, strips[0]
    for strip in strips:
        percent, error = (100 * each / strip.gauge for each in (strip.extension, strip.error))
        panel.errorbar(percent, strip.load, xerr=error, fmt="o", color=_POINT, capsize=2, ms=4)
        panel.annotate(f"{_grams(strip):.3g} g", (percent, strip.load), xytext=(5, -10),
                       textcoords="offset points", fontsize=8)
    strains = np.linspace(0.0, 1.25 * max(strip.extension / strip.gauge for strip in strips), 40)
    stiffness = [samples[:_SAMPLES] for samples in found.stiffness]
    reach = first.reach((stiffness[0], stiffness[1], stiffness[2]), found.poisson)
    law = compliance(direction, (stiffness[0], stiffness[1], stiffness[2]), found.poisson)
    loads = found.friction[direction] + load(strains[:, None] / reach, law)
    low, middle, high = np.quantile(loads, (0.16, 0.5, 0.84), axis=1)
    panel.plot(100 * strains, middle, color=_CURVE)
    panel.fill_between(100 * strains, low, high, color=_CURVE, alpha=0.2, lw=0)
    panel.set(xlabel="extension [%]", ylabel="load [N/m]", xlim=(0, None), ylim=(0, None))
