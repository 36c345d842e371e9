"""Batched rendering of depth pictures of drapes: a z-buffer in PyTorch, on any device.

The pictures equal those of :mod:`data.render.renderer`: z-depth, pixel centres at integers,
background 0, only the cloth, two-sided. :mod:`data.render.renderer` casts rays; this module
rasterises triangles:

    corners -> two trapezoids per triangle, split at the middle corner's row -> rows -> spans ->
    pixels

Every step expands items (triangles, rows) into as many copies as each needs, so that the only loop
is over chunks of pictures, and pixels outside a triangle are not visited. Along an edge and along a
row, 1/z is linear in the picture; the buffer keeps the largest. A maximum does not depend on the
order of its operands, so equal input gives equal pictures.

On a CPU the same steps run as compiled loops (:mod:`data.render.rasterise_cpu`), because the memory
traffic of the expanded arrays would dominate.

Two triangles that share an edge compute its intersection with a row by the same operations on the
same numbers, from the upper corner down, and spans include their ends: a mesh has no cracks.
"""

import math
from collections.abc import Sequence

import torch

from common.errors import InputError
from data.render.cameras import Camera
from data.render.rasterise_cpu import MIN_HEIGHT, rasterise_arrays

CHUNK = 512  # pictures per chunk: about 1 GB at 240x180


def camera_tensors(
    cameras: Sequence[Camera], *, device: torch.device | str | None = None
) -> tuple[torch.Tensor, torch.Tensor]:
    """Intrinsics (B, 4) fx, fy, cx, cy, px, and world_to_camera (B, 4, 4), m, both float64."""
    numbers = [[camera.fx, camera.fy, camera.cx, camera.cy] for camera in cameras]
    poses = [camera.world_to_camera.tolist() for camera in cameras]
    return (torch.tensor(numbers, dtype=torch.float64, device=device),
            torch.tensor(poses, dtype=torch.float64, device=device))


@torch.no_grad()
def render_batch(
    positions: torch.Tensor,
    faces: torch.Tensor,
    *,
    angles: torch.Tensor,
    intrinsics: torch.Tensor,
    world_to_camera: torch.Tensor,
    height: int,
    width: int,
) -> torch.Tensor:
    """Depth pictures of B drapes from K sides each.

    Args:
        positions: (B, V, 3) vertices in metres, world axes at orientation 0.
        faces: (F, 3) or (B, F, 3) int64 triangles. Meshes with fewer triangles than others are
            padded with triangles of one repeated vertex.
        angles: (B, K) rotation of the specimen in each picture, radians, counter-clockwise seen
            from above (orientation plus the table's turn).
        intrinsics: (B, 4) fx, fy, cx, cy of this picture size, px.
        world_to_camera: (B, 4, 4) rigid, m.
        height, width: size of the pictures, px.

    Returns:
        (B, K, height, width) float32 z-depth in metres, background 0. Triangles with a corner
        behind the camera or a coordinate that is not finite are skipped.

    Raises:
        InputError: a face refers to a vertex that does not exist.
    """
    points = camera_points(positions.float(), angles, world_to_camera)
    meshes, views, vertices, _ = points.shape
    if faces.numel() and not 0 <= int(faces.min()) <= int(faces.max()) < vertices:
        raise InputError("faces to render must name existing vertices")
    faces = faces.expand(meshes, *faces.shape[-2:])
    intrinsics = intrinsics.float()[:, None].expand(meshes, views, 4)
    if points.device.type == "cpu":
        arrays = (tensor.numpy() for tensor in (points, faces, intrinsics))
        return torch.from_numpy(rasterise_arrays(*arrays, height=height, width=width,
                                                 threads=torch.get_num_threads()))
    return rasterise_tensors(points, faces, intrinsics, height=height, width=width)


def camera_points(
    positions: torch.Tensor, angles: torch.Tensor, world_to_camera: torch.Tensor
) -> torch.Tensor:
    """Vertices (B, K, V, 3) in camera axes, m, of positions (B, V, 3) turned by angles (B, K).

    Other arguments as in :func:`render_batch`; the result has the type of ``positions``.
    """
    c, s = torch.cos(angles)[..., None], torch.sin(angles)[..., None]
    right, away, up, shift = world_to_camera[:, None, :3, :].unbind(-1)
    axes = (c * right + s * away, c * away - s * right, up, shift)
    # Not a matrix product, which a GPU may compute in TF32 with 10 bits.
    x, y, z, shift = (axis.to(positions.dtype)[:, :, None] for axis in axes)
    at = positions[:, None, :, :, None]
    return at[..., 0, :] * x + at[..., 1, :] * y + at[..., 2, :] * z + shift


def rasterise_tensors(
    points: torch.Tensor,
    faces: torch.Tensor,
    intrinsics: torch.Tensor,
    *,
    height: int,
    width: int,
) -> torch.Tensor:
    """Depth pictures (B, K, height, width) of B meshes, K of each, in PyTorch alone.

    Arguments and result are those of :func:`data.render.rasterise_cpu.rasterise_arrays`, as
    tensors.
    """
    meshes = max(1, CHUNK // points.shape[1])
    parts = zip(*(tensor.split(meshes) for tensor in (points, faces, intrinsics)), strict=True)
    return torch.cat([_rasterise(*part, height, width) for part in parts])


def _rasterise(
    points: torch.Tensor, faces: torch.Tensor, intrinsics: torch.Tensor, height: int, width: int
) -> torch.Tensor:
    """:func:`rasterise_tensors` of one chunk of pictures."""
    upper, middle, lower = _corners(points, faces, intrinsics)
    drawn = torch.isfinite(upper + middle + lower).all(0)
    long = _edge(upper, lower)
    edges = torch.cat([torch.cat([long, long], 1),
                       torch.cat([_edge(upper, middle), _edge(middle, lower)], 1)])
    # Trapezoids: above the middle corner's row, and from this row down.
    cut = middle[1].ceil().clamp(0, height)
    first = torch.cat([upper[1].ceil().clamp(min=0), cut])
    stop = torch.cat([cut, (lower[1].floor() + 1).clamp(max=height)])
    rows = torch.where(drawn.repeat(2), stop - first, 0).clamp(min=0).long()
    pictures = points.shape[:2].numel()
    pixels_before = torch.arange(pictures, device=points.device) * (height * width)
    pixels_before = pixels_before.repeat_interleave(faces.shape[1]).repeat(2)

    piece, number = _copies(rows)
    row = first.index_select(0, piece) + number
    y, x, dx, w, dw, y2, x2, dx2, w2, dw2 = edges.index_select(1, piece).unbind(0)
    x, w = torch.addcmul(x, dx, row - y), torch.addcmul(w, dw, row - y)
    x2, w2 = torch.addcmul(x2, dx2, row - y2), torch.addcmul(w2, dw2, row - y2)
    begin = torch.minimum(x, x2).ceil().clamp(min=0)
    end = torch.maximum(x, x2).floor().clamp(max=width - 1)
    columns = (end - begin + 1).clamp(min=0).long()
    slope = torch.where(x2 == x, 0, (w2 - w) / (x2 - x))
    w_begin = torch.addcmul(w, slope, begin - x)
    pixel_begin = pixels_before.index_select(0, piece) + row.long() * width + begin.long()

    span, number = _copies(columns)
    w = torch.addcmul(w_begin.index_select(0, span), slope.index_select(0, span), number)
    pixel = pixel_begin.index_select(0, span) + number
    nearest = points.new_zeros(pictures * height * width)  # 1/z; background is at infinity
    nearest.scatter_reduce_(0, pixel, w, "amax")
    depth = torch.where(nearest > 0, 1 / nearest, 0)
    return depth.view(*points.shape[:2], height, width)


def _corners(
    points: torch.Tensor, faces: torch.Tensor, intrinsics: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Upper, middle and lower corners of all triangles: tensors (3, B*K*F) of u, v, 1/z.

    Corners behind the camera become NaN.
    """
    x, y, z = points.unbind(-1)
    fx, fy, cx, cy = intrinsics[..., None].unbind(2)
    w = 1 / torch.where(z > 0, z, math.nan)
    projected = torch.stack([fx * x * w + cx, fy * y * w + cy, w]).flatten(1)
    meshes, views, vertices = z.shape
    before = torch.arange(meshes * views, device=z.device).view(meshes, views, 1) * vertices
    a, b, c = (projected.index_select(1, (faces[:, None, :, k] + before).flatten())
               for k in range(3))
    a, b = _by_row(a, b)
    b, c = _by_row(b, c)
    a, b = _by_row(a, b)
    return a, b, c


def _by_row(a: torch.Tensor, b: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Sort two corners of each triangle, the upper one first."""
    swap = a[1] > b[1]
    return torch.where(swap, b, a), torch.where(swap, a, b)


def _edge(upper: torch.Tensor, lower: torch.Tensor) -> torch.Tensor:
    """Edges (5, ...): row of the upper corner, column there and its slope per row, 1/z and its
    slope.
    """
    down = (lower[1] - upper[1]).clamp(min=MIN_HEIGHT)
    u, v, w = upper
    return torch.stack([v, u, (lower[0] - u) / down, w, (lower[2] - w) / down])


def _copies(counts: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """For items copied ``counts`` times: the item of each copy, and its number among them."""
    ends = counts.cumsum(0)
    total = int(ends[-1]) if len(ends) else 0
    item = torch.repeat_interleave(counts, output_size=total)
    number = torch.arange(total, device=counts.device) - (ends - counts).index_select(0, item)
    return item, number
