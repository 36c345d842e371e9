"""Pictures of a capture as it was read, to be checked by eye: ``capture.png``.

In the hems of all frames from above, where two colours do not coincide, or all are on one side, the
turns of the table differ from those stated, or the cloth has moved.
"""

import io
import textwrap
from collections.abc import Sequence
from functools import singledispatch

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from common.types import Outline, Radians, Turns
from data.captures.capture import Capture, Check, DepthCapture, OutlineCapture
from data.captures.cutout import CutOut
from data.render.cameras import Camera, Intrinsics
from data.render.shade import outline_thumbnail, thumbnails
from sim.rig import Rig

_AXIS = 0.04  # m, length of the axes drawn
_WIDTH = 4.8  # inches, width of a frame in the picture
_RIM, _OUTLINE = "#ffc800", "#3cdc3c"
_AXES = ("#ff3c3c", "#3cc83c", "#3c78ff")
_VIEWS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#3c3c3c", "#a01414")
"""Colours of Okabe and Ito, and two dark ones."""
_FIELD = 1.02  # half height of the view from above, relative to the specimen's reach
_SECTORS = 180  # of the hem from above, each with its outermost point
_VISIBLE = np.radians(75.0)  # azimuth on either side of the camera in which a view shows the hem
_SOUND, _FAULTY = "#1a7f37", "#b5202a"
_LINE, _SPACING = 78, 11  # characters, and points between the lines, of checks


@singledispatch
def show(capture: Capture, checks: Sequence[Check] = (), *, small: bool = False) -> bytes:
    """PNG of a capture as it was read, with ``checks``; ``small``: a thumbnail without them."""
    return outline_thumbnail(None)


@show.register
def _(capture: OutlineCapture, checks: Sequence[Check] = (), *, small: bool = False) -> bytes:
    """Photograph from above, or curve of numbers, with plate, warp and ``checks``."""
    outline, rig = capture.outline, capture.rig
    if small:
        return outline_thumbnail(outline.curve)
    figure = Figure(figsize=(2 * _WIDTH, 2 * _WIDTH), dpi=100)
    panel = figure.add_axes((0.02, 0.02, 0.96, 0.82))
    panel.set_axis_off()
    panel.set_aspect("equal")
    if outline.picture is not None:
        panel.imshow(outline.picture)
        panel.autoscale(False)
    angle = np.linspace(0, 2 * np.pi, 181)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    lines = [("outline", outline.curve[np.arange(len(outline.curve) + 1) % len(outline.curve)],
              _OUTLINE, "-"),
             ("plate", rig.plate_radius * circle, _RIM, "-"),
             ("reach of the flat specimen", rig.reach * circle, _AXES[2], ":")]
    if capture.warp_direction is not None:
        along = np.array([np.cos(capture.warp_direction), np.sin(capture.warp_direction)])
        lines.append(("warp", rig.plate_radius * np.stack([-along, along]), _AXES[0], "-"))
    if outline.hem is not None:  # as it was seen, also from beside the axis
        panel.plot(*np.vstack([outline.hem, outline.hem[:1]]).T, "-", color=_OUTLINE, linewidth=1,
                   label="outline")
        lines = lines[1:]
    for label, points, colour, style in lines:
        panel.plot(*outline.drawn(points).T, style, color=colour, linewidth=1, label=label)
    scale = "" if np.isnan(outline.pixel) else f", {1e3 * outline.pixel:.3g} mm per pixel"
    header = figure.add_axes((0.0, 0.84, 0.7, 0.16))
    header.set_axis_off()
    _draw_checks(header, f"{rig.name}{scale}", checks)
    figure.legend(loc="upper right", frameon=False)
    return png(figure)


@show.register
def _(capture: DepthCapture, checks: Sequence[Check] = (), *, small: bool = False) -> bytes:
    """Frames, two per row, the hems from above, and ``checks``; of views that show only cloth, and
    if ``small`` of the first one, the cloth."""
    cut, intrinsics, rig = capture.cut, capture.intrinsics, capture.rig
    if small or not cut:
        return thumbnails(capture.views[:1] if small else capture.views)
    rows = -(-(len(cut.frames) + 1 + bool(checks)) // 2)
    height = _WIDTH * intrinsics.height / intrinsics.width
    figure = Figure(figsize=(2 * _WIDTH, rows * height), dpi=100)
    panels = figure.subplots(rows, 2, squeeze=False).ravel()
    figure.subplots_adjust(0, 0, 1, 1, 0, 0)
    for panel in panels:
        panel.set_axis_off()
    depth = cut.frames[cut.masks]
    near, far = (depth.min(), depth.max() + 0.3) if len(depth) else (0.0, 1.0)
    black = far + 0.3 * (far - near)
    for panel, frame, mask in zip(panels, cut.frames, cut.masks, strict=False):
        # The largest depth is dark grey, unknown depth black.
        panel.imshow(np.where(frame > 0, np.minimum(frame, far), black), cmap="gray_r", vmin=near,
                     vmax=black, interpolation="nearest")
        panel.autoscale(False)
        if mask.any():
            panel.contour(mask, [0.5], colors=_OUTLINE, linewidths=1)
        _draw_plate(panel, intrinsics.posed(cut.plate.pose), rig)
    _draw_hems(panels[len(cut.frames)], cut, intrinsics, rig, capture.turns)
    if checks:
        _draw_checks(panels[len(cut.frames) + 1], rig.name, checks)
    return png(figure)


def _draw_checks(panel: Axes, title: str, checks: Sequence[Check]) -> None:
    """Write the ``checks`` below a title, those with a warning first."""
    lines = [(title, "black")]
    for check in sorted(checks, key=lambda check: not check.warning):
        mark, colour = ("✗", _FAULTY) if check.warning else ("✓", _SOUND)
        said = check.warning.text if check.warning else f"{check.name}: {check.value}"
        lines += [(line, colour) for line in textwrap.wrap(
            f"{mark} {said}", _LINE, subsequent_indent="    ", drop_whitespace=False)]
    for k, (line, colour) in enumerate(lines):
        panel.annotate(line, (0.02, 0.98), (0, -_SPACING * k), "axes fraction", "offset points",
                       color=colour, fontsize=8, va="top", parse_math=False)


def png(figure: Figure) -> bytes:
    """A figure as PNG, the same of each version of matplotlib."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", metadata={"Software": None})
    return stream.getvalue()


def _draw_plate(panel: Axes, camera: Camera, rig: Rig) -> None:
    """Draw the plate's rim and axes."""
    angle = np.linspace(0, 2 * np.pi, 90)
    rim = rig.plate_radius * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    axes = [np.stack([np.zeros(3), _AXIS * axis]) for axis in np.eye(3)]
    for points, colour in zip([rim, *axes], (_RIM, *_AXES), strict=True):
        panel.plot(*camera.project(points)[0].T, color=colour, linewidth=1)


def _draw_hems(panel: Axes, cut: CutOut, intrinsics: Intrinsics, rig: Rig, turns: Turns) -> None:
    """Draw the hems of all views from above, rotated to the first view, x to the right."""
    camera = np.linalg.inv(cut.plate.pose)[:2, 3]
    for k, (view, turn) in enumerate(zip(cut.views, turns, strict=True)):
        points = cut.plate.local(intrinsics.back_project(view)[view > 0])[:, :2]
        back = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        hem = _hem(points, np.arctan2(camera[1], camera[0])) @ back.T
        label = f"view {k}: {np.degrees(turn):.4g}°"
        panel.plot(*hem.T, color=_VIEWS[k % len(_VIEWS)], label=label)
    panel.add_patch(Circle((0, 0), rig.plate_radius, fill=False, color="grey", label="plate's rim"))
    panel.set_aspect("equal", adjustable="datalim")
    panel.set_ylim(-_FIELD * rig.reach, _FIELD * rig.reach)
    panel.legend(title="hems from above", loc="upper left", frameon=False, fontsize=8,
                 labelcolor="linecolor", alignment="left")


def _hem(points: np.ndarray, towards: Radians) -> Outline:
    """The outermost of ``points`` (P, 2), m, in each sector that faces the camera, NaN in gaps;
    ``towards``: direction of the camera.
    """
    distance = np.linalg.norm(points, axis=1)
    away = (np.arctan2(points[:, 1], points[:, 0]) - towards + np.pi) % (2 * np.pi) - np.pi
    sector = np.floor(away / (2 * np.pi / _SECTORS)).astype(int)
    order = np.lexsort((-distance, sector))
    sectors, first = np.unique(sector[order], return_index=True)
    outermost = order[first][np.abs((sectors + 0.5) * (2 * np.pi / _SECTORS)) < _VISIBLE]
    gaps = np.flatnonzero(np.diff(sector[outermost]) > 1) + 1
    return np.insert(points[outermost], gaps, np.nan, axis=0)
