"""Outlines seen by a camera beside the plate's axis, as a camera on the axis would see them.

A point at distance r from the axis and depth z below the plate is seen from a height H, through
the plane of the plate, at (H r + z c)/(H + z), c the camera's place beside the axis. The depth is
not seen; but cloth does not stretch, so that a hem hangs the deeper, the nearer it is to the plate.
"""

import numpy as np

from common.types import Metres, Outline
from sim.measures import hem_depth
from sim.rig import Rig

_HEMS, _ALONG = 96, 24  # distances of hems from the plate, and points of cloth up to each


def seen_from_axis(curve: Outline, beside: np.ndarray, height: Metres, rig: Rig) -> Outline:
    """The outline from a camera on the axis at the same ``height`` above the plate; ``beside``:
    place (2,) of the camera that saw it, m."""
    radius, azimuth = np.hypot(*curve.T), np.arctan2(curve[:, 1], curve[:, 0])
    towards = np.column_stack([np.cos(azimuth), np.sin(azimuth)])
    flat = rig.border(azimuth)
    share = np.linspace(0, 1, _HEMS)
    hem = rig.plate_radius + share * (flat[:, None] - rig.plate_radius)  # (N, hems)
    depth = hem_depth(hem, flat[:, None], rig)
    # Cloth leaves the plate horizontally: a quarter of an ellipse from rim to hem.
    turn = np.linspace(0, np.pi / 2, _ALONG)
    out = rig.plate_radius + (hem[..., None] - rig.plate_radius) * np.sin(turn)
    down = depth[..., None] * (1 - np.cos(turn))
    side = (towards @ beside)[:, None, None]
    seen = (height * out + down * side) / (height + down)
    silhouette = seen.argmax(axis=2)[..., None]
    farthest = np.take_along_axis(seen, silhouette, axis=2)[..., 0]
    # Which hem is seen at this distance: the first that is seen as far.
    reached = np.maximum.accumulate(farthest, axis=1)
    after = np.clip((reached < radius[:, None]).sum(axis=1), 1, _HEMS - 1)
    rows = np.arange(len(curve))
    low, high = reached[rows, after - 1], reached[rows, after]
    part = np.clip((radius - low) / np.maximum(high - low, 1e-9), 0, 1)

    def between(values: np.ndarray) -> np.ndarray:
        return values[rows, after - 1] * (1 - part) + values[rows, after] * part

    shown = between(np.take_along_axis(down, silhouette, axis=2)[..., 0])
    from_axis = between((height * out / (height + down)).max(axis=2))
    # Along the azimuth the silhouette moves as its depth says; towards the axis, by the model.
    across = np.column_stack([-towards[:, 1], towards[:, 0]])
    moved = radius + from_axis - between(farthest)
    aside = -(across @ beside) * shown / (height + shown)
    return moved[:, None] * towards + aside[:, None] * across
