"""The batched rasteriser: exact on planes, without cracks, and what the ray caster sees."""

import math

import numpy as np
import pytest
import torch
from torch.nn.utils.rnn import pad_sequence

from common.errors import InputError
from data.render.cameras import CameraRig
from data.render.rasterise import camera_points, camera_tensors, rasterise_tensors, render_batch
from data.render.rasterise_cpu import rasterise_arrays
from data.render.renderer import DepthRenderer
from sim.mesh import grid_faces
from sim.mesh.specimen import make_specimen
from sim.rig import Rig

HEIGHT, WIDTH = 90, 120
INTRINSICS = torch.tensor([[150.0, 140.0, 59.5, 44.5]], dtype=torch.float64)


def loops(points, faces, intrinsics, *, height, width):
    arrays = (tensor.numpy() for tensor in (points, faces, intrinsics.to(points.dtype)))
    return torch.from_numpy(rasterise_arrays(*arrays, height=height, width=width))


def tensors(points, faces, intrinsics, *, height, width):
    return rasterise_tensors(points, faces, intrinsics.to(points.dtype), height=height,
                             width=width)


both = pytest.mark.parametrize("method", [loops, tensors])


def picture(method, points, faces, *, dtype=torch.float64):
    """One picture (H, W) of a mesh given in camera axes."""
    points = torch.as_tensor(np.asarray(points), dtype=dtype)[None, None]
    faces = torch.as_tensor(np.asarray(faces))[None]
    return method(points, faces, INTRINSICS[None], height=HEIGHT, width=WIDTH)[0, 0]


def wall(depth_of, extent: float = 0.35):
    """A rectangle larger than the picture, z = depth_of(x, y)."""
    corners = [(-extent, -extent), (extent, -extent), (extent, extent), (-extent, extent)]
    return [(x, y, depth_of(x, y)) for x, y in corners], [[0, 1, 2], [0, 2, 3]]


def skirt(edge: float, folds: int, topology: int = 0):
    """Cloth that hangs from the plate in folds, so that it hides a part of itself."""
    mesh = make_specimen(Rig(), edge=edge, topology=topology).mesh
    radius, angle = np.linalg.norm(mesh.rest, axis=1), np.arctan2(*mesh.rest.T[::-1])
    reach = np.maximum(radius - 0.05, 0)
    out = np.minimum(radius, 0.05 + 0.5 * reach * (1 + 0.7 * np.sin(folds * angle)))
    positions = np.column_stack([out * np.cos(angle), out * np.sin(angle), -0.75 * reach])
    return torch.from_numpy(positions), torch.from_numpy(mesh.faces)


def batch(drapes: int, edge: float = 0.01):
    """Drapes of different meshes and cameras, four views each: arguments of render_batch."""
    rig, rng = CameraRig.load(), np.random.default_rng(5)
    cameras = [rig.sample(rng).resized(WIDTH, HEIGHT) for _ in range(drapes)]
    positions, faces = zip(*(skirt(edge, 5 + k, topology=k) for k in range(drapes)), strict=True)
    intrinsics, poses = camera_tensors(cameras)
    angles = torch.from_numpy(rng.uniform(0, 2 * np.pi, (drapes, 4)))
    settings = {"angles": angles, "intrinsics": intrinsics, "world_to_camera": poses,
                "height": HEIGHT, "width": WIDTH}
    return (pad_sequence(positions, batch_first=True), pad_sequence(faces, batch_first=True),
            settings, cameras)


@both
def test_pictures_are_those_of_the_ray_caster(method):
    positions, faces, settings, cameras = batch(6, edge=0.008)
    points = camera_points(positions.float(), settings["angles"], settings["world_to_camera"])
    views = method(points, faces, settings["intrinsics"][:, None].expand(-1, 4, -1),
                   height=HEIGHT, width=WIDTH)
    if method is loops:
        assert torch.equal(views, render_batch(positions, faces, **settings))
    cast = np.empty((6, 4, HEIGHT, WIDTH), dtype=np.float32)
    for k, camera in enumerate(cameras):
        renderer = DepthRenderer(positions[k].numpy(), faces[k].numpy())
        cast[k] = [renderer.view(camera, angle) for angle in settings["angles"][k].tolist()]
    views = views.numpy()
    cloth = (views > 0) & (cast > 0)
    assert cloth.sum() > 24 * 1000
    # Pixels on an edge may go either way in single precision, and none more than one beside.
    assert ((views > 0) != (cast > 0)).sum() <= 3
    difference = np.abs(views - cast)[cloth]
    assert (difference > 1e-5).sum() <= 3
    assert np.sqrt(np.square(difference[difference < 1e-3]).mean()) < 1e-6


@both
def test_slanted_plane_is_exact_at_pixel_centres(method):
    view = picture(method, *wall(lambda x, y: 0.5 + 0.6 * x - 0.4 * y))
    fx, fy, cx, cy = INTRINSICS[0].tolist()
    row, column = np.mgrid[:HEIGHT, :WIDTH]
    x, y = (column - cx) / fx, (row - cy) / fy
    assert np.abs(view.numpy() - 0.5 / (1 - 0.6 * x + 0.4 * y)).max() < 1e-13


@both
@pytest.mark.parametrize("edge", [49.9, 50.1])
def test_an_edge_covers_the_pixels_whose_centres_it_passes(method, edge):
    fx, fy, cx, cy = INTRINSICS[0].tolist()
    x, y, z = (edge - cx) / fx * 0.5, (edge - cy) / fy * 0.5, 0.5
    view = picture(method, [[x, -1, z], [-1, -1, z], [-1, y, z], [x, y, z]],
                   [[0, 1, 2], [0, 2, 3]])
    assert view[20].nonzero().max() == math.floor(edge)
    assert view[:, 20].nonzero().max() == math.floor(edge)
    assert (view[: math.floor(edge) + 1, : math.floor(edge) + 1] > 0).all()


@both
def test_both_sides_are_seen_and_the_nearer_one_wins(method):
    front, faces = wall(lambda x, y: 0.4)
    back, _ = wall(lambda x, y: 0.6)
    for winding in (faces, [face[::-1] for face in faces]):
        order = np.concatenate([winding, np.array(winding) + 4])
        for points in ([*front, *back], [*back, *front]):
            assert (picture(method, points, order) - 0.4).abs().max() < 1e-13


@both
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_mesh_has_no_cracks(method, dtype):
    rng = np.random.default_rng(2)
    for size in (4, 40, 150):
        shape = (size, size)
        points = np.stack(np.meshgrid(*2 * [np.linspace(-0.3, 0.3, size)], indexing="ij"), -1)
        points = points + rng.uniform(-0.3, 0.3, points.shape) * 0.6 / size
        depth = 0.5 + 0.05 * rng.uniform(-1, 1, shape) / size
        faces = grid_faces(rng.random((size - 1, size - 1)) < 0.5)
        cloth = np.concatenate([points, depth[..., None]], -1).reshape(-1, 3)
        view = picture(method, cloth, faces, dtype=dtype)[5:-5, 5:-5]
        assert (view > 0).all()
        assert (view - 0.5).abs().max() < 0.06 / size


@both
def test_corners_on_pixel_centres_leave_no_cracks(method):
    fx, fy, cx, cy = INTRINSICS[0].tolist()
    row, column = np.mgrid[: HEIGHT : 2, : WIDTH : 3]
    points = np.stack([(column - cx) / fx, (row - cy) / fy, np.ones(row.shape)], -1) * 0.5
    faces = grid_faces(np.random.default_rng(0).random((row.shape[0] - 1, row.shape[1] - 1)) < 0.5)
    view = picture(method, points.reshape(-1, 3), faces)
    assert (view[1 : row.max(), 1 : column.max()] > 0).all()


@both
def test_what_is_behind_the_camera_or_not_finite_is_left_out(method):
    points, faces = wall(lambda x, y: 0.5)
    behind, _ = wall(lambda x, y: -0.5)
    assert not picture(method, behind, faces).any()
    half = picture(method, points[:3], faces[:1])
    for wrong in ((0.0, 0.0, -0.1), (0.0, 0.0, 0.0), (math.nan, 0.0, 0.5), (0.0, 0.0, math.inf)):
        assert torch.equal(picture(method, [*points[:3], wrong], faces), half)


def test_loops_and_tensors_draw_the_same_soup():
    generator = torch.Generator().manual_seed(11)
    sizes = torch.logspace(-4, 0, 400, dtype=torch.float64)[:, None, None]
    corners = torch.randn(400, 3, 3, generator=generator, dtype=torch.float64) * sizes
    corners += torch.randn(400, 1, 3, generator=generator, dtype=torch.float64) * 0.2
    corners[..., 2] += 0.6  # some behind the camera, many outside of the picture
    corners[::50, 2] = corners[::50, 1]  # lines
    corners[1::50, 1:] = corners[1::50, :1]  # points
    points = corners.reshape(1, 1, -1, 3)
    faces = torch.arange(1200).reshape(1, 400, 3)
    for dtype, tolerance in ((torch.float64, 1e-9), (torch.float32, 1e-3)):
        one, other = (method(points.to(dtype), faces, INTRINSICS[None], height=HEIGHT,
                             width=WIDTH) for method in (loops, tensors))
        assert one.dtype == other.dtype == dtype
        assert (one > 0).float().mean() > 0.3
        assert ((one > 0) != (other > 0)).sum() <= (0 if dtype == torch.float64 else 2)
        assert ((one - other).abs() > tolerance).sum() <= (0 if dtype == torch.float64 else 4)


def test_each_drape_of_a_batch_is_drawn_as_if_alone(monkeypatch):
    positions, faces, settings, _ = batch(5)
    together = render_batch(positions, faces, **settings)
    assert together.shape == (5, 4, HEIGHT, WIDTH) and together.dtype == torch.float32
    for k in range(5):
        own = {name: value[k : k + 1] if isinstance(value, torch.Tensor) else value
               for name, value in settings.items()}
        assert torch.equal(render_batch(positions[k : k + 1], faces[k], **own)[0], together[k])
    # Threads and chunks change nothing.
    threads = torch.get_num_threads()
    try:
        torch.set_num_threads(2)
        assert torch.equal(render_batch(positions, faces, **settings), together)
    finally:
        torch.set_num_threads(threads)
    points = camera_points(positions.float(), settings["angles"], settings["world_to_camera"])
    arguments = (points, faces, settings["intrinsics"].float()[:, None].expand(-1, 4, -1))
    whole = rasterise_tensors(*arguments, height=HEIGHT, width=WIDTH)
    monkeypatch.setattr("data.render.rasterise.CHUNK", 8)
    assert torch.equal(rasterise_tensors(*arguments, height=HEIGHT, width=WIDTH), whole)


def test_camera_points_turn_with_the_specimen():
    positions, _, settings, cameras = batch(2)
    points = camera_points(positions, settings["angles"], settings["world_to_camera"])
    for k, camera in enumerate(cameras):
        for view, angle in enumerate(settings["angles"][k].tolist()):
            c, s = math.cos(angle), math.sin(angle)
            turned = positions[k].numpy() @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
            pose = camera.world_to_camera
            expected = turned @ pose[:3, :3].T + pose[:3, 3]
            assert np.abs(points[k, view].numpy() - expected).max() < 1e-15


def test_faces_must_name_vertices_and_may_repeat_one():
    positions, faces, settings, _ = batch(1)
    with pytest.raises(InputError, match="existing vertices"):
        render_batch(positions, faces + 1, **settings)
    filled = torch.cat([faces, torch.zeros(1, 7, 3, dtype=faces.dtype)], 1)
    assert torch.equal(render_batch(positions, filled, **settings),
                       render_batch(positions, faces, **settings))
    nothing = render_batch(positions[:, :0], faces[:, :0], **settings)
    assert not nothing.any() and nothing.shape == (1, 4, HEIGHT, WIDTH)
