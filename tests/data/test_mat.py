"""Photographs over the printed mat: its pages, its markers, the camera's pose, and the outline."""

import io
import re
from functools import partial

import cv2
import numpy as np
import photographs
import pytest
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from apps.capture import main
from common.errors import InputError
from common.findings import texts
from data.captures.description import OutlineSource
from data.captures.photograph import read_outline
from data.captures.reader import read_capture
from data.dataset.off_axis import silhouette
from data.pictures.mat import (
    GROUNDS,
    MATS,
    PARTS,
    PIXEL,
    find_mat,
    mat_colours,
    mat_pages,
    mat_picture,
)
from data.pictures.pose import camera_matrix, camera_poses
from data.pictures.reading import FULL_FRAME, Photograph, decoded, read_photograph
from data.render import phone, textures
from data.render.phone import phone_picture
from sim.mesh import Mesh
from sim.rig import DISC_RIG, Rig

PLATE_HEIGHT = 0.12
over_mat = partial(photographs.write_over_mat, mat="a3", plate_height_mm=1e3 * PLATE_HEIGHT)


@pytest.fixture(scope="module")
def picture(shape):
    return phone_picture(shape.positions, shape.rest, shape.faces, np.random.default_rng(38),
                         plate_radius=DISC_RIG.plate_radius, plate_height=PLATE_HEIGHT,
                         surface=textures.plain(np.array([0.4, 0.08, 0.08]),
                                                np.random.default_rng(0)))


def without_exif(jpeg: bytes) -> bytes:
    """A picture as a messenger hands it on."""
    stream = io.BytesIO()
    Image.open(io.BytesIO(jpeg)).save(stream, format="JPEG", quality=92)
    return stream.getvalue()


@pytest.mark.parametrize("ground", GROUNDS)
@pytest.mark.parametrize("name", MATS)
def test_all_markers_of_a_mat_are_read_to_a_tenth_of_a_millimetre(name, ground):
    page = mat_picture(name, ground)
    light = np.repeat(decoded(page / 255)[..., None], 3, axis=2)
    found, coded, centres, pixels = find_mat(Photograph(light, np.zeros(page.shape, bool)))
    assert (found, coded) == (name, ground == "code")
    assert len(centres) == len(MATS[name].numbers(coded=coded))
    places = (pixels - (np.array(page.shape[::-1]) - 1) / 2) * PIXEL * [1, -1]
    np.testing.assert_allclose(places, centres[:, :2], atol=1e-4)


@pytest.mark.parametrize("mat, paper", PARTS)
def test_a_mat_fits_its_paper_in_parts(mat, paper):
    assert mat_pages(mat, paper).startswith(b"%PDF")


def test_the_command_writes_a_mat(tmp_path, capsys):
    main(["mat=a3", "paper=a4", f"out={tmp_path / 'mat.pdf'}"])
    said = capsys.readouterr().out
    assert "at 100 %" in said and "state what you measure as mat_bar_mm" in said
    assert (tmp_path / "mat.pdf").stat().st_size > 1e5


@pytest.mark.parametrize("ground", ["grey", "blue"])
def test_a_grey_or_coloured_ground_lies_between_white_and_black_cloth(ground):
    """By its light, of which white cloth reflects 85 % and black cloth 4 %; lines are seen on it.
    """
    light = decoded(mat_colours("a3", ground) / 255).mean(axis=2)
    plain = np.median(light)
    assert 0.15 < plain < 0.3
    assert 0.005 < ((light > 0.5 * plain) & (light < 0.7 * plain)).mean() < 0.05
    assert (mat_colours("a3", "white") == mat_picture("a3")[..., None]).all()


def test_one_photograph_gives_the_outline_and_the_height(tmp_path, shape):
    taken = phone_picture(
        shape.positions, shape.rest, shape.faces, np.random.default_rng(3), mat="a2", beside=0.06,
        plate_radius=DISC_RIG.plate_radius, plate_height=PLATE_HEIGHT,
        surface=textures.plain(np.array([0.4, 0.08, 0.08]), np.random.default_rng(0)))
    capture = read_capture(over_mat(tmp_path / "capture", taken.jpeg, mat="a2", arrow="none"))
    outline, place = capture.outline, taken.pose.place - [0, 0, PLATE_HEIGHT]
    assert outline.height == pytest.approx(place[2], rel=0.03) and outline.centred
    true = seen_on_axis(shape, taken)
    assert 1e3 * np.sqrt(np.square(outline.radii - true).mean()) < 1.0
    assert capture.warp_direction is None


def seen_on_axis(shape, picture) -> np.ndarray:
    """The true radii (720,), m, from above the plate at the height of a picture's camera."""
    turn = np.array([[np.cos(picture.warp), np.sin(picture.warp), 0],
                     [-np.sin(picture.warp), np.cos(picture.warp), 0], [0, 0, 1]])
    return silhouette(shape.positions @ turn, Mesh(shape.rest, shape.faces).edges, np.zeros(2),
                      picture.pose.place[2] - PLATE_HEIGHT, azimuths=720)


@pytest.mark.parametrize("ground", ["grey", "blue"])
def test_white_cloth_over_a_grey_or_coloured_mat_is_read(tmp_path, shape, ground):
    taken = phone_picture(
        shape.positions, shape.rest, shape.faces, np.random.default_rng(5), mat="a2",
        plate_radius=DISC_RIG.plate_radius, plate_height=PLATE_HEIGHT, ground=ground,
        beside=0.08, surface=textures.plain(0.85, np.random.default_rng(0)))
    found = read_capture(over_mat(tmp_path / "capture", taken.jpeg, mat="a2", ground=ground))
    assert found.warnings == ()
    assert 1e3 * np.sqrt(np.square(found.outline.radii - seen_on_axis(shape, taken)).mean()) < 1


def test_what_differs_from_white_is_read_as_before_over_grey(tmp_path):
    """Dark cloth, and a ground that is not stated: the markers are white on a plain ground."""
    jpeg = photographs.over_mat(ground="grey", cloth=(30, 30, 30))
    for name, source in (("stated", {"ground": "grey"}), ("not", {})):
        folder = over_mat(tmp_path / name, jpeg, mat="a2", plate_height_mm=150, **source)
        assert photographs.error_mm(read_capture(folder)) < 1.5


def test_the_check_writes_what_was_read(tmp_path):
    folder = over_mat(tmp_path / "taken", photographs.over_mat(), mat="a2", plate_height_mm=150)
    main([f"frames={folder}", f"out={tmp_path / 'cut'}"])
    taken, cut = (read_capture(tmp_path / name).outline for name in ("taken", "cut"))
    assert cut.height == pytest.approx(taken.height)
    assert np.abs(cut.radii - taken.radii).max() < 1e-5


def test_pictures_from_the_sides_stand_for_a_focal_length_that_is_missing(tmp_path, picture):
    folder = over_mat(tmp_path / "capture", without_exif(picture.jpeg))
    width, height = picture.pose.size
    for k, tilt in enumerate((0.6, -0.6)):
        (folder / f"mat_{k + 1}.jpg").write_bytes(bare_mat(width, height, picture.pose.focal, tilt))
    found = read_capture(folder)
    assert found.outline.height == pytest.approx(picture.pose.place[2] - PLATE_HEIGHT, rel=0.03)
    assert found.warp_direction == 0  # along the arrow, if nothing else is stated


def test_a_mat_that_was_not_printed_at_100_percent_is_measured(tmp_path, picture):
    """The same picture is one of a smaller drape over a mat printed at 97 %."""
    file = over_mat(tmp_path / "capture", picture.jpeg) / "outline.jpg"
    small = Rig(0.97 * DISC_RIG.sides[0], 0.97 * DISC_RIG.plate_diameter, "disc")
    found = [read_outline(file, OutlineSource(mat="a3", **source), rig) for source, rig in (
        ({"plate_height_mm": 1e3 * PLATE_HEIGHT}, DISC_RIG),
        ({"plate_height_mm": 970 * PLATE_HEIGHT, "mat_bar_mm": 194.0}, small))]
    assert found[1].height == pytest.approx(0.97 * found[0].height, rel=1e-9)
    assert np.abs(found[1].radii - 0.97 * found[0].radii).max() < 1e-4
    assert found[1].drape_coefficient == pytest.approx(found[0].drape_coefficient, abs=1e-3)


def changed(jpeg: bytes, *, box=None, zoom=None, focal=None) -> bytes:
    """A picture cut to a ``box``, or with tags of a digital ``zoom`` and a ``focal`` length, with
    the rest of its tags."""
    picture, stream = Image.open(io.BytesIO(jpeg)), io.BytesIO()
    exif = picture.getexif()
    exif.get_ifd(0x8769).update({tag: value for tag, value in ((41988, zoom), (41989, focal))
                                 if value is not None})
    (picture.crop(box) if box else picture).save(stream, format="JPEG", quality=92, exif=exif)
    return stream.getvalue()


@pytest.mark.parametrize(("change", "reason"), [
    ({"box": (0, 252, 1512, 1764)}, "1512x1512 pixels is cut: its sides are neither 4:3 nor 3:2"),
    ({"box": (189, 0, 1323, 2016)}, "1134x2016 pixels is cut"),
    ({"zoom": 1.5}, "a digital zoom of 1.5"), ({"zoom": 1.0}, ""), ({"zoom": 0.0}, ""),
    ({"zoom": IFDRational(0, 0)}, ""), ({"zoom": 65535.0}, ""), ({"zoom": "none"}, ""),
    ({"focal": 65535}, "none between 8 and 400 mm"), ({"focal": 0}, "none between"),
    ({"focal": IFDRational(27, 0)}, "none between"), ({"focal": (27, 28)}, "none between"),
    ({"focal": "27 mm"}, "none between")])
def test_the_focal_length_of_a_whole_picture_is_not_that_of_a_part(tmp_path, picture, change,
                                                                   reason):
    """It is measured then, in this picture, which was not taken from straight above."""
    assert picture.pose.size == (1512, 2016)
    folder = over_mat(tmp_path / "capture", changed(picture.jpeg, **change))
    read = read_photograph(folder / "outline.jpg", side=4500)
    assert (read.focal is None) == bool(reason) and reason in read.no_focal
    assert read_capture(folder).outline.height == pytest.approx(
        picture.pose.place[2] - PLATE_HEIGHT, rel=0.03)


def test_a_focal_length_that_the_markers_contradict_is_named(tmp_path, picture):
    capture = read_capture(over_mat(tmp_path / "capture", changed(picture.jpeg, focal=64)))
    found = next(one for one in capture.warnings if one.code == "focal_length_contradicts")
    assert found.values["stated"] == pytest.approx(64)
    true = picture.pose.focal * FULL_FRAME / np.hypot(*picture.pose.size)
    assert found.values["value"] == pytest.approx(true, rel=0.06)
    assert capture.outline.height == pytest.approx(picture.pose.place[2] - PLATE_HEIGHT, rel=0.06)


@pytest.mark.parametrize(("camera", "named"), [(1.95, False), (2.6, True)])
def test_a_camera_out_of_reach_is_named(tmp_path, camera, named):
    """The mat alone does not contradict the focal length in a picture from straight above."""
    jpeg = photographs.over_mat(camera=camera, focal=3000)
    found = read_capture(over_mat(tmp_path / "capture", jpeg, mat="a2", plate_height_mm=150))
    assert [one.values["value"] for one in found.warnings if one.code == "camera_far"] == [
        pytest.approx(1e3 * camera - 150, rel=0.02)] * named


def test_markers_along_two_sides_are_enough():
    """Seven that were seen in a photograph from 0.52 m above a plate of 0.2 m."""
    points = np.array([[-0.186, 0.119], [-0.1446667, 0.119], [-0.186, -0.119], [-0.186, -0.0793333],
                       [-0.186, -0.0396667], [-0.186, 0.0396667], [-0.186, 0.0793333]])
    pixels = np.array([[444.9, 652.4], [541.5, 618.8], [648.6, 1184.9], [615.2, 1098.0],
                       [581.6, 1010.4], [513.7, 832.9], [479.3, 743.1]])
    pose, = camera_poses([(2016, 1512)], [(np.column_stack([points, np.zeros(7)]), pixels)],
                         1688.93)
    assert pose.place[2] == pytest.approx(0.723, rel=0.02)


def test_markers_seen_askew_contradict_the_focal_length_of_another_picture():
    """Zoomed 1.2 times without a tag: seen from the side it is measured, from above it is not."""
    mat, size = MATS["a3"], (2016, 1512)
    points = np.column_stack([mat.centres, np.zeros(len(mat.centres))])
    turn = cv2.Rodrigues(np.array([0, 0.4, 0]))[0] @ cv2.Rodrigues(np.array([np.pi, 0, 0]))[0]
    pixels = cv2.projectPoints(points, turn, np.array([0, 0, 0.7]), camera_matrix(1800.0, size),
                               None)[0][:, 0]
    for stated, focal in ((1500.0, 1800), (1790.0, 1795)):
        pose, = camera_poses([size], [(points, pixels)], stated)
        assert pose.focal == pytest.approx(focal, rel=0.01)


@pytest.mark.parametrize("cloth", [(200, 60, 90), (110, 170, 200), (60, 60, 60)])
def test_a_hem_over_markers_is_exact_or_doubtful(tmp_path, cloth):
    """Folds reach over the small mat's markers and beyond its paper."""
    jpeg = photographs.over_mat(mat="a3", cloth=cloth)
    capture = read_capture(over_mat(tmp_path / "capture", jpeg, plate_height_mm=150))
    error = np.sqrt(np.square(photographs.distances_mm(capture)).mean())
    assert error < 0.8 or "hem_doubtful" in [found.code for found in capture.warnings]


@pytest.mark.parametrize(("height", "said"), [
    (275, r"rim of 90 mm, which hides it: check the scale first \(is the mat printed at 100 %\? "
          r"If not, mat_bar_mm\), then plate_height_mm, then the tester"),
    (330, r"inside the plate of 90 mm radius; check the scale first .* then plate_height_mm")])
def test_a_plate_lower_than_stated_contradicts_the_outline(tmp_path, height, said):
    """It is 150 mm over the mat; by 20 mm less or more, nothing contradicts."""
    jpeg = photographs.over_mat()
    folder = over_mat(tmp_path / "capture", jpeg, mat="a2", plate_height_mm=height)
    try:
        lines = texts(read_capture(folder).warnings)
    except InputError as error:
        lines = [str(error)]
    assert re.search(said, " ".join(lines))


def test_the_papers_border_along_the_hem_is_a_warning(tmp_path):
    """Over the mat from 1.05 m, a hem of 119 mm at 150 mm is seen 136 mm from its middle."""
    curve = 0.119 * photographs.AROUND
    for mat, named in (("a3", True), ("a2", False)):
        jpeg = photographs.over_mat(curve, mat=mat, cloth=(200, 60, 90))
        found = read_capture(over_mat(tmp_path / mat, jpeg, mat=mat, plate_height_mm=150))
        assert ("hem_along_border" in [one.code for one in found.warnings]) == named


def bare_mat(width: int, height: int, focal: float, tilt: float) -> bytes:
    """The mat alone from the side, 0.7 m away."""
    page = mat_picture("a3")
    rows, columns = page.shape
    to_mat = np.array([[PIXEL, 0, -PIXEL * columns / 2], [0, -PIXEL, PIXEL * rows / 2], [0, 0, 1]])
    turn = cv2.Rodrigues(np.array([np.pi, 0, 0]))[0]
    turn = cv2.Rodrigues(np.array([0, tilt, 0]))[0] @ turn
    matrix = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])
    from_mat = matrix @ np.column_stack([turn[:, :2], [0, 0, 0.7]])
    seen = cv2.warpPerspective(page, from_mat @ to_mat, (width, height), flags=cv2.INTER_AREA,
                               borderValue=120)
    return cv2.imencode(".jpg", seen)[1].tobytes()


def test_a_pose_states_its_errors():
    mat = MATS["a3"]
    points = np.column_stack([mat.centres, np.zeros(len(mat.centres))])
    rng = np.random.default_rng(0)
    exact, = camera_poses([(2000, 1500)], [(points, ideal(points))], 1500.0)
    off = []
    for _ in range(20):
        stated = 1500.0 * np.exp(0.01 * rng.normal())
        seen = ideal(points) + rng.normal(0, 0.15, (len(points), 2))
        pose, = camera_poses([(2000, 1500)], [(points, seen)], stated)
        off.append((pose.place[2] - 0.8) / pose.height_error)
    with pytest.raises(InputError, match=r"focal length is not known: it is cut, .*mat_1\.jpg"):
        camera_poses([(2000, 1500)], [(points, ideal(points))], None, "it is cut")
    assert exact.place == pytest.approx([0.05, -0.02, 0.8], abs=2e-3)
    assert np.sqrt(np.square(off).mean()) < 1.3


def ideal(points: np.ndarray) -> np.ndarray:
    """Pixels of points on the mat from 0.8 m above it."""
    return 1500 / 0.8 * (points[:, :2] - [0.05, -0.02]) * [1, -1] + [999.5, 749.5]


def test_one_marker_that_a_hem_half_covers_is_left_out():
    centres = np.column_stack([MATS["a3"].centres, np.zeros(len(MATS["a3"].centres))])
    lens = np.zeros(4)
    pixels = cv2.projectPoints(centres, np.array([np.pi, 0.1, 0.0]), np.array([0.02, 0, 0.8]),
                               camera_matrix(1500.0, (2000, 1500)), lens)[0][:, 0]
    exact, = camera_poses([(2000, 1500)], [(centres, pixels)], 1500.0)
    pixels[3] += [24.0, -18.0]
    pose, = camera_poses([(2000, 1500)], [(centres, pixels)], 1500.0)
    assert np.linalg.norm(pose.place - exact.place) < 1e-4
    pixels[::2] += [12.0, -9.0]
    with pytest.raises(InputError, match="lay it flat"):
        camera_poses([(2000, 1500)], [(centres, pixels)], 1500.0)


def test_photographs_with_a_seed_are_the_same(shape, monkeypatch):
    monkeypatch.setattr(phone, "_SIZE", (336, 252))
    first, again = (phone_picture(shape.positions, shape.rest, shape.faces,
                                  np.random.default_rng(3), plate_radius=DISC_RIG.plate_radius,
                                  plate_height=PLATE_HEIGHT).jpeg for _ in range(2))
    assert first == again
