"""The cloth in raw frames, and the files that frames come in."""

from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import trimesh
import yaml
from cloths import skirt
from matplotlib.colors import to_rgb
from PIL import Image
from vectors import angle_between

import data.captures.frames
import data.captures.preview
from apps.capture import main
from common.errors import InputError
from data.captures.cutout import cut_out
from data.captures.description import Description
from data.captures.reader import read_capture
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
