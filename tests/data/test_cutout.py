"""Raw frames: cloth cut out of them, and recordings of depth cameras."""

import sqlite3
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import OpenEXR
import pytest
import trimesh
import yaml
from cloths import skirt
from matplotlib.colors import to_rgb
from PIL import Image
from turntable import (
    FILE,
    camera_info,
    counts16,
    metres,
    packed,
    turntable,
    write_bag,
    write_bag2,
)
from vectors import angle_between

import data.captures.frames
import data.captures.preview
from apps.capture import main
from common.errors import InputError
from data.captures.cutout import cut_out
from data.captures.depth import Lens, median_depth
from data.captures.description import Description
from data.captures.frames import read_frames
from data.captures.reader import read_capture
from data.captures.rosbag import find_rests, read_recording, recordings
from data.render.scenes import RawScene, raw_scene
from sim.rig import DISC_RIG, Rig

DESCRIPTION = Description(density_g_m2=150.0)
TURNS = np.radians([0.0, 83.0, 184.0, 271.0])


def seen(rig: Rig, seed: int, **settings) -> RawScene:
    drape = skirt(rig=rig)
    return raw_scene(drape.positions, drape.faces, np.random.default_rng(seed), rig=rig,
                     turns=TURNS, **settings)


@pytest.fixture(scope="module")
def scene() -> RawScene:
    """Seen by a time-of-flight camera."""
    return seen(Rig(), 4, sensor="tof")


def overlaps(masks: np.ndarray, truth: np.ndarray) -> np.ndarray:
    return (masks & truth).sum(axis=(1, 2)) / (masks | truth).sum(axis=(1, 2))


@pytest.mark.parametrize("rig", [Rig(), DISC_RIG], ids=lambda rig: rig.specimen)
@pytest.mark.parametrize("sensor, clutter", [("none", "empty"), ("smooth", "full"),
                                             ("tof", "some")])
def test_masks_and_plate_are_those_of_the_scene(rig, sensor, clutter):
    scene = seen(rig, 1, sensor=sensor, clutter=clutter)
    cut = cut_out(scene.frames, scene.camera.intrinsics, rig)
    assert overlaps(cut.masks, scene.cloth).min() > 0.98
    pose = scene.camera.world_to_camera
    assert np.degrees(angle_between(cut.plate.normal, pose[:3, 2])) < 0.5
    error = cut.plate.axis_centre - pose[:3, 3]
    along = error @ pose[:3, 3] / np.linalg.norm(pose[:3, 3])
    # A sensor's depth may be wrong by millimetres; across the line of sight the plate is not.
    assert np.sqrt(error @ error - along**2) < 3e-3 and abs(along) < 0.012
    assert cut.plate.table @ [*cut.plate.centre, 1] == pytest.approx(-scene.table, abs=3e-3)
    assert ((cut.views > 0) <= cut.masks).all()
    assert np.array_equal(cut.views[cut.views > 0], scene.frames[cut.views > 0])


def test_the_column_is_measured_and_removed():
    scene = seen(Rig(), 3, sensor="none", clutter="empty", column=0.03)
    camera = scene.camera
    pose = camera.world_to_camera
    points = (camera.back_project(scene.frames) - pose[:3, 3]) @ pose[:3, :3]
    column = (np.hypot(points[..., 0], points[..., 1]) < 0.032) & ~scene.cloth & (
        points[..., 2] < -0.02) & (points[..., 2] > -0.16)
    assert column.sum() > 500  # within the cloth's reach
    cut = cut_out(scene.frames, camera.intrinsics, Rig())
    assert cut.column == pytest.approx(0.03, abs=2e-3)
    assert not (cut.masks & column).any()


def test_the_empty_scene_helps_and_a_moved_camera_is_reported(scene):
    intrinsics = scene.camera.intrinsics
    cut = cut_out(scene.frames, intrinsics, Rig(), scene.background)
    assert overlaps(cut.masks, scene.cloth).min() > 0.98 and not cut.warnings
    moved = np.roll(scene.background, 60, axis=0) + 0.1
    assert any(doubt.code.startswith("background_")
               for doubt in cut_out(scene.frames, intrinsics, Rig(), moved).warnings)
    draped = cut_out(scene.frames, intrinsics, Rig(), scene.frames[1])
    assert "background_with_cloth" in [doubt.code for doubt in draped.warnings]


def test_what_is_cut_out_stays_as_it_is(scene):
    cloth = np.where(scene.cloth, scene.frames, 0).astype(np.float32)
    assert cut_out(cloth, scene.camera.intrinsics, Rig()) is None


def test_scenes_without_a_plate_are_refused(scene):
    empty = np.repeat(scene.background[None], 2, axis=0)
    intrinsics = scene.camera.intrinsics
    with pytest.raises(InputError, match="no plate of 180 mm diameter with cloth"):
        cut_out(np.full_like(scene.frames, 0.7), intrinsics, DISC_RIG)
    with pytest.raises(InputError, match="no plate of 100 mm diameter with cloth"):
        cut_out(empty, intrinsics, Rig())
    mixed = scene.frames.copy()
    mixed[1][~scene.cloth[1]] = 0
    with pytest.raises(InputError, match="view 0 shows the whole scene"):
        cut_out(mixed, intrinsics, Rig())


@pytest.fixture
def folder(tmp_path, scene) -> Path:
    """A capture of raw frames, without the frames."""
    path = tmp_path / "raw"
    path.mkdir()
    numbers = {key: float(getattr(scene.camera, key)) for key in ("fx", "fy", "cx", "cy")}
    text = yaml.safe_dump({"density_g_m2": 150, "intrinsics": numbers, "size_px": [240, 180],
                           "tester": "square300_cylinder100"})
    (path / "capture.yaml").write_text(text)
    return path


def save(depth: np.ndarray, file: Path) -> None:
    Image.fromarray(np.rint(depth * 1e3).astype(np.uint16)).save(file)


def test_raw_frames_become_a_capture_and_its_picture(folder, scene, tmp_path, capsys):
    for k, frame in enumerate(scene.frames):
        save(frame, folder / f"view_{k}.png")
    capture = read_capture(folder)
    expected = cut_out(scene.frames, scene.camera.intrinsics, Rig())
    both = (capture.views > 0) & (expected.views > 0)
    assert np.abs(capture.views - expected.views)[both].max() < 0.6e-3
    # Isolated depths are left out, too.
    assert both.sum() > 0.99 * (expected.views > 0).sum() and capture.cut is not None
    with pytest.raises(InputError, match=r"1 of 14 checks of .* failed; docs/rig\.md lists"):
        main([f"frames={folder}", f"out={tmp_path / 'out'}"])  # the skirt is stretched
    again = read_capture(tmp_path / "out")
    assert again.cut is None and np.abs(again.views - capture.views).max() < 0.06e-3
    with Image.open(tmp_path / "out" / "capture.png") as picture:
        assert picture.size == (960, 1080)
        below = np.asarray(picture.convert("RGB"), int)[720:]
    printed = capsys.readouterr().out
    assert "warning: the specimen measures 26" in printed and "plate: 98 mm" in printed
    for colour in (data.captures.preview._SOUND, data.captures.preview._FAULTY):
        assert shares(below[:, 480:], colour) > 3e-4
    for colour in data.captures.preview._VIEWS[:4]:
        assert shares(below[:, 150:480], colour) > 8e-4
    assert "capture.png" in printed


def shares(picture: np.ndarray, colour: str) -> float:
    """Share of a picture's pixels that have a colour."""
    return (np.abs(picture - 255 * np.array(to_rgb(colour))) < 12).all(axis=2).mean()


def test_a_sound_capture_is_green_in_the_picture(tmp_path, capsys):
    twill = Path(__file__).parents[2] / "examples" / "captures" / "twill"
    main([f"frames={twill}", f"out={tmp_path / 'out'}"])
    printed = capsys.readouterr().out
    assert "specimen: 312 mm (stated: 300)" in printed and "warning" not in printed
    with Image.open(tmp_path / "out" / "capture.png") as picture:
        cell = np.asarray(picture.convert("RGB"), int)[720:, 480:]
    assert shares(cell, data.captures.preview._SOUND) > 3e-4
    assert shares(cell, data.captures.preview._FAULTY) == 0
    assert read_capture(tmp_path / "out").labels == read_capture(twill).labels


def test_a_faulty_capture_is_red_in_the_picture_and_refused(folder, scene, tmp_path, capsys):
    for k, frame in enumerate(scene.frames[[0, 2, 1, 3]]):
        save(frame, folder / f"view_{k}.png")
    out = tmp_path / "out"
    with pytest.raises(InputError, match="2 of 14 checks"):
        main([f"frames={folder}", f"out={out}"])
    assert "if views 1 and 2 are swapped" in capsys.readouterr().out
    # Another tester than the stated one is refused, and the picture shows what was read.
    describe = yaml.safe_load((folder / "capture.yaml").read_text())
    (folder / "capture.yaml").write_text(yaml.safe_dump(
        describe | {"tester": {"specimen": "square", "size_mm": 400, "plate_mm": 100}}))
    with pytest.raises(InputError, match="the specimen measures "):
        main([f"frames={folder}", f"out={tmp_path / 'large'}"])
    assert (tmp_path / "large" / "capture.png").exists()


def test_the_hem_of_a_disc_is_its_circle_on_the_side_of_the_camera():
    grid = np.stack(np.meshgrid(*[np.linspace(-0.15, 0.15, 301)] * 2), axis=-1).reshape(-1, 2)
    disc = grid[np.linalg.norm(grid, axis=1) <= 0.15]
    line = data.captures.preview._hem(disc, towards=np.pi)
    assert np.linalg.norm(line, axis=1) == pytest.approx(0.15, abs=2e-3)
    away = np.degrees(np.arctan2(line[:, 1], -line[:, 0]))
    assert [away.min(), away.max()] == pytest.approx([-75, 75], abs=3)
    # A notch that no point is seen in parts the line.
    notched = disc[np.abs(np.arctan2(disc[:, 1], -disc[:, 0])) > np.radians(8)]
    assert np.isnan(data.captures.preview._hem(notched, towards=np.pi)).all(axis=1).sum() == 1


def test_several_frames_of_a_view_give_their_median_without_holes(folder, scene):
    rng = np.random.default_rng(0)
    for k, frame in enumerate(scene.frames):
        for j, step in enumerate((-0.002, 0.0, 0.005)):
            holes = rng.random(frame.shape) < 0.1
            save(np.where(holes | (frame == 0), 0, frame + step), folder / f"view_{k}_{j}.png")
    frames = data.captures.frames.read_frames(folder, DESCRIPTION).depth
    known = scene.frames > 0
    error = (frames - scene.frames)[known & (frames > 0)]
    assert (frames > 0)[known].mean() > 0.998 and (frames[~known] == 0).all()
    assert np.median(np.abs(error)) < 0.6e-3 and np.abs(error).max() < 6e-3


def test_arrays_and_points_give_the_same_depth(folder, scene):
    points = scene.camera.back_project(scene.frames)
    rng = np.random.default_rng(0)
    for k, frame in enumerate(scene.frames):
        np.save(folder / f"view_{k}.npy", np.where(frame > 0, frame, np.nan))
        cloud = trimesh.PointCloud(rng.permutation(points[k][frame > 0]))
        cloud.export(folder / f"view_{k}.ply")
    assert np.array_equal(data.captures.frames.read_array(folder / "view_0.npy"), scene.frames[0])
    pixels = np.where(scene.frames[0] > 0, scene.frames[0], np.inf).astype(np.float32)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    for channels in ({"Z": pixels, "A": 0 * pixels}, {"Y": pixels}):
        OpenEXR.File(header, channels).write(str(folder / "one.exr"))
        assert np.array_equal(data.captures.frames.read_exr(folder / "one.exr"), scene.frames[0])
    OpenEXR.File(header, {"R": pixels, "G": pixels}).write(str(folder / "one.exr"))
    with pytest.raises(InputError, match="give depth as channel Z"):
        data.captures.frames.read_exr(folder / "one.exr")
    depth = data.captures.frames.read_points(folder / "view_0.ply", scene.camera.intrinsics)
    assert np.abs(depth - scene.frames[0]).max() < 1e-6
    for file in folder.glob("*.npy"):
        file.unlink()
    capture = read_capture(folder)
    assert overlaps(capture.views > 0, scene.cloth).min() > 0.9


@pytest.fixture(scope="module")
def table() -> tuple:
    return turntable()


def assert_stops(frames: np.ndarray, stops: np.ndarray) -> None:
    assert frames.shape == stops.shape
    assert np.abs(frames * 1e3 - stops).max() < 1e-3  # no hole, no frame of a movement


def test_stops_of_a_bag(table, tmp_path):
    shown, stops, intrinsics = table
    write_bag(tmp_path / "a.bag", shown, intrinsics)
    frames, *camera = read_recording([tmp_path / "a.bag"])
    assert_stops(frames, stops)
    assert camera == [intrinsics, None]
    write_bag(tmp_path / "b.bag", shown, intrinsics, unit=5e-4)
    assert np.allclose(read_recording([tmp_path / "b.bag"])[0], frames / 2)
    assert np.allclose(read_recording([tmp_path / "b.bag"], 1e-3)[0], frames)


def test_stops_of_a_file_that_librealsense_recorded(table):
    _, stops, intrinsics = table
    frames, found, lens = read_recording([FILE])
    assert_stops(frames, stops)
    assert lens is None
    assert found.fx == pytest.approx(intrinsics.fx, rel=1e-6)
    assert found.cy == pytest.approx(intrinsics.cy, rel=1e-6)


def test_a_folder_with_a_recording_is_a_capture(table, tmp_path):
    shown, stops, intrinsics = table
    write_bag(tmp_path / "take.bag", shown, intrinsics)
    (tmp_path / "capture.yaml").write_text("density_g_m2: 150\ntester: square300_cylinder100\n")
    capture = read_capture(tmp_path)
    assert capture.views.shape == stops.shape and capture.intrinsics == intrinsics
    assert capture.cut is not None and (capture.views > 0).mean() < 0.5
    (tmp_path / "view_0.png").touch()
    with pytest.raises(InputError, match=r"holds view_0.png and take.bag"):
        read_capture(tmp_path)


def read_folder(folder: Path, **keys: object) -> tuple:
    return read_recording(recordings(folder), **keys)


RECTIFIED = "/camera/depth/image_rect_raw"


@pytest.mark.parametrize(("topic", "fields", "tolerance_mm"), [
    (RECTIFIED, counts16, 1e-3), ("/oak/stereo/image_raw", counts16, 1e-3),
    ("/camera/depth/image", metres, 1e-3),
    ("/camera/depth/image/compressedDepth", packed("16UC1", "png"), 1e-3),
    ("/camera/depth/image/compressedDepth", packed("16UC1", "rvl"), 1e-3),
    ("/camera/depth/image/compressedDepth", packed("32FC1", "png"), 15.0),
    ("/camera/depth/image/compressedDepth", packed("32FC1", "rvl"), 15.0)])
def test_depth_of_every_kind_is_read(table, tmp_path, topic, fields, tolerance_mm):
    shown, stops, intrinsics = table
    still = shown[:8].copy()
    still[:, 0, :3] = 65535  # saturated
    write_bag2(tmp_path / "rec", {topic: (still, fields, camera_info(intrinsics)),
                                  "/camera/infrared/image": (still, counts16, None)})
    frames, *camera = read_folder(tmp_path)
    expected = stops[:1].astype(float)
    expected[:, 0, :3] *= fields is packed
    assert np.abs(1e3 * frames - expected)[:, 1:].max() < tolerance_mm
    assert camera == [intrinsics, None]


@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
@pytest.mark.parametrize("compression", ["", "file", "message"])
def test_folders_of_ros_2_are_read_compressed_or_not(table, tmp_path, storage, compression):
    shown, stops, intrinsics = table
    if storage == "mcap" and compression == "message":
        pytest.skip("no such bags are written")
    write_bag2(tmp_path / "rec", {RECTIFIED: (shown, counts16, camera_info(intrinsics))},
               storage=storage, compression=compression)
    assert_stops(read_folder(tmp_path)[0], stops)  # the bag is a folder of the capture
    assert_stops(read_folder(tmp_path / "rec")[0], stops)  # it is the capture
    (tmp_path / "rec" / "metadata.yaml").unlink()
    if compression:
        message = "put the metadata.yaml" if compression == "file" else "cannot be read"
        with pytest.raises(InputError, match=message):
            read_folder(tmp_path / "rec")
    else:
        assert_stops(read_folder(tmp_path / "rec")[0], stops)


def test_the_parts_of_a_split_recording_are_joined_and_two_recordings_refused(table, tmp_path):
    shown, stops, intrinsics = table
    for k, part in enumerate(np.split(shown, [20])):
        write_bag(tmp_path / f"take_{k}.bag", part, intrinsics, start=20 * k)
    assert_stops(read_folder(tmp_path)[0], stops)
    (tmp_path / "take_1.bag").rename(tmp_path / "second.bag")
    with pytest.raises(InputError, match=r"holds second\.bag and take_0\.bag: give one"):
        read_folder(tmp_path)


ALIGNED = "/camera/aligned_depth_to_color/image_raw"
BENT = (0.1, -0.05, 0.001, 0.0, 0.0)


def bent(frames: np.ndarray, camera: object, lens: tuple[float, ...]) -> np.ndarray:
    """``frames`` as a lens distorts them."""
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    grid = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), -1)
    straight = cv2.undistortPoints(grid.reshape(-1, 1, 2).astype(float), matrix, np.array(lens),
                                   P=matrix).reshape(grid.shape).astype(np.float32)
    return np.stack([cv2.remap(frame, *np.moveaxis(straight, 2, 0), cv2.INTER_NEAREST)
                     for frame in frames])


def test_undistorted_depth_is_preferred_to_aligned_depth_of_a_bent_lens(table, tmp_path):
    shown, stops, intrinsics = table
    other = replace(intrinsics, fx=2 * intrinsics.fx)
    wrong = np.zeros_like(shown[:8]) + 300
    good = {RECTIFIED: (shown[:8], counts16, camera_info(intrinsics))}
    write_bag2(tmp_path / "both", {ALIGNED: (wrong, counts16, camera_info(other, lens=BENT)),
                                   **good})
    write_bag2(tmp_path / "plain", {"/camera/aligned_depth/image": (
        wrong, counts16, camera_info(other)), **good})
    for name in ("both", "plain"):
        frames, *camera = read_folder(tmp_path / name)
        assert camera == [intrinsics, None]
        assert_stops(frames, stops[:1])


@pytest.mark.parametrize(("model", "lens"), [
    ("plumb_bob", (0.4, -0.1, 0.002, 0.0, 0.0)),
    ("rational_polynomial", (4.2836, 2.6819, 6e-5, -3e-5, 0.1372, 4.6148, 4.019, 0.7189))])
def test_a_bent_lens_is_undone(table, model, lens):
    _, stops, intrinsics = table
    distorted = bent(stops, intrinsics, lens).astype(np.float32)
    flat = np.stack([Lens.of(model, np.array(lens)).undistorted(frame, intrinsics)
                     for frame in distorted])
    inner = np.s_[:, 10:-10, 10:-10]
    off, was = ((np.abs(frames - stops) > 8.0)[inner].mean() for frames in (flat, distorted))  # mm
    assert off < 0.02 and was > 2 * off + 0.01


def test_a_recorded_lens_reaches_the_views(table, tmp_path):
    shown, _, intrinsics = table
    write_bag2(tmp_path / "rec", {ALIGNED: (shown[:8], counts16, camera_info(
        intrinsics, lens=BENT))})
    _, *camera = read_folder(tmp_path)
    assert camera == [intrinsics, Lens(BENT)]
    (tmp_path / "capture.yaml").write_text("density_g_m2: 150\ntester: square300_cylinder100\n")
    stated = intrinsics.fx * 1.001
    description = {key: getattr(intrinsics, key) for key in ("fy", "cx", "cy")} | {"fx": stated}
    flat = read_frames(tmp_path, Description.of({"density_g_m2": 150}, ""))
    assert flat.intrinsics == intrinsics
    plain = read_frames(tmp_path, Description.of(
        {"density_g_m2": 150, "intrinsics": description}, ""))
    assert plain.intrinsics.fx == stated  # overrides the recording's, with its lens
    again = read_frames(tmp_path, Description.of(
        {"density_g_m2": 150, "intrinsics": description | dict(
            zip(("k1", "k2", "p1", "p2", "k3"), BENT, strict=True))}, ""))
    assert np.abs(plain.depth - flat.depth).max() > 0.05
    assert (np.abs(again.depth - flat.depth) < 2e-3).mean() > 0.98


def test_the_projection_of_rectified_pictures_is_used(table, tmp_path):
    shown, _, intrinsics = table
    info = camera_info(replace(intrinsics, fx=90.0), lens=(0.7, 0, 0, 0, 0), projected=100.0)
    write_bag2(tmp_path / "rec", {"/depth/image_rect": (shown[:8], counts16, info)})
    _, camera, lens = read_folder(tmp_path)
    assert camera == replace(intrinsics, fx=100.0, fy=100.0) and lens is None


@pytest.mark.parametrize(("info", "message"), [
    ({"k": np.zeros(9)}, "no calibrated camera_info of the size of its pictures lies beside /cam"),
    ({"d": np.full(5, 0.2), "distortion_model": "fov"}, "lens model 'fov' with 5 coefficients up"),
    ({"height": 480, "width": 640}, "no calibrated camera_info of")])
def test_stated_intrinsics_replace_unusable_calibration(table, tmp_path, info, message):
    shown, stops, intrinsics = table
    write_bag2(tmp_path / "rec", {
        "/camera/depth/image": (shown[:8], counts16, camera_info(intrinsics) | info)})
    with pytest.raises(InputError, match=message):
        read_folder(tmp_path)
    frames, *camera = read_folder(tmp_path, calibrated=False)
    assert_stops(frames, stops[:1])
    assert camera == [None, None]


def test_what_a_recording_without_depth_holds_is_named(table, tmp_path):
    write_bag2(tmp_path / "rec", {"/camera/infra1/image": (table[0][:2], lambda frame: {
        "encoding": "mono16", "data": frame}, None)})
    with pytest.raises(InputError, match=r"no depth pictures \(it holds '/camera/infra1/image mo"):
        read_folder(tmp_path)


def test_rests_are_long_and_still():
    times = np.arange(40) / 10
    moved = np.full(40, 1e-3)
    moved[10:14], moved[25:27] = 0.2, 0.3
    assert find_rests(times, moved) == [(0, 9), (14, 24), (27, 39)]
    moved[17] = 0.1  # leaves 0.2 s before and 0.6 s after it
    assert find_rests(times, moved) == [(0, 9), (18, 24), (27, 39)]
    assert find_rests(times[:3], moved[:3]) == []


def test_the_median_leaves_out_what_was_not_seen():
    frames = np.array([[[0, 0, 5]], [[4, 0, 7]], [[8, 0, 6]], [[0, 0, 900]]], np.uint16)
    assert median_depth(frames).tolist() == [[6.0, 0.0, 6.5]]


def cut_short(file: Path, table: tuple) -> None:
    write_bag(file, table[0], table[2])
    file.write_bytes(file.read_bytes()[:5000])


def never_still(file: Path, table: tuple) -> None:
    rng = np.random.default_rng(0)
    frames = rng.integers(400, 900, (30, 90, 120)).astype(np.uint16)
    write_bag(file, frames, table[2])


@pytest.mark.parametrize(("name", "make", "message"), [
    ("a.bag", never_still, "0 stops of the table found"),
    ("a.bag", cut_short, "cannot be read"),
    ("a.bag", lambda file, table: write_bag(file, table[0][:0], table[2]), "no depth pictures"),
    ("a.db3", lambda file, table: sqlite3.connect(file).execute("create table a (b)"),
     "cannot be read"),
    ("a.bag", lambda file, table: write_bag(file, table[0][:, :20, :20], table[2]), "20x20 pixels"),
])
def test_bad_recordings_are_refused_in_one_line(table, tmp_path, name, make, message):
    make(tmp_path / name, table)
    with pytest.raises(InputError, match=message) as raised:
        read_recording([tmp_path / name])
    assert "\n" not in str(raised.value)
