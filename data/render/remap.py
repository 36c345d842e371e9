"""Resampling of depth pictures without interpolation across silhouettes and folds."""

import torch
from torch.nn.functional import pad

# m; neighbours with a larger depth difference are on different folds. About twice the difference
# between neighbouring pixels on the steepest cloth that the rig's pictures resolve.
EDGE_STEP = 0.02


def remap_depth(depth: torch.Tensor, u: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
    """Depth at the picture coordinates (u, v): bilinear on a surface, nearest at its silhouette.

    The pixel nearest to (u, v) decides between cloth and background. Of the four pixels around
    (u, v), those within ``EDGE_STEP`` of its depth are interpolated with normalised weights.

    Args:
        depth: (..., H, W) float32 z-depth in metres, background 0.
        u, v: columns and rows, broadcastable to (..., h, w); outside the picture is background.

    Returns:
        (..., h, w) float32 metres.
    """
    height, width = depth.shape[-2:]
    pictures = depth.shape[:-2]
    shape = torch.broadcast_shapes((*pictures, 1, 1), u.shape, v.shape)
    # Outside a picture is background: one ring of padding, to which coordinates are clamped.
    flat = pad(depth, (1, 1, 1, 1)).flatten()
    stride = width + 2
    u = u.float().clamp(-1, width) + 1
    v = v.float().clamp(-1, height) + 1
    # Index of the first pixel of each picture in the flattened array.
    start = torch.arange(pictures.numel(), device=depth.device, dtype=torch.int32)
    start = start.view(*pictures, 1, 1) * ((height + 2) * stride)
    nearest = (start + v.round().int() * stride + u.round().int()).expand(shape)
    centre = flat.index_select(0, nearest.flatten())
    # Most of a picture is background: interpolate only the cloth.
    cloth = centre.nonzero()[:, 0]

    centre = centre.index_select(0, cloth)
    u, v, start = (part.expand(shape).flatten().index_select(0, cloth) for part in (u, v, start))
    left, above = u.floor(), v.floor()
    right_weight, below_weight = u - left, v - above
    corner = start + above.int() * stride + left.int()
    total, weights = torch.zeros_like(centre), torch.zeros_like(centre)
    for step, weight in (
        (0, (1 - right_weight) * (1 - below_weight)),
        (1, right_weight * (1 - below_weight)),
        (stride, (1 - right_weight) * below_weight),
        (stride + 1, right_weight * below_weight),
    ):
        # With a weight of zero the index may exceed the array.
        value = flat.index_select(0, (corner + step).clamp(max=len(flat) - 1))
        weight = torch.where((value - centre).abs() < EDGE_STEP, weight, 0)
        total += weight * value
        weights += weight
    result = torch.zeros(shape.numel(), dtype=torch.float32, device=depth.device)
    result[cloth] = total / weights
    return result.view(shape)
