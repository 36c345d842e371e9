"""Resampling of depth pictures that never mixes cloth with background or with a farther fold."""

import numpy as np

# Neighbours farther apart in depth than this lie on different folds: about twice the step between
# neighbouring pixels of the steepest cloth that a picture of the rig still resolves.
EDGE_STEP = 0.02


def remap_depth(depth: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Depth at the picture coordinates (u, v): bilinear on a surface, nearest at its silhouette.

    The pixel nearest to (u, v) decides between cloth and background. Of the four pixels around,
    only those within ``EDGE_STEP`` of it take part, with their weights brought to a sum of one.

    Args:
        depth: (..., H, W) float32 z-depth in metres, background 0.
        u, v: columns and rows, broadcastable to (..., h, w); outside the picture is background.

    Returns:
        (..., h, w) float32 metres.
    """
    height, width = depth.shape[-2:]
    shape = np.broadcast_shapes((*depth.shape[:-2], 1, 1), u.shape, v.shape)
    # One ring of background around each picture stands for everything outside it.
    padded = np.zeros((*depth.shape[:-2], height + 2, width + 2), dtype=np.float32)
    padded[..., 1:-1, 1:-1] = depth
    u = np.clip(u, -1, width).astype(np.float32) + np.float32(1)
    v = np.clip(v, -1, height).astype(np.float32) + np.float32(1)
    # Pictures lie one after the other in memory; start is where each begins.
    start = np.arange(int(np.prod(depth.shape[:-2])), dtype=np.int32) * np.int32(
        (height + 2) * (width + 2)
    )
    start = start.reshape(*depth.shape[:-2], 1, 1)
    flat = padded.ravel()
    nearest = np.rint(v).astype(np.int32) * np.int32(width + 2) + np.rint(u).astype(np.int32)
    centre = np.broadcast_to(flat[start + nearest], shape)
    cloth = centre > 0

    u, v = np.broadcast_to(u, shape)[cloth], np.broadcast_to(v, shape)[cloth]
    centre, start = centre[cloth], np.broadcast_to(start, shape)[cloth]
    left, above = np.floor(u), np.floor(v)
    right_weight, below_weight = u - left, v - above
    corner = start + above.astype(np.int32) * np.int32(width + 2) + left.astype(np.int32)
    total, weights = np.zeros_like(centre), np.zeros_like(centre)
    for step, weight in (
        (0, (1 - right_weight) * (1 - below_weight)),
        (1, right_weight * (1 - below_weight)),
        (width + 2, (1 - right_weight) * below_weight),
        (width + 3, right_weight * below_weight),
    ):
        # A weight of zero may point past the last picture's end.
        value = flat.take(corner + np.int32(step), mode="clip")
        weight = np.where(np.abs(value - centre) < EDGE_STEP, weight, np.float32(0))
        total += weight * value
        weights += weight
    result = np.zeros(shape, dtype=np.float32)
    result[cloth] = total / weights
    return result
