"""Renderers, scenes with the truth about them, and the network that learns from these."""

import builtins
import math

import numpy as np
import pytest
from cloths import varied_camera, waves
from safetensors.torch import load_file

from common.errors import InputError
from data.dataset import cloth, learning
from data.dataset.cloth import ClothNetwork
from data.dataset.off_axis import silhouette
from data.pictures.cut import BUNDLED, SIDES, cut_cloth, outline_of_cloth
from data.pictures.reading import Photograph, decoded
from data.render import cloth_scenes, textures
from data.render.cameras import Camera, nominal_camera
from data.render.hard import HARD
from data.render.phone import exposed
from data.render.raster import draw, rasterise
from data.render.rays import DepthRenderer
from data.render.scenery import Lamp, Scenery
from data.render.scenes import CLUTTER, raw_scene
from data.render.shade import shade
from sim.draping import drape
from sim.material import Fabric
from sim.mesh import grid_faces
from sim.rig import DISC_RIG, Rig
from sim.scene import make_specimen

HEIGHT, WIDTH = 90, 120
CAMERA = Camera(150.0, 140.0, 59.5, 44.5, WIDTH, HEIGHT, world_to_camera=np.eye(4))
"""Camera axes equal to world axes: x right, y down, z ahead."""
TURNS = np.radians([0.0, 83.0, 184.0, 271.0])
PLATE_HEIGHT, ABOVE = 0.15, 0.8  # m, of the plate, and of the camera above it
COUNT, HALF = 420, 0.19  # pixels, and m from the middle to the picture's border


def raster(points, faces, dtype=np.float64):
    """A picture (H, W) of a mesh in camera axes."""
    intrinsics = np.array([CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy], dtype)
    return draw(np.asarray(points, dtype)[None], np.asarray(faces), intrinsics, HEIGHT, WIDTH)[0]


def rays(points, faces):
    return DepthRenderer(np.asarray(points), np.asarray(faces)).view(CAMERA)


both = pytest.mark.parametrize(("method", "tolerance"), [(raster, 1e-13), (rays, 1e-5)])


def wall(depth_of, extent: float = 0.35):
    """A rectangle larger than the picture, z = depth_of(x, y)."""
    corners = [(-extent, -extent), (extent, -extent), (extent, extent), (-extent, extent)]
    return [(x, y, depth_of(x, y)) for x, y in corners], [[0, 1, 2], [0, 2, 3]]


def test_both_renderers_give_the_same_pictures():
    rng, pixels, beside, errors = np.random.default_rng(5), 0, 0, []
    for k in range(6):
        mesh = make_specimen(Rig(), edge=0.008, topology=k).mesh
        positions, faces = waves(mesh.rest, folds=5 + k, depth=0.05), mesh.faces
        camera, angles = varied_camera(rng).resized(WIDTH, HEIGHT), rng.uniform(0, 2 * np.pi, 4)
        views = rasterise(positions, faces, camera, angles)
        cast = DepthRenderer(positions, faces).views(camera, 0.0, angles)
        assert views.dtype == cast.dtype == np.float32
        cloth = (views > 0) & (cast > 0)
        pixels, beside = pixels + cloth.sum(), beside + ((views > 0) != (cast > 0)).sum()
        errors.append(np.abs(views - cast)[cloth])
    error = np.concatenate(errors)
    assert pixels > 24 * 1000
    # Pixels on an edge may go either way in single precision.
    assert beside <= 3 and (error > 1e-5).sum() <= 3
    assert np.sqrt(np.square(error[error < 1e-3]).mean()) < 1e-6


@both
def test_a_slanted_plane_is_exact_at_pixel_centres(method, tolerance):
    view = method(*wall(lambda x, y: 0.5 + 0.6 * x - 0.4 * y))
    row, column = np.mgrid[:HEIGHT, :WIDTH]
    x, y = (column - CAMERA.cx) / CAMERA.fx, (row - CAMERA.cy) / CAMERA.fy
    # z-depth: along the ray the corner would be 10 % farther away.
    assert np.abs(view - 0.5 / (1 - 0.6 * x + 0.4 * y)).max() < tolerance


@both
@pytest.mark.parametrize("edge", [49.9, 50.1])
def test_an_edge_covers_the_pixels_whose_centres_it_passes(method, tolerance, edge):
    x, y = (edge - CAMERA.cx) / CAMERA.fx * 0.5, (edge - CAMERA.cy) / CAMERA.fy * 0.5
    view = method([[x, -1, 0.5], [-1, -1, 0.5], [-1, y, 0.5], [x, y, 0.5]], [[0, 1, 2], [0, 2, 3]])
    expected = np.zeros((HEIGHT, WIDTH), bool)
    expected[: math.floor(edge) + 1, : math.floor(edge) + 1] = True
    assert ((view > 0) == expected).all()


@both
def test_both_sides_of_the_cloth_are_seen_and_the_nearer_one_wins(method, tolerance):
    front, faces = wall(lambda x, y: 0.4)
    back, _ = wall(lambda x, y: 0.6)
    for winding in (faces, [face[::-1] for face in faces]):
        order = np.concatenate([winding, np.array(winding) + 4])
        for points in ([*front, *back], [*back, *front]):
            assert np.abs(method(points, order) - 0.4).max() < tolerance


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_mesh_has_no_cracks(dtype):
    rng = np.random.default_rng(2)
    for size in (4, 40, 150):
        shape = (size, size)
        points = np.stack(np.meshgrid(*2 * [np.linspace(-0.3, 0.3, size)], indexing="ij"), -1)
        points = points + rng.uniform(-0.3, 0.3, points.shape) * 0.6 / size
        depth = 0.5 + 0.05 * rng.uniform(-1, 1, shape) / size
        faces = grid_faces(rng.random((size - 1, size - 1)) < 0.5)
        cloth = np.concatenate([points, depth[..., None]], -1).reshape(-1, 3)
        view = raster(cloth, faces, dtype)[5:-5, 5:-5]
        assert (view > 0).all()
        assert np.abs(view - 0.5).max() < 0.06 / size
    row, column = np.mgrid[: HEIGHT : 2, : WIDTH : 3]  # corners on pixel centres
    points = np.stack([(column - CAMERA.cx) / CAMERA.fx, (row - CAMERA.cy) / CAMERA.fy,
                       np.ones(row.shape)], -1) * 0.5
    faces = grid_faces(rng.random((row.shape[0] - 1, row.shape[1] - 1)) < 0.5)
    view = raster(points.reshape(-1, 3), faces, dtype)
    assert (view[1 : row.max(), 1 : column.max()] > 0).all()


def test_triangles_behind_the_camera_or_not_finite_are_omitted():
    points, faces = wall(lambda x, y: 0.5)
    behind, _ = wall(lambda x, y: -0.5)
    assert not raster(behind, faces).any() and not rays(behind, faces).any()
    half = raster(points[:3], faces[:1])
    for wrong in ((0.0, 0.0, -0.1), (0.0, 0.0, 0.0), (math.nan, 0.0, 0.5), (0.0, 0.0, math.inf)):
        assert np.array_equal(raster([*points[:3], wrong], faces), half)


def marker_places(*centre: float) -> np.ndarray:
    """Mean column, row and depth (4, 3) of a small octahedron in the four views of a capture."""
    corners = 0.01 * np.vstack([np.eye(3), -np.eye(3)]) + centre
    faces = np.array([(a, b, c) for a in (0, 3) for b in (1, 4) for c in (2, 5)])
    views = DepthRenderer(corners, faces).views(nominal_camera())
    return np.array([[*np.argwhere(view).mean(axis=0)[::-1], view[view > 0].mean()]
                     for view in views])


def test_right_is_right_up_is_up_and_away_is_deeper():
    origin, right, up, away = (marker_places(*centre)[0] for centre in (
        (0, 0, 0), (0.08, 0, 0), (0, 0, 0.08), (0, 0.08, 0)))
    assert origin[0] == pytest.approx(119.5, abs=0.6)
    assert right[0] - origin[0] > 35 and abs(right[1] - origin[1]) < 1
    assert abs(up[0] - origin[0]) < 1 and up[1] - origin[1] < -25
    assert abs(away[0] - origin[0]) < 1 and away[1] < origin[1] and away[2] > origin[2] + 0.04
    # The table turns counter-clockwise: a marker on the right goes to the back, the left, the front
    columns, _, depth = marker_places(0.08, 0, 0).T
    assert columns[0] > 155 and columns[2] < 85
    assert columns[[1, 3]] == pytest.approx([119.5, 119.5], abs=1)
    assert depth[1] - depth[3] == pytest.approx(0.16 * math.cos(math.radians(38)), abs=0.003)


def test_a_missing_system_library_names_its_remedy(monkeypatch):
    real = builtins.__import__

    def refuse(name, *args, **kwargs):
        if name == "open3d":
            raise ImportError("libusb-1.0.so.0: cannot open shared object file")
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(InputError, match=r"libusb-1.0.so.0.*apt-get install libusb-1.0-0 libgl1"):
        rays(*wall(lambda x, y: 0.5))


SIZE = (60, 50)
OPTIONS = {"plate_radius": 0.01, "size": SIZE, "supersampling": 2}


def shaded_place(x: float, y: float, z: float, **options: float) -> np.ndarray:
    """Column and row, from the picture's middle, of a triangle in a shaded picture."""
    corners = [(x - 0.03, y - 0.03, z), (x + 0.03, y - 0.03, z), (x, y + 0.06, z)]
    far = [(9.0, 0.0, 0.0), (9.1, 0.0, 0.0), (9.0, 0.1, 0.0)]  # shadows follow the extent
    shown, hidden = (shade(np.array([*corners, *far]), np.array(faces), **OPTIONS, **options)
                     for faces in ([[0, 1, 2], [3, 4, 5]], [[3, 4, 5]]))
    assert shown.shape == (SIZE[1], SIZE[0], 3) and shown.dtype == np.uint8
    return np.argwhere((shown != hidden).any(axis=2)).mean(axis=0)[::-1] - (
        (SIZE[0] - 1) / 2, (SIZE[1] - 1) / 2)


def test_shaded_pictures_show_x_to_the_right_y_or_z_upwards_and_both_sides():
    right, row = shaded_place(0.12, 0.0, 0.0, elevation=90.0)
    column, up = shaded_place(0.0, 0.12, 0.0, elevation=90.0)
    assert right > 12 and abs(row) < 3 and up < -12 and abs(column) < 1
    assert shaded_place(0.12, 0.0, 0.0)[0] > 12
    high, low = (shaded_place(0.0, 0.0, z)[1] for z in (0.05, -0.10))
    # 0.15 m at 25 degrees, 150 pixels a metre.
    assert abs((low - high) - 0.15 * np.cos(np.radians(25)) * 150) < 1.5
    corners = np.array([(-0.03, -0.03, 0.0), (0.03, -0.03, 0.0), (0.0, 0.06, 0.0)])
    above, below = (shade(corners, np.array([face]), elevation=90.0, **OPTIONS)
                    for face in ((0, 1, 2), (0, 2, 1)))
    assert np.array_equal(above, below) and len(np.unique(above)) > 2  # both sides are lit


def scene(skirted, seed=0, **settings):
    return raw_scene(skirted.positions, skirted.faces, np.random.default_rng(seed), rig=Rig(),
                     turns=TURNS, **settings)


def test_cloth_is_what_changes_and_lies_before_everything_else(skirted):
    seen = scene(skirted, sensor="none")
    assert seen.frames.shape == (4, 180, 240) and (seen.frames > 0).mean() > 0.9
    assert np.array_equal(seen.frames[seen.cloth], seen.clean[seen.cloth])
    nothing = np.broadcast_to(seen.background, seen.frames.shape)
    assert np.array_equal(seen.frames[~seen.cloth], nothing[~seen.cloth])
    known = seen.cloth & (nothing > 0)
    assert (seen.frames[known] <= nothing[known]).all()
    # Nothing stands between the camera and the cloth.
    assert (seen.cloth == (seen.clean > 0)).all()


def test_the_table_lies_as_far_below_the_plate_as_is_said(skirted):
    seen = scene(skirted, sensor="none", clutter="empty")
    pose = seen.camera.world_to_camera
    points = (seen.camera.back_project(seen.background) - pose[:3, 3]) @ pose[:3, :3]
    near = (points[..., 1] < 0.3) & (np.hypot(points[..., 0], points[..., 1]) > 0.06)
    near &= seen.background > 0
    assert near.sum() > 1000
    assert np.allclose(points[near][:, 2], seen.table, atol=1e-4)


def test_clutter_fills_the_scene_and_the_seed_decides(skirted):
    shares = []
    for name in CLUTTER:
        empty, full = (scene(skirted, sensor="none", clutter=one) for one in ("empty", name))
        shares.append((empty.background != full.background).mean())
    assert shares[0] == 0 and shares[2] > 0.05
    assert np.array_equal(scene(skirted, seed=3).frames, scene(skirted, seed=3).frames)


@pytest.mark.parametrize("sensor", ["smooth", "paper"])
def test_the_label_goes_through_the_sensor_with_the_depth(skirted, sensor):
    seen = scene(skirted, sensor=sensor, clutter="empty")
    # It is displaced with the picture: a label left where it was would be wrong at silhouettes.
    pose = seen.camera.world_to_camera
    height = ((seen.camera.back_project(seen.frames) - pose[:3, 3]) @ pose[:3, :3])[..., 2]
    assert (height[seen.cloth] > seen.table + 0.03).mean() > 0.999
    assert (seen.cloth != (seen.clean > 0)).any()


@pytest.fixture(scope="module")
def shape():
    return drape(Fabric(alpha=[25e-6, 18e-6, 20e-6], beta=[-20e-9] * 3, density=0.15),
                 rig=DISC_RIG, edge=9e-3)


def photographed(shape, surface, table, *, lamp: float = 1.0, seed: int = 0) -> Photograph:
    """A picture from straight above, a lamp at the side, on a plain table without a mat."""
    rng = np.random.default_rng(seed)
    random = Scenery.random(
        shape.positions + np.array([0, 0, PLATE_HEIGHT]), shape.rest, shape.faces, rng, mat=None,
        plate_radius=DISC_RIG.plate_radius, plate_height=PLATE_HEIGHT, clutter=False,
        surface=textures.plain(surface, rng, depth=0.0))
    plain = Scenery(random.cloth, random.rest, random.faces, random.surface,
                    textures.plain(table, rng, depth=0.02), None, (0.04, 0.85), np.ones(3),
                    random.things, [Lamp(np.array([0.8, 0.3, 1.2]), 0.1, lamp)])
    steps = (np.arange(COUNT) - (COUNT - 1) / 2) * (2 * HALF / COUNT)
    plane = np.dstack([*np.meshgrid(steps, -steps), np.full((COUNT, COUNT), PLATE_HEIGHT)])
    eye = np.array([0, 0, PLATE_HEIGHT + ABOVE])
    rays = (plane - eye) / np.linalg.norm(plane - eye, axis=2, keepdims=True)
    light, _ = plain.seen(eye, rays, rng)
    return Photograph(decoded(exposed(light, rng, blur=0.8) / 255.0),
                      np.zeros((COUNT, COUNT), bool))


def place() -> dict:
    pixel = 2 * HALF / COUNT
    middle = (COUNT - 1) / 2
    return {"to_pixels": np.array([[1 / pixel, 0, middle], [0, -1 / pixel, middle], [0, 0, 1.0]]),
            "plate": DISC_RIG.plate_radius, "reach": DISC_RIG.reach, "known": True}


@pytest.mark.parametrize(("surface", "table"), [
    (np.array([0.5, 0.1, 0.1]), 0.7), (0.03, 0.6), (0.8, 0.15)], ids=["red", "black", "white"])
def test_the_hem_of_rendered_cloth_is_exact_to_half_a_millimetre(shape, surface, table):
    """Along azimuths from the middle."""
    cut = outline_of_cloth(photographed(shape, surface, table), **place())
    x, y = ((cut.hem - (COUNT - 1) / 2) * [1, -1] * (2 * HALF / COUNT)).T
    true = silhouette(shape.positions, shape.mesh.edges, np.zeros(2), ABOVE, azimuths=720)
    at = np.interp(np.arctan2(y, x), np.arange(720) * (np.pi / 360), true, period=2 * np.pi)
    off = 1e3 * (np.hypot(x, y) - at)
    assert np.sqrt(np.square(off).mean()) < 0.5 and np.abs(off).max() < 3
    steps = np.linalg.norm(np.diff(cut.hem, axis=0), axis=1)
    assert 0.6 < steps.mean() < 1.4 and (cut.error > 0).all()


def test_what_hides_the_hem_makes_its_error_larger(shape):
    clear, alike = (photographed(shape, 0.4, table, lamp=0.0) for table in (0.05, 0.4))
    known = outline_of_cloth(clear, **place())
    try:
        doubtful = cut_cloth(alike, **place())
    except InputError as error:
        assert "differs from its ground" in str(error)
    else:
        assert np.quantile(doubtful.error, 0.9) > 2 * np.quantile(known.error, 0.9)


def test_a_plate_that_is_larger_than_its_picture_is_refused(shape):
    where = place()
    where["to_pixels"] = where["to_pixels"] @ np.diag([3, 3, 1.0])
    with pytest.raises(InputError, match="pixels of the file, more than"):
        cut_cloth(photographed(shape, 0.4, 0.1), **where)


@pytest.mark.parametrize("kind", HARD)
def test_a_scene_that_is_hard_shows_the_same_specimen_otherwise(shape, kind):
    rng = np.random.default_rng(4)
    scenery = Scenery.random(
        shape.positions + np.array([0, 0, PLATE_HEIGHT]), shape.rest, shape.faces, rng, mat="a2",
        plate_radius=DISC_RIG.plate_radius, plate_height=PLATE_HEIGHT, clutter=False, ground="code")
    steps = np.linspace(-0.25, 0.25, 100)
    plane = np.dstack([*np.meshgrid(steps, -steps), np.full((100, 100), PLATE_HEIGHT)])
    eye = np.array([0, 0, PLATE_HEIGHT + ABOVE])
    rays = (plane - eye) / np.linalg.norm(plane - eye, axis=2, keepdims=True)
    seen, changed = (one.seen(eye, rays, np.random.default_rng(0)) for one in (
        scenery, HARD[kind](scenery, DISC_RIG.reach, rng)))
    np.testing.assert_array_equal(seen[1], changed[1])
    assert np.abs(seen[0] - changed[0]).max() > 0.1


def test_textures_are_albedo_and_repeat_with_their_seed():
    places = np.random.default_rng(0).uniform(-0.2, 0.2, (500, 2))
    for make in (lambda rng: textures.cloth(rng)[1], textures.table):
        for seed in range(12):
            one, again = (make(np.random.default_rng(seed))(places) for _ in range(2))
            assert one.shape == (500, 3) and (one > 0).all() and (one < 1).all()
            np.testing.assert_array_equal(one, again)
    picture = np.zeros((4, 6, 3)) + np.arange(6)[:, None] / 10 + 0.1
    mirrored = textures.of_picture(picture, 1e-3)(np.array([[0.5e-3, 0], [-0.5e-3, 0]]))
    np.testing.assert_allclose(mirrored[0], mirrored[1])


def test_the_network_is_trained_alike_twice_and_stored_small(cloth_dataset, tmp_path, capsys,
                                                             monkeypatch):
    files = [tmp_path / name for name in ("first.safetensors", "second.safetensors")]
    monkeypatch.setattr(cloth_scenes, "_TIMES", 1)  # coarse pictures, fast
    for file in files:
        cloth.main([f"data={cloth_dataset}", f"pictures={tmp_path / 'pictures'}", f"out={file}",
                    "shards=2", "scenes=1", "epochs=2", "workers=1"])
        # A graph takes seconds; once is enough.
        monkeypatch.setattr(learning, "save_graph", lambda *_, **__: None)
    assert files[0].read_bytes() == files[1].read_bytes()
    assert len(files[0].read_bytes()) == len(BUNDLED[SIDES[True]].read_bytes()) < 2_000_000
    ClothNetwork().load_state_dict(load_file(files[0]), strict=False)
    assert "of 2 shards are finished" in capsys.readouterr().out
