"""Orientation, view order, z-depth and pixel centres of rendered pictures."""

import builtins
import math

import numpy as np
import pytest

from common.errors import InputError
from data.render.cameras import Camera, CameraRig
from data.render.renderer import DepthRenderer


def camera_at_origin(**changes: float) -> Camera:
    """Camera axes equal to world axes, so that scenes can be given as x right, y down, z ahead."""
    numbers = {"fx": 300.0, "fy": 280.0, "cx": 119.5, "cy": 89.5} | changes
    return Camera(**numbers, width=240, height=180, world_to_camera=np.eye(4))


def markers(*centres: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Positions and faces of small octahedra, which look the same from all four sides."""
    corners = 0.01 * np.vstack([np.eye(3), -np.eye(3)])
    signs = [(a, b, c) for a in (0, 3) for b in (1, 4) for c in (2, 5)]
    positions = np.vstack([np.array(centre) + corners for centre in centres])
    return positions, np.vstack([np.array(signs) + 6 * k for k in range(len(centres))])


def render_markers(*centres: tuple[float, float, float]) -> np.ndarray:
    return DepthRenderer(*markers(*centres)).views(CameraRig.load().nominal())


def place(view: np.ndarray) -> tuple[float, float, float]:
    """Mean column, row and depth of the cloth in a view."""
    rows, columns = np.nonzero(view)
    return columns.mean(), rows.mean(), view[view > 0].mean()


def test_right_is_right_up_is_up_and_away_is_deeper():
    origin = place(render_markers((0, 0, 0))[0])
    right = place(render_markers((0.08, 0, 0))[0])
    up = place(render_markers((0, 0, 0.08))[0])
    away = place(render_markers((0, 0.08, 0))[0])
    assert origin[0] == pytest.approx(119.5, abs=0.6)
    assert right[0] - origin[0] > 35 and abs(right[1] - origin[1]) < 1
    assert abs(up[0] - origin[0]) < 1 and up[1] - origin[1] < -25
    assert abs(away[0] - origin[0]) < 1 and away[1] < origin[1] and away[2] > origin[2] + 0.04


def test_table_turns_counter_clockwise_from_view_to_view():
    # A marker on the right goes to the back, the left and the front.
    views = [place(view) for view in render_markers((0.08, 0, 0))]
    columns, _, depth = (np.array(values) for values in zip(*views, strict=True))
    assert columns[0] > 155 and columns[2] < 85
    assert columns[[1, 3]] == pytest.approx([119.5, 119.5], abs=1)
    assert depth[1] - depth[3] == pytest.approx(0.16 * math.cos(math.radians(38)), abs=0.003)


def test_orientation_turns_the_specimen_counter_clockwise_in_the_first_view():
    camera = CameraRig.load().nominal()
    positions, faces = markers((0.09, 0, 0), (0.04, 0.02, -0.05), (0, -0.06, 0.01))
    for angle in (0.7, math.pi / 2, -2.0):
        c, s = math.cos(angle), math.sin(angle)
        by_hand = positions @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
        views = DepthRenderer(positions, faces).views(camera, angle)
        expected = DepthRenderer(by_hand, faces).views(camera)
        # Rays are single precision: a silhouette pixel may differ.
        assert np.mean(np.abs(views - expected) > 1e-5) < 1e-4
    quarter = DepthRenderer(positions, faces).views(camera, math.pi / 2)
    views = DepthRenderer(positions, faces).views(camera)
    assert np.mean(np.abs(quarter - np.roll(views, -1, axis=0)) > 1e-5) < 1e-4


def wall(depth_of, extent: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """A large rectangle z = depth_of(x, y) in camera axes."""
    corners = [(-extent, -extent), (extent, -extent), (extent, extent), (-extent, extent)]
    positions = np.array([(x, y, depth_of(x, y)) for x, y in corners])
    return positions, np.array([[0, 1, 2], [0, 2, 3]])


def test_depth_is_along_the_axis_not_along_the_ray():
    view = DepthRenderer(*wall(lambda x, y: 0.5)).view(camera_at_origin())
    assert view.dtype == np.float32 and view.shape == (180, 240)
    assert np.abs(view - 0.5).max() < 1e-6
    # Along the ray the corner would be 5 cm farther away.
    assert 0.5 * np.linalg.norm(camera_at_origin().directions()[0, 0]) > 0.55


def test_slanted_plane_is_exact_at_pixel_centres():
    camera = camera_at_origin()
    view = DepthRenderer(*wall(lambda x, y: 0.5 + 0.6 * x - 0.4 * y)).view(camera)
    v, u = np.mgrid[:180, :240]
    x, y = (u - 119.5) / 300.0, (v - 89.5) / 280.0
    assert np.abs(view - 0.5 / (1 - 0.6 * x + 0.4 * y)).max() < 1e-5
    # Half a pixel beside, it would be clearly wrong.
    beside = 0.5 / (1 - 0.6 * (x + 0.5 / 300) + 0.4 * y)
    assert np.abs(view - beside).min() > 1e-4


@pytest.mark.parametrize("edge", [99.9, 100.1])
def test_an_edge_covers_the_pixels_whose_centres_it_passes(edge):
    camera = camera_at_origin()
    x = (edge - camera.cx) / camera.fx * 0.5
    y = (edge - camera.cy) / camera.fy * 0.5
    positions = np.array([[x, -1, 0.5], [-1, -1, 0.5], [-1, y, 0.5], [x, y, 0.5]])
    view = DepthRenderer(positions, np.array([[0, 1, 2], [0, 2, 3]])).view(camera)
    assert np.flatnonzero(view[50]).max() == math.floor(edge)
    assert np.flatnonzero(view[:, 50]).max() == math.floor(edge)


def test_both_sides_of_the_cloth_are_seen_and_the_nearer_one_wins():
    front, faces = wall(lambda x, y: 0.4)
    back, _ = wall(lambda x, y: 0.6)
    positions = np.vstack([back, front])
    for winding in (faces, faces[:, ::-1]):
        view = DepthRenderer(positions, np.vstack([winding, winding + 4])).view(camera_at_origin())
        assert np.abs(view - 0.4).max() < 1e-6


def test_nothing_in_sight_is_background():
    positions, faces = wall(lambda x, y: -0.5)
    assert not DepthRenderer(positions, faces).view(camera_at_origin()).any()


def test_meshes_that_cannot_be_rendered_are_input_errors():
    positions, faces = wall(lambda x, y: 0.5)
    with pytest.raises(InputError, match="finite"):
        DepthRenderer(np.where(positions == 0.5, np.nan, positions), faces)
    with pytest.raises(InputError, match="existing vertices"):
        DepthRenderer(positions, faces + 1)
    with pytest.raises(InputError, match="shape"):
        DepthRenderer(positions[:, :2], faces)


def test_missing_system_library_names_its_remedy(monkeypatch):
    real = builtins.__import__

    def refuse(name, *args, **kwargs):
        if name == "open3d":
            raise ImportError("libusb-1.0.so.0: cannot open shared object file")
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(InputError, match=r"libusb-1.0.so.0.*apt-get install libusb-1.0-0 libgl1"):
        DepthRenderer(*wall(lambda x, y: 0.5))
