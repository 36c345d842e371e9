"""Depth as other programs write it: constants for missing depth, thinned points, bent lenses."""

import lzma
import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh
import yaml
from cloths import describe
from PIL import Image
from test_recordings import bent

from common.errors import InputError
from common.findings import texts
from data.captures.depth import between_points, measured
from data.captures.reader import read_capture
from data.render.cameras import nominal_camera

CASES = Path(__file__).resolve().parents[3] / "shared" / "cases"
CAMERA = nominal_camera()
K4A = {"k1": 4.2836, "k2": 2.6819, "p1": 6e-5, "p2": -3e-5, "k3": 0.1372, "k4": 4.6148,
       "k5": 4.019, "k6": 0.7189}


@pytest.mark.parametrize("constant", [1e10, 65504.0, 65535.0, 1000.0, -1.0, np.inf, np.nan])
def test_a_constant_for_missing_depth_is_no_depth(folder, views, constant):
    for k, view in enumerate(views):
        (folder / f"view_{k}.png").unlink()
        np.save(folder / f"view_{k}.npy", np.where(view > 0, view, np.float32(constant)))
    assert np.array_equal(read_capture(folder).views, views)


def test_depth_in_millimetres_is_still_refused():
    counts = np.full((4, 50), 540.0)
    counts[0] = 1200.0  # the far end of a scene is no constant for missing depth
    assert (measured(counts) > 0).mean() > 0.7


def thinned(folder: Path, views: np.ndarray, times: int) -> None:
    """The views aligned to a picture ``times`` as large, in which most pixels have no depth."""
    for k, view in enumerate(views):
        large = np.zeros([times * size for size in view.shape], np.uint16)
        large[times // 2 :: times, times // 2 :: times] = np.rint(1e3 * view)
        Image.fromarray(large).save(folder / f"view_{k}.png")
    describe(folder, intrinsics={
        "fx": times * CAMERA.fx, "fy": times * CAMERA.fy,
        "cx": times * CAMERA.cx + times // 2, "cy": times * CAMERA.cy + times // 2})


def test_gaps_of_aligned_depth_are_filled_with_a_warning(folder, views):
    thinned(folder, views, 3)
    capture = read_capture(folder)
    assert capture.views.shape == views.shape
    assert any("a point every 3.0 pixels, 1.7 mm" in line for line in texts(capture.warnings))
    for view, expected in zip(capture.views, views, strict=True):
        assert (view > 0).mean() == pytest.approx((expected > 0).mean(), rel=0.03)
        points, truth = (camera.back_project(depth)[depth > 0] for camera, depth in (
            (capture.intrinsics, view), (CAMERA.intrinsics, expected)))
        assert np.abs(points.mean(axis=0) - truth.mean(axis=0)).max() < 1e-3
        assert np.abs(np.ptp(points, axis=0) - np.ptp(truth, axis=0)).max() < 3e-3


def test_whole_pictures_are_left_as_they_are(views):
    rng = np.random.default_rng(0)
    holes = np.where(rng.random(views[0].shape) < 0.2, 0, views[0])
    filled, spacing = between_points(holes)
    assert spacing == 1.0 and filled is holes


@pytest.mark.parametrize("times", [2, 3])
def test_points_of_a_decimated_stream_are_filled_or_refused(folder, views, times):
    for k, view in enumerate(views):
        (folder / f"view_{k}.png").unlink()
        points = CAMERA.back_project(view)[::times, ::times].reshape(-1, 3)
        points = np.vstack([points[points[:, 2] > 0], [0.0, 0.0, 65504.0]])
        trimesh.PointCloud(points).export(folder / f"view_{k}.ply")
    describe(folder, size_px=[240, 180])
    if times == 3:
        with pytest.raises(InputError, match=r"sparser than its pictures, a point every 3\.0"):
            read_capture(folder)
        return
    capture = read_capture(folder)
    assert any("a point every 2.0 pixels" in line for line in texts(capture.warnings))
    seen = (capture.views > 0) & (views > 0)
    assert seen.sum() > 0.97 * (views > 0).sum()
    assert np.median(np.abs(capture.views - views)[seen]) < 1e-3


def test_a_lens_in_capture_yaml_is_undone(folder, views):
    lens = tuple(K4A.values())
    for k, view in enumerate(bent(np.rint(1e3 * views).astype(np.uint16), CAMERA.intrinsics, lens)):
        Image.fromarray(view).save(folder / f"view_{k}.png")
    distorted = read_capture(folder).views
    stated = {key: getattr(CAMERA, key) for key in ("fx", "fy", "cx", "cy")}
    describe(folder, intrinsics=stated | K4A)
    capture = read_capture(folder)
    assert capture.intrinsics == CAMERA.intrinsics
    off, was = (((found > 0) != (views > 0)).sum() for found in (capture.views, distorted))
    assert off < 0.01 * (views > 0).sum() and off < was


@pytest.mark.parametrize(("density", "codes"), [(22.0, ["density_light"]), (36.0, [])])
def test_densities_that_may_have_another_unit_are_questioned(folder, density, codes):
    describe(folder, density_g_m2=density)
    assert [found.code for found in read_capture(folder).warnings] == codes


REFERENCE = [10243, 10289, 10224, 10178]  # pixels of cloth of one scene, recorded in many ways
SAME_SCENE = ("ros2_mcap", "ros2_db3_folder", "ros_aligned_and_rect", "ros_image_rect_P",
              "ros_uncalibrated_info", "k4a_distorted_params_in_yaml", "ply_rs_viewer_decimated",
              "aligned_holes_3x")
REFUSED = {"rs_viewer_raw_named": "'view_0.raw' is bare pixels",
           "yaml_decimal_comma2": "a decimal comma", "density_oz_yd2": "check the unit"}


@pytest.mark.slow
@pytest.mark.skipif(not CASES.is_dir(), reason="the public cases are not here")
@pytest.mark.parametrize("name", [*SAME_SCENE, *REFUSED, "exr_blender_bg1e10_cut"])
def test_public_cases_are_read_or_refused_by_their_cause(tmp_path, name):
    folder = tmp_path / name
    shutil.copytree(CASES / name, folder)
    for file in (*folder.rglob("*"), folder):
        file.chmod(0o755)
    for packed in folder.rglob("*.xz"):
        packed.with_suffix("").write_bytes(lzma.decompress(packed.read_bytes()))
    text = (folder / "capture.yaml").read_text().replace("rig:", "tester:")
    (folder / "capture.yaml").write_text(
        text + "\ntester: square300_cylinder100\n" * ("tester" not in text))
    if name in REFUSED:
        with pytest.raises(InputError, match=REFUSED[name]):
            read_capture(folder)
        return
    capture = read_capture(folder)
    pixels = (capture.views > 0).sum(axis=(1, 2))
    if name in SAME_SCENE:
        assert pixels == pytest.approx(REFERENCE, rel=0.01)
    else:
        assert yaml.safe_load(text)["density_g_m2"] == pytest.approx(1e3 * capture.density)
        assert ((9000 < pixels) & (pixels < 10_000)).all()
