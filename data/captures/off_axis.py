"""Outlines seen by a camera beside the plate's axis, as a camera on the axis would see them.

A point of cloth at the place p (2,) from the axis and at depth z below the plate is seen from a
height H, through the plane of the plate, at (H p + z c)/(H + z), c the camera's place beside the
axis. Depth is not seen, and on the far side the hem may be hidden; but cloth does not stretch, so
that the outline shows how it hangs. A network has learned this from simulated drapes
(``python -m data.dataset.off_axis``).
"""

from pathlib import Path

import numpy as np

from common.graphs import bundled_graph
from common.types import Metres, Outline
from sim.outlines import closed, farthest
from sim.rig import Rig

BUNDLED = Path(__file__).resolve().parents[1] / "weights" / "off_axis.safetensors"
MAX_LEAN = 0.1
"""Place beside the axis over height above the plate, beyond which another picture is asked for. The
error of the outline is a part of its own; log alpha of nine of ten of fabrics held out differs by
at most 0.086 from that of the outline from the axis, beyond by up to 0.22 (0.30), most of all of
limp cloth, on whose far side the hem is hidden."""
AZIMUTHS = 720
AZIMUTH = np.arange(AZIMUTHS) * (2 * np.pi / AZIMUTHS)
OUTWARDS = np.column_stack([np.cos(AZIMUTH), np.sin(AZIMUTH)])


def seen_from_axis(curve: Outline, beside: np.ndarray, height: Metres, rig: Rig) -> Outline:
    """The outline from a camera on the axis at the same ``height`` above the plate.

    Args:
        curve: outline as seen, on the plane of the plate, about its centre; of a rectangle, the
            x-axis is along its first side.
        beside: place (2,) of the camera that saw it, in the same axes, m.

    Returns:
        its outermost points (720, 2) at equally spaced azimuths; those of ``curve`` if the camera
        was on the axis.
    """
    size = rig.specimen_size
    radius = farthest(closed(curve), AZIMUTHS)
    found, = bundled_graph(BUNDLED)(**{name: np.array([one]) for name, one in (
        ("radius", radius / size), ("border", rig.border(AZIMUTH) / size),
        ("plate", rig.plate_radius / size), ("height", height / size),
        ("lean", np.asarray(beside) / height))})
    # Nothing is seen inside the plate; what was, stays for the checks of outlines.
    moved = np.maximum(found[0] * size, np.minimum(radius, rig.plate_radius))
    return moved[:, None] * OUTWARDS
