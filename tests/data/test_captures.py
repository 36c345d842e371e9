"""Captures: both formats are read as written, and doubts are reported."""

import math
from dataclasses import replace
from datetime import date
from pathlib import Path

import numpy as np
import pytest
import yaml
from cloths import describe
from PIL import Image
from scipy import ndimage

from common.errors import InputError
from common.findings import Finding, texts
from data.captures.arrays import checked_capture
from data.captures.capture import DepthCapture
from data.captures.description import Specimen, whole_turns
from data.captures.reader import read_capture
from data.captures.writer import write_capture
from data.render.cameras import nominal_camera
from data.rigs import TESTERS
from sim.rig import SQUARE_RIG, Rig

CAPTURES = Path(__file__).resolve().parents[3] / "shared" / "captures"
CAMERA = nominal_camera()


def test_what_is_written_is_read(folder, views):
    capture = read_capture(folder)
    assert capture.views.shape == (4, 180, 240) and capture.views.dtype == np.float32
    assert np.abs(capture.views - views).max() < 0.51e-3
    assert ((capture.views > 0) == (views > 0)).all()
    assert capture.intrinsics == CAMERA.intrinsics and capture.rig == SQUARE_RIG
    assert capture.density == pytest.approx(0.15)
    assert capture.warp_direction == pytest.approx(0.3)
    assert capture.path == folder and capture.warnings == ()


def test_depth_unit_and_direction_are_converted(tmp_path, views):
    path = tmp_path / "fine"
    write_capture(
        path, views=views, intrinsics=CAMERA.intrinsics, density=0.2, rig=SQUARE_RIG,
        depth_unit=1e-4, warp_direction=math.radians(200),
    )  # fmt: skip
    capture = read_capture(path)
    assert np.abs(capture.views - views).max() < 0.051e-3
    assert capture.warp_direction == pytest.approx(math.radians(20), abs=1e-6)
    content = yaml.safe_load((path / "capture.yaml").read_text())
    assert content["density_g_m2"] == 200 and content["warp_direction_deg"] == pytest.approx(200)
    describe(path, warp_direction_deg=None)
    assert read_capture(path).warp_direction is None
    describe(path, density_g_m2=None, weight_g=13.5)  # of the square of 300 mm
    assert read_capture(path).density == pytest.approx(0.15)


@pytest.mark.parametrize(("width", "kept"), [(336, 336), (480, 240), (720, 240)])
def test_pictures_are_subsampled_by_what_a_pixel_covers_not_by_their_width(
        tmp_path, views, width, kept):
    camera, count = CAMERA.resized(width, 3 * width // 4), views.shape[2]
    rows, columns = (np.arange(n) * count // width for n in (camera.height, width))
    write_capture(tmp_path / "large", views=views[:, rows[:, None], columns],
                  intrinsics=camera.intrinsics, density=0.2, rig=SQUARE_RIG)
    capture = read_capture(tmp_path / "large")
    assert capture.views.shape == (4, 3 * kept // 4, kept)
    assert 0.5 / capture.intrinsics.fx < 2.1e-3
    assert (capture.views > 0).mean() == pytest.approx((views > 0).mean(), rel=0.02)  # not cut


@pytest.mark.parametrize(("density", "said"), [
    (30, ["density_light"]), (210, []), (1380, ["density_heavy"])])
def test_a_density_that_few_fabrics_have_is_asked_for(density, said):
    specimen = Specimen.of({"density_g_m2": density}, "")
    assert [found.code for found in specimen.questions] == said


def test_labels_of_the_report_are_read_and_written(folder, tmp_path, views):
    assert read_capture(folder).labels.stated() == {}
    stated = {"fabric": "Köper 7/8", "date": "2026-11-26", "operator": "M. M.", "camera": "D435i",
              "laboratory": "\u0646\u062e\u200c\u0647\u0627", "remarks": "soft\u00adhyphen"}
    describe(folder, **stated | {"date": date(2026, 11, 26)})  # as YAML reads it without quotes
    labels = read_capture(folder).labels
    assert labels.stated() == stated
    write_capture(tmp_path / "again", views=views, intrinsics=CAMERA.intrinsics, density=0.15,
                  rig=SQUARE_RIG, labels=labels)
    assert read_capture(tmp_path / "again").labels == labels


def test_writing_refuses_and_leaves_nothing_behind(tmp_path, views):
    common = {"intrinsics": CAMERA.intrinsics, "density": 0.15, "rig": SQUARE_RIG}
    with pytest.raises(InputError, match=r"shape \(9, 180, 240\); give 1 to 8"):
        write_capture(tmp_path / "many", views=np.repeat(views, 3, axis=0)[:9], **common)
    with pytest.raises(InputError, match="16 bits"):
        write_capture(tmp_path / "far", views=views, depth_unit=1e-6, **common)
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="exists already"):
        write_capture(tmp_path / "taken", views=views, **common)
    assert [p.name for p in tmp_path.rglob("*")] == ["taken", "notes.txt"]
    with pytest.raises(InputError, match="cannot write the capture"):
        write_capture(tmp_path / "taken" / "notes.txt" / "below", views=views, **common)


@pytest.fixture
def made(views) -> DepthCapture:
    """A sound capture made of arrays."""
    return DepthCapture(views, CAMERA.intrinsics, whole_turns(4), density=0.15,
                        warp_direction=0.3, rig=SQUARE_RIG)


def test_arrays_are_checked_like_files(made, folder):
    checked, read = checked_capture(made), read_capture(folder)
    assert np.abs(checked.views - read.views).max() < 0.51e-3
    assert checked.turns == pytest.approx(read.turns) and checked.warnings == ()
    for background in (np.where(made.views > 0, made.views, np.nan),
                       np.ma.masked_equal(made.views, 0), made.views.astype(np.float64)):
        assert checked_capture(replace(made, views=background)).digest == checked.digest
    named = checked_capture(replace(made, rig=SQUARE_RIG.name, density=np.float64(0.15)))
    assert named.rig == SQUARE_RIG and named.digest == checked.digest


@pytest.mark.parametrize(("change", "asked"), [
    ({}, False), ({"cy": 0.59}, False), ({"cx": 0.66}, True), ({"cy": 0.38}, True)])
def test_a_principal_point_off_the_middle_is_a_question(made, folder, change, asked):
    at = {key: share * (240 if key == "cx" else 180) for key, share in change.items()}
    camera = replace(CAMERA.intrinsics, **at)
    describe(folder, intrinsics={key: float(getattr(camera, key))
                                 for key in ("fx", "fy", "cx", "cy")})
    for found in (checked_capture(replace(made, intrinsics=camera)), read_capture(folder)):
        assert [one.code for one in found.warnings] == ["principal_point_off"] * asked


@pytest.mark.parametrize("name", ["disc254_support127", "square250_cylinder60", *TESTERS])
def test_a_tester_is_a_name_or_numbers_and_a_face_is_kept(tmp_path, views, name):
    write_capture(tmp_path / "a", views=views, intrinsics=CAMERA.intrinsics, density=0.2,
                  rig=Rig.from_name(name), face="down")
    content = yaml.safe_load((tmp_path / "a" / "capture.yaml").read_text())
    assert isinstance(content["tester"], str) == (name in TESTERS)
    for value in (content["tester"], name):
        describe(tmp_path / "a", tester=value)
        capture = read_capture(tmp_path / "a")
        assert capture.rig == Rig.from_name(name) and capture.face == "down"
    with pytest.raises(InputError, match="tester has a specimen of 500 mm"):
        write_capture(tmp_path / "b", views=views, intrinsics=CAMERA.intrinsics, density=0.2,
                      rig=Rig.from_name("disc500_support180"))


def test_published_format_is_recognised(published, views):
    capture = read_capture(published)
    assert np.abs(capture.views - views).max() < 0.51 / 255
    assert capture.density == pytest.approx(0.3) and capture.warp_direction is None
    assert capture.rig == SQUARE_RIG and capture.face == "up"
    assert capture.intrinsics == CAMERA.intrinsics and capture.warnings[0].code == "depth_coarse"


def test_published_background_is_zero_or_bright_and_large_pictures_are_decimated(published, views):
    for k, view in enumerate(views):
        counts = np.rint(view * 255).astype(np.uint8)
        counts[counts == 0] = 251 + k
        large = np.repeat(np.repeat(counts, 2, axis=0), 2, axis=1)
        large[1::2] = large[:, 1::2] = 77  # the rows and columns that are left out
        Image.fromarray(large).save(published / f"{k}.png")
    capture = read_capture(published)
    assert capture.views.shape == views.shape
    assert ((capture.views > 0) == (views > 0)).all()


def test_cloth_at_the_border_is_a_warning(folder):
    picture = np.array(Image.open(folder / "view_2.png"))
    picture[picture[:, 120].nonzero()[0][-1] :, 120] = 520
    Image.fromarray(picture).save(folder / "view_2.png")
    assert read_capture(folder).warnings == (Finding("border_touched", {"view": 2}),)


def test_what_lies_apart_from_the_cloth_does_not_count(folder):
    file = folder / "view_2.png"
    clean = np.array(Image.open(file))
    spoiled = clean.copy()
    far = np.argwhere(ndimage.distance_transform_edt(clean == 0) > 8)
    for row, column in (far[0], far[-1]):
        spoiled[row, column] = 540
    touching = np.argwhere((clean == 0) & ndimage.binary_dilation(clean > 0, iterations=2)
                           & ~ndimage.binary_dilation(clean > 0))
    spoiled[tuple(touching[0])] = 540  # noise at the edge
    Image.fromarray(spoiled).save(file)
    capture = read_capture(folder)
    assert not capture.warnings  # any sensor has two such pixels
    expected = np.where(spoiled == clean, clean, 0) * 1e-3
    expected[tuple(touching[0])] = 0.540
    assert np.allclose(capture.views[2], expected)
    spoiled[tuple(far[::97].T)] = 540
    Image.fromarray(spoiled).save(file)
    assert "specks_left_out" in [found.code for found in read_capture(folder).warnings]


def test_a_view_with_half_of_the_cloth_is_reported(folder):
    file = folder / "view_2.png"
    clean = np.array(Image.open(file))
    half = np.median(np.nonzero(clean)[0])
    Image.fromarray(np.where(np.arange(len(clean))[:, None] < half, clean, 0)).save(file)
    assert any(found.code == "view_small" and found.values["view"] == 2
               for found in read_capture(folder).warnings)


def test_depths_unlike_all_around_them_are_left_out(folder):
    file = folder / "view_2.png"
    clean = np.array(Image.open(file))
    spoiled = clean.copy()
    inside = np.argwhere(ndimage.binary_erosion(clean > 0, iterations=3))
    spoiled[tuple(inside[0])] = 60000  # a hot pixel
    Image.fromarray(spoiled).save(file)
    capture = read_capture(folder)
    assert not capture.warnings
    assert (capture.views[2] > 0).sum() == (clean > 0).sum() - 1
    spoiled[tuple(inside[:: len(inside) // 60].T)] = 1  # speckle
    Image.fromarray(spoiled).save(file)
    capture = read_capture(folder)
    assert capture.views.max() < 1.0 and capture.views[capture.views > 0].min() > 0.2
    assert "outliers_left_out" in [found.code for found in capture.warnings]


def test_saturated_counts_are_no_depth(folder):
    before = read_capture(folder).views
    for file in folder.glob("view_*.png"):
        counts = np.array(Image.open(file))
        Image.fromarray(np.where(counts == 0, 65535, counts).astype(np.uint16)).save(file)
    np.testing.assert_array_equal(read_capture(folder).views, before)


def test_a_large_piece_beside_the_cloth_stays_and_is_told(folder):
    file = folder / "view_1.png"
    spoiled = np.array(Image.open(file))
    assert not spoiled[:20, :30].any()
    spoiled[1:19, 1:29] = 700
    Image.fromarray(spoiled).save(file)
    capture = read_capture(folder)
    assert (capture.views[1][1:19, 1:29] > 0).all()
    assert any("504 pixels lie apart" in line for line in texts(capture.warnings))


@pytest.mark.skipif(not CAPTURES.is_dir(), reason="the published captures are not here")
@pytest.mark.parametrize("name", ["mesh0", "mesh1"])
def test_the_published_captures_are_read(name):
    capture = read_capture(CAPTURES / name)
    assert isinstance(capture, DepthCapture) and capture.views.shape == (4, 180, 240)
    assert capture.density == pytest.approx(0.3)
    cloth = capture.views[capture.views > 0]
    assert 0.45 < cloth.min() and cloth.max() < 0.66
