"""Resampling of depth pictures that never mixes cloth with background or with a farther fold."""

import torch
from torch.nn.functional import pad

# Neighbours farther apart in depth than this lie on different folds: about twice the step between
# neighbouring pixels of the steepest cloth that a picture of the rig still resolves.
EDGE_STEP = 0.02


def remap_depth(depth: torch.Tensor, u: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
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
    pictures = depth.shape[:-2]
    shape = torch.broadcast_shapes((*pictures, 1, 1), u.shape, v.shape)
    # One ring of background around each picture stands for everything outside it.
    flat = pad(depth, (1, 1, 1, 1)).flatten()
    stride = width + 2
    u = u.float().clamp(-1, width) + 1
    v = v.float().clamp(-1, height) + 1
    # Pictures lie one after the other in memory; start is where each begins.
    start = torch.arange(pictures.numel(), device=depth.device, dtype=torch.int32)
    start = start.view(*pictures, 1, 1) * ((height + 2) * stride)
    nearest = (start + v.round().int() * stride + u.round().int()).expand(shape)
    centre = flat.index_select(0, nearest.flatten())
    # Most of a picture is background: go on with the cloth alone.
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
        # A weight of zero may point past the last picture's end.
        value = flat.index_select(0, (corner + step).clamp(max=len(flat) - 1))
        weight = torch.where((value - centre).abs() < EDGE_STEP, weight, 0)
        total += weight * value
        weights += weight
    result = torch.zeros(shape.numel(), dtype=torch.float32, device=depth.device)
    result[cloth] = total / weights
    return result.view(shape)
