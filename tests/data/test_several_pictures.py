"""Several photographs of one drape over the mat: poses, the joined outline, contradictions."""

import io
from functools import partial

import cv2
import numpy as np
import pytest
import yaml
from photographs import write_over_mat
from PIL import Image

from data.captures import joined_outlines
from data.captures.joined_outlines import SeenOutline, join_outlines
from data.captures.off_axis import AZIMUTHS, OUTWARDS
from data.captures.plate_height import height_off
from data.captures.preview import show
from data.captures.reader import find_outline, read_capture
from data.captures.scale import Scaled
from data.captures.seen import seen_photograph
from data.dataset.off_axis import silhouette
from data.pictures.mat import MATS
from data.pictures.planes import behind, mapped, shifted
from data.pictures.pose import Pose, camera_matrix, camera_poses
from data.pictures.reading import Photograph
from data.render import phone, textures
from sim.draping import drape
from sim.material import Fabric
from sim.outlines import closed, farthest
from sim.rig import DISC_RIG

PLATE_HEIGHT, HEIGHT, SIZE = 0.12, 0.62, (1680, 1260)
FOCAL = 0.62 * float(np.hypot(*SIZE))
RED = textures.plain(np.array([0.4, 0.08, 0.08]), np.random.default_rng(0))
PLACES = ((0.0, 0.12), (0.16, -0.1), (-0.17, -0.06))  # m, beside the axis


def pose_at(place, size) -> Pose:
    """A phone that looks at a point near the plate, from :data:`HEIGHT` above it."""
    place = np.array([*place, PLATE_HEIGHT + HEIGHT])
    aim = -place / np.linalg.norm(place)
    right = np.cross(aim, [0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    turn = np.stack([right, np.cross(aim, right), aim])
    return Pose(size, FOCAL, 0.01, cv2.Rodrigues(turn)[0].ravel(), -turn @ place, 0.0, 0.0)


def taken(shape, place, turn: float = 0.0) -> bytes:
    """The same cloth and light from a place, with the drape turned."""
    cos, sin = np.cos(turn), np.sin(turn)
    positions = shape.positions @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(phone, "random_pose", lambda _, size, *__: pose_at(place, size))
        return phone.phone_picture(positions, shape.rest, shape.faces, np.random.default_rng(0),
                                   plate_radius=DISC_RIG.plate_radius,
                                   plate_height=PLATE_HEIGHT, mat="a2", size=SIZE, surface=RED).jpeg


@pytest.fixture(scope="module")
def pictures(shape):
    return [taken(shape, place) for place in PLACES]


def changed(jpeg: bytes, box=None) -> bytes:
    """A picture without its tags, cut to a box."""
    picture, stream = Image.open(io.BytesIO(jpeg)), io.BytesIO()
    picture.crop(box).save(stream, format="JPEG", quality=92)
    return stream.getvalue()


def folder_of(path, pictures, **changes):
    """A capture of pictures, from outline_1.jpg on or by names."""
    named = pictures if isinstance(pictures, dict) else {
        f"outline_{k}.jpg": jpeg for k, jpeg in enumerate(pictures, 1)}
    return write_over_mat(path, named, **{"plate_height_mm": 1e3 * PLATE_HEIGHT} | changes)


def error_mm(capture, shape, place=(0, 0)) -> float:
    true = silhouette(shape.positions, shape.mesh.edges, np.array(place), HEIGHT, azimuths=720)
    return 1e3 * float(np.sqrt(np.square(capture.outline.radii - true).mean()))


def codes(capture) -> list[str]:
    return [found.code for found in capture.warnings]


def test_three_pictures_show_the_drape_better_than_each_alone(tmp_path, shape, pictures):
    alone = [read_capture(folder_of(tmp_path / f"{k}", {"outline.jpg": jpeg}))
             for k, jpeg in enumerate(pictures)]
    joined = read_capture(folder_of(tmp_path / "joined", pictures))
    errors = [error_mm(capture, shape) for capture in alone]
    assert error_mm(joined, shape) < 0.8 * np.median(errors) and error_mm(joined, shape) < 1.2
    assert all("camera_beside" in codes(capture) for capture in alone)
    assert "outline_2.jpg" in next(found.text for found in alone[0].warnings
                                   if found.code == "camera_beside")
    assert not {"camera_beside", "picture_contradicts", "pictures_differ", "picture_turned"
                } & {*codes(joined)}
    outline = joined.outline
    assert outline.height == pytest.approx(HEIGHT, rel=0.02)
    assert outline.error.shape == (720,) and 3e-4 < np.median(outline.error) < 3e-3
    # The first picture is shown, with the outline as it is seen there.
    first = alone[0].outline
    alike = cv2.resize(first.picture, outline.picture.shape[1::-1])  # lenses differ by a pixel
    assert np.abs(outline.picture.astype(int) - alike).mean() < 2
    assert np.median(np.abs(outline.hem - first.drawn(OUTWARDS * silhouette(
        shape.positions, shape.mesh.edges, np.array(PLACES[0]), HEIGHT, azimuths=720)[:, None])
    )) * first.pixel < 3e-3
    assert show(joined).startswith(b"\x89PNG")


@pytest.mark.parametrize(("count", "printed", "named"), [
    (2, 0.94, True), (3, 0.94, True), (3, 1.06, True), (2, 1.0, False), (3, 0.99, False)])
def test_a_mat_printed_to_another_scale_is_named(tmp_path, pictures, count, printed, named):
    """The cloth on the plate moves between pictures. On the mat, all true lengths look longer by
    the same factor."""
    folder = folder_of(tmp_path / "some", pictures[:count], plate_height_mm=120 * printed)
    keys = yaml.safe_load((folder / "capture.yaml").read_text())
    keys["tester"] = {"specimen": "disc", "size_mm": 300 * printed, "plate_mm": 180 * printed}
    (folder / "capture.yaml").write_text(yaml.safe_dump(keys))
    assert [one.values["value"] for one in read_capture(folder).warnings
            if one.code == "plate_height_contradicts"] == [pytest.approx(120, abs=2)] * named


@pytest.mark.parametrize(("reach", "off"), [(0.09, None), (0.11, 8e-3)])
def test_an_upper_disc_on_the_cloth_is_no_higher_plate(reach, off):
    """Structure 8 mm over the stated plate, up to its rim or beyond."""
    steps, pixel = np.arange(600), 5e-4
    noise = cv2.GaussianBlur(np.random.default_rng(0).random((600, 600, 3), np.float32), (0, 0), 2)
    columns, rows = np.meshgrid(steps, steps)
    high = 8e-3 * (np.hypot(columns - 299.5, rows - 299.5) * pixel < reach) / pixel
    views = []
    for x, y in ((0.15, 0.1), (-0.2, 0.0)):
        light = cv2.remap(noise, (columns + x * high).astype(np.float32),
                          (rows - y * high).astype(np.float32), cv2.INTER_LINEAR)
        views.append(Scaled(Photograph(light, np.zeros((600, 600), bool)),
                            np.diag([pixel, -pixel, 1]) @ shifted(np.full(2, -299.5)), HEIGHT,
                            beside=HEIGHT * np.array([x, y])))
    assert height_off(views, DISC_RIG, PLATE_HEIGHT) == (off and pytest.approx(off, abs=1e-3))


def test_the_focal_length_of_cut_pictures_is_measured_in_several(tmp_path, pictures):
    box = (210, 0, 1470, 1260)
    capture = read_capture(folder_of(tmp_path / "cut", [changed(one, box) for one in pictures]))
    assert capture.outline.height == pytest.approx(HEIGHT, rel=0.03)


def test_pictures_with_other_focal_lengths_are_of_other_cameras(tmp_path, shape, pictures):
    stream, picture = io.BytesIO(), Image.open(io.BytesIO(pictures[1]))
    exif = picture.getexif()
    small = picture.resize((1400, 1050), Image.Resampling.LANCZOS)
    small.save(stream, format="JPEG", quality=92, exif=exif)
    capture = read_capture(folder_of(tmp_path / "two", [pictures[0], stream.getvalue()]))
    assert error_mm(capture, shape) < 1.5


def test_a_picture_that_contradicts_or_cannot_be_read_is_left_out_and_named(
        tmp_path, shape, pictures):
    stiff = drape(Fabric(alpha=[300e-6] * 3, beta=[0.0] * 3, density=0.15), rig=DISC_RIG,
                  edge=1.5e-2)
    other = taken(stiff, PLACES[2])
    grey = io.BytesIO()
    Image.new("RGB", SIZE, (200, 190, 180)).save(grey, format="JPEG")
    three = read_capture(folder_of(tmp_path / "three", [
        *pictures[:2], other, grey.getvalue()]))
    said = {found.code: found.text for found in three.warnings}
    assert said["picture_contradicts"].startswith("outline_3.jpg is left out")
    assert said["picture_unread"].startswith("outline_4.jpg is left out, it cannot be read: it "
                                             "shows fewer than six markers")
    assert error_mm(three, shape) < 1.5
    two = read_capture(folder_of(tmp_path / "two", [pictures[0], other]))
    said = next(found for found in two.warnings if found.code == "pictures_differ")
    assert said.values["value"] > 0.1 and "outline_1.jpg and outline_2.jpg contradict" in said.text
    assert two.outline.error.max() > 5e-3


def test_after_a_picture_without_a_pose_the_others_are_read_from_their_own_places(
        tmp_path, shape, pictures):
    """A messenger's copy has no focal length, and a corner of a picture does not show it."""
    corner = changed(pictures[0], (0, 0, 840, 630))
    capture = read_capture(folder_of(tmp_path / "copy", [corner, *pictures[1:]]))
    said, = (found.text for found in capture.warnings if found.code == "picture_unread")
    assert said.startswith("outline_1.jpg is left out") and "focal length" in said
    sound = read_capture(folder_of(tmp_path / "sound", pictures[1:])).outline
    assert capture.outline.radii == pytest.approx(sound.radii, abs=1e-6)
    assert np.array_equal(capture.outline.picture, sound.picture)
    assert error_mm(capture, shape) < 1.5


def test_a_picture_under_two_names_counts_once(tmp_path, pictures):
    capture = read_capture(folder_of(tmp_path / "twice", [pictures[0], *pictures[:2]]))
    said, = (one.text for one in capture.warnings if one.code == "picture_unread")
    assert said.startswith("outline_2.jpg is left out") and "same picture as outline_1.jpg" in said


@pytest.fixture(scope="module")
def turned_picture(shape):
    """With the plate turned by 40 degrees, clockwise."""
    return taken(shape, PLACES[1], np.radians(-40))


def test_a_plate_that_was_turned_between_pictures_is_turned_back(
        tmp_path, shape, pictures, turned_picture):
    turned = read_capture(folder_of(tmp_path / "turned", [pictures[0], turned_picture]))
    said = next(found for found in turned.warnings if found.code == "picture_turned")
    assert said.values["value"] == pytest.approx(-40, abs=1) and error_mm(turned, shape) < 1.5
    assert "pictures_differ" not in codes(turned)


def test_a_turned_plate_is_drawn_as_the_picture_shows_it(tmp_path, shape, pictures,
                                                         turned_picture):
    """The picture nearest to the axis is shown; the plate was turned before it."""
    folder = folder_of(tmp_path / "turned", [turned_picture, pictures[0]])
    with (folder / "capture.yaml").open("a") as stream:
        stream.write("warp_direction_deg: 30\n")
    seen = seen_photograph(folder)
    true = silhouette(shape.positions, shape.mesh.edges, np.array(PLACES[0]), HEIGHT, azimuths=720)
    to_metres = np.linalg.inv(seen.outline.to_pixels)
    hem = farthest(closed(mapped(seen.hem, to_metres)), 720)
    assert np.sqrt(np.square(hem - true).mean()) < 2e-3
    x, y = np.diff(mapped(seen.warp, to_metres), axis=0)[0]
    assert np.degrees(np.arctan2(y, x)) == pytest.approx(70, abs=1)
    feet = mapped(seen.cameras, to_metres)
    assert feet == pytest.approx(np.array([PLACES[1], PLACES[0]]), abs=0.02)


def test_where_one_of_three_differs_the_others_decide():
    """A bulge of 8 mm over 15 degrees in one of three outlines of a stiff drape."""
    azimuth = np.arange(AZIMUTHS) * (2 * np.pi / AZIMUTHS)
    radius = 0.125 + 0.006 * np.cos(4 * azimuth)
    bulge = radius + 8e-3 * (np.abs(azimuth - 2) < np.radians(7.5))
    views = [SeenOutline(one[:, None] * OUTWARDS, np.array([0.02, 0.01]), 0.8,
                         np.full(AZIMUTHS, 6e-4))
             for one in (radius, bulge, radius)]
    found = join_outlines(views, DISC_RIG, PLATE_HEIGHT)
    clean = join_outlines([views[0], views[2]], DISC_RIG, PLATE_HEIGHT)
    assert found.used == [0, 1, 2] and found.parted is None
    assert np.abs(found.radius - clean.radius).max() < 1.5e-3
    there = np.abs(azimuth - 2) < np.radians(6)
    assert np.median(found.error[there]) > 3 * np.median(found.error[~there])
    parted = join_outlines(views[:2], DISC_RIG, PLATE_HEIGHT).parted
    assert parted is not None and parted[0] == pytest.approx(2, abs=0.05)


def test_a_turned_plate_is_turned_back_though_outlines_cross_on_the_ground(monkeypatch):
    azimuth = np.arange(AZIMUTHS) * (2 * np.pi / AZIMUTHS)
    radii = [0.12 + 0.01 * np.cos(6 * (azimuth - at)) + 0.004 * np.cos(2 * (azimuth - at))
             for at in (0.0, 0.2, 0.0)]
    views = [SeenOutline(radius[:, None] * OUTWARDS, np.array([0.02, 0.01]), 0.8,
                         np.full(AZIMUTHS, 6e-4))
             for radius in radii]
    monkeypatch.setattr(joined_outlines, "hidden_by_ground",
                        lambda views, *_: np.tile(azimuth < 1.2, (len(views), 1)))
    found = join_outlines(views, DISC_RIG, PLATE_HEIGHT)
    assert found.used == [0, 1, 2]
    assert found.turned == pytest.approx([0.0, 0.2, 0.0], abs=0.01)


def seen_by(points, height, place) -> np.ndarray:
    """Points (N, 2) at a height over the ground, on the plane of the plate, by an eye (3,)."""
    ground = behind(points, place, height)
    return place[:2] + (ground - place[:2]) * (1 - PLATE_HEIGHT / place[2])


def test_a_shadow_that_stays_on_the_mat_is_no_hem():
    """A shadow of 20 mm over 40 degrees beside a hem 20 mm below the plate, in three pictures."""
    azimuth = np.arange(AZIMUTHS) * (2 * np.pi / AZIMUTHS)
    radius = 0.120 + 0.006 * np.cos(4 * azimuth)
    views, clean = [], []
    for place in (np.array([*beside, PLATE_HEIGHT + HEIGHT]) for beside in PLACES):
        hem = seen_by(radius[:, None] * OUTWARDS, PLATE_HEIGHT - 0.02, place)
        shadow = seen_by((radius + 0.02)[:, None] * OUTWARDS, 0.0, place)
        seen = np.where(np.abs(azimuth - 2)[:, None] < np.radians(20), shadow, hem)
        views.append(SeenOutline(seen, place[:2], HEIGHT, np.full(AZIMUTHS, 6e-4)))
        clean.append(views[-1]._replace(curve=hem))
    found = join_outlines(views, DISC_RIG, PLATE_HEIGHT)
    inside, outside = np.abs(azimuth - 2) < np.radians(15), np.abs(azimuth - 2) > np.radians(25)
    assert found.used == [0, 1, 2]
    assert found.grounded[inside].mean() > 0.8 and not found.grounded[outside].any()
    assert np.median(found.error[inside]) > 5 * np.median(found.error[outside])
    assert not join_outlines(clean, DISC_RIG, PLATE_HEIGHT).grounded.any()


def test_poses_of_pictures_upright_and_sideways_share_one_lens():
    mat = MATS["a2"]
    points = np.column_stack([mat.centres, np.zeros(len(mat.centres))])
    seen, sizes, places = [], [(2000, 1500), (1500, 2000), (2000, 1500)], []
    for size, tilt, far in zip(sizes, (0.3, -0.25, 0.0), (0.7, 0.8, 1.0), strict=True):
        turn = cv2.Rodrigues(np.array([0, tilt, 0]))[0] @ cv2.Rodrigues(
            np.array([np.pi, 0, 0]))[0]
        shift = np.array([0.0, 0.0, far])
        seen.append((points, cv2.projectPoints(points, turn, shift, camera_matrix(1400.0, size),
                                               None)[0][:, 0]))
        places.append(-turn.T @ shift)
    poses = camera_poses(sizes, seen, None, "it is cut")
    assert len({pose.focal for pose in poses}) == 1
    assert poses[0].focal == pytest.approx(1400, rel=5e-3)
    for pose, place in zip(poses, places, strict=True):
        assert pose.place == pytest.approx(place, abs=5e-3)


def test_the_first_of_several_pictures_is_found(tmp_path):
    make = partial(dict.fromkeys, [], b"")
    assert find_outline(folder_of(tmp_path / "none", make())) is None
    several = dict.fromkeys(["outline_3.jpg", "outline_2.JPG", "outline_old.jpg"], b"")
    assert find_outline(folder_of(tmp_path / "some", several)).name == "outline_2.JPG"
