"""What of a hem is not clear or not of cloth, and outlines seen from beside the axis."""

import subprocess
import sys

import numpy as np
import photographs
import pytest
import yaml
from safetensors.torch import load_file

from common.errors import InputError
from common.findings import texts
from data.captures.clarity import DOUBTFUL, Clarity, jagged_hem, side, sides
from data.captures.ground import Ground
from data.captures.hem import BUNDLED as HEM
from data.captures.hem import unlike_cloth
from data.captures.off_axis import AZIMUTH, AZIMUTHS, BUNDLED, MAX_LEAN, OUTWARDS, seen_from_axis
from data.captures.reader import read_capture
from data.dataset import hem, learning, off_axis
from data.dataset.folder import MANIFEST
from data.dataset.hem import HemNetwork, misread
from data.dataset.off_axis import AZIMUTHS as LEARNED
from data.dataset.off_axis import OffAxisNetwork, main, silhouette
from data.pictures.mat import QUIET, near_markers
from sim.mesh import Mesh
from sim.rig import DISC_RIG, Rig

GROUND, CAMERA = Ground("a3", 1.0, 0.15), np.array([0.0, 0.03, 0.9])
RADII = np.full(AZIMUTHS, 0.106)
SHADOWED = np.abs(AZIMUTH - np.pi / 2) < np.pi / 7  # at the top
HEIGHT = 0.7


def around(*spans: tuple[int, int]) -> np.ndarray:
    """Azimuths between degrees."""
    degrees = np.degrees(AZIMUTH)
    return np.any([(degrees - first) % 360 < last - first for first, last in spans], axis=0)


@pytest.mark.parametrize(("spans", "words"), [
    ([(210, 240)], "at the lower left"),
    ([(-10, 10)], "at the right"),
    ([(80, 100), (105, 120), (170, 190)], "at the upper side and left"),
    ([(80, 100), (270, 272)], "at the upper side"),
    ([(0, 250)], "all around"),
    ([(k, k + 1) for k in range(0, 360, 10)], "all around"),
])
def test_parts_of_a_hem_are_named_by_their_side(spans, words):
    assert sides(around(*spans)) == words


def test_there_are_eight_sides():
    assert len({side(angle) for angle in AZIMUTH}) == 8
    assert (side(-np.pi / 2), side(-0.1), side(3 * np.pi / 4)) == (
        "lower side", "right", "upper left")


def over_markers(camera: np.ndarray) -> np.ndarray:
    """Where a hem is seen over markers from a camera."""
    return near_markers("a3", GROUND.behind_hem(RADII, camera), QUIET)


def test_a_hem_over_markers_is_named_and_is_clear_from_the_place_that_is_asked_for():
    """Of the markers along the lower side of a3; those of the upper one do not matter."""
    error = np.where(over_markers(CAMERA) & around((200, 340)), 2 * DOUBTFUL, 0.1 * DOUBTFUL)
    place, (found,) = Clarity.of(RADII, error, 0 * error, [CAMERA], GROUND).judged(RADII, [CAMERA])
    assert found.code == "hem_doubtful" and found.values["ground"] == "a marker"
    assert "the hem at the lower side lies over a marker" in found.text
    unclear = error > DOUBTFUL
    assert over_markers(place)[unclear].mean() < 0.5 * over_markers(CAMERA)[unclear].mean()
    assert np.hypot(*place[:2]) < MAX_LEAN * place[2]
    assert f"{10 * round(100 * place[2])} mm above the plate" in found.text


def test_the_next_place_is_another_than_those_before():
    """Where cloth and plain mat are alike, no place is better, so that the nearest new one counts.
    """
    places = [np.array([0.0, 0.0, 0.9])]
    unclear = around((120, 150)) & ~over_markers(places[0])
    for _ in range(3):
        places.append(GROUND.next_camera(0.7 * RADII, unclear, places))
    apart = [np.linalg.norm(one - other) for k, one in enumerate(places) for other in places[:k]]
    assert min(apart) > 0.03


def test_what_most_pictures_show_is_clear():
    error = np.where(around((0, 90)), 2 * DOUBTFUL, 0)
    unclear, clear = (Clarity.of(RADII, one, 0 * one, [], None) for one in (error, 0 * error))
    assert Clarity.together([unclear, clear]).judged(RADII, [CAMERA, CAMERA]) == (None, [])
    place, (found,) = Clarity.together([unclear, clear, unclear]).judged(RADII, [CAMERA] * 3)
    assert place is None and found.values["place"] == "at the upper right"
    assert "take another picture from another side" in found.text
    assert found.values["value"] == pytest.approx(0.25, abs=0.01)
    turned = unclear.turned(np.pi / 2)
    assert turned.doubtful[around((95, 175))].all() and not turned.doubtful[around((0, 85))].any()


def captured(folder, **picture):
    """A capture of a drawn photograph over the mat a3."""
    jpeg = photographs.over_mat(mat="a3", cloth=(30, 30, 30), **picture)
    return read_capture(photographs.write_over_mat(folder, jpeg, mat="a3"))


def test_a_picture_from_the_place_that_is_asked_for_is_clear(tmp_path):
    """Of a hem along the border of the paper, and of one that is seen from beside."""
    curve = 0.119 * photographs.AROUND
    bordering = captured(tmp_path / "bordering", curve=curve, beside=(0.0, 0.05))
    line, _ = texts(bordering.warnings)  # the other: cloth does not hang in a circle
    assert line.startswith("the hem at the lower side and upper side lies within 10 mm of the edge "
                           "of the mat's paper")
    x, y, height = bordering.outline.next_camera
    clear = captured(tmp_path / "clear", curve=curve, beside=(x, y), camera=0.15 + height)
    assert "hem_along_border" not in [one.code for one in clear.warnings]
    beside = captured(tmp_path / "beside", beside=(0.15, 0.1))
    line = texts(beside.warnings)[0]
    assert "the hem at the lower left, on the far side" in line
    assert "straight above the plate's centre" in line
    np.testing.assert_allclose(beside.outline.cameras[0], [0.15, 0.1, 1.05], atol=0.02)
    np.testing.assert_allclose(beside.outline.next_camera, [0, 0, 1.05], atol=0.01)


@pytest.fixture(scope="module")
def seen(shape):
    """Radii of the same cloth."""
    return silhouette(shape.positions, Mesh(shape.rest, shape.faces).edges, np.zeros(2), HEIGHT,
                      azimuths=AZIMUTHS)


@pytest.mark.parametrize("off", [
    pytest.param(lambda radii: np.where(SHADOWED, radii.max(), radii), id="shadow"),
    pytest.param(lambda radii: np.maximum(radii, np.where(
        SHADOWED, 0.138 / np.maximum(np.sin(AZIMUTH), 0.5), 0)), id="paper"),
    pytest.param(lambda radii: radii - 6e-3 * (SHADOWED & (np.cos(72 * AZIMUTH) > 0)),
                 id="stripes"),
    pytest.param(lambda radii: radii + 0.015 * SHADOWED, id="step"),
])
def test_what_no_cloth_has_is_named_with_its_side_and_carries_its_error(seen, off):
    sound, radii = unlike_cloth(seen, DISC_RIG), off(seen)
    assert sound.max() < 2e-3 and not jagged_hem(sound)
    error = unlike_cloth(radii, DISC_RIG)
    found, = jagged_hem(error)
    assert found.code == "hem_jagged" and found.values["place"] == "at the upper side"
    wrong = np.abs(radii - seen) > 4e-3
    assert np.median(error[wrong]) > 3e-3 > 4 * np.median(error[np.roll(SHADOWED, AZIMUTHS // 2)])


def test_errors_by_shape_turn_with_the_outline_and_grow_with_the_specimen(seen):
    radii = np.where(SHADOWED, seen.max(), seen)
    error = unlike_cloth(radii, DISC_RIG)
    np.testing.assert_allclose(unlike_cloth(np.roll(radii, 100), DISC_RIG), np.roll(error, 100),
                               rtol=1e-3)
    twice = Rig((0.6, 0.6), 0.36, "disc")
    np.testing.assert_allclose(unlike_cloth(2 * radii, twice), 2 * error, rtol=1e-3)


@pytest.mark.parametrize(("step", "warned"), [(4, True), (12, False)])
def test_of_a_table_whose_points_are_apart_the_shape_is_not_judged(seen, tmp_path, step, warned):
    """Their polygon has corners of its own."""
    points = 1e3 * (np.where(SHADOWED, seen.max(), seen)[:, None] * OUTWARDS)[::step]
    np.savetxt(tmp_path / "outline.csv", points, delimiter=",", header="x_mm,y_mm", comments="")
    (tmp_path / "capture.yaml").write_text(yaml.safe_dump({
        "density_g_m2": 150, "tester": "disc300_support180", "warp_direction_deg": 0,
        "outline": {"camera_height_mm": 1e3 * HEIGHT, "y_axis": "up"}}))
    found = [one.code for one in read_capture(tmp_path).warnings]
    assert found == ["hem_jagged"] * warned


def test_half_of_the_outlines_that_are_learned_are_misread(seen):
    rng = np.random.default_rng(0)
    radius, plate = seen / 0.3, 0.3
    read = np.array([misread(radius, plate, rng) for _ in range(200)])
    assert read.min() > 0.28
    off = 300 * np.abs(read - radius).max(axis=1)
    assert 0.2 < (off > 3).mean() < 0.5 and np.median(off) < 2


def rms_mm(one: np.ndarray, other: np.ndarray) -> float:
    return 1e3 * float(np.sqrt(np.square(one - other).mean()))


def corrected(radius: np.ndarray, beside: np.ndarray, rig: Rig = DISC_RIG) -> np.ndarray:
    found = seen_from_axis(radius[:, None] * OUTWARDS, beside, HEIGHT, rig)
    assert found.shape == (720, 2)
    return np.linalg.norm(found, axis=1)


def test_most_of_what_a_camera_beside_the_axis_changes_is_taken_back(shape):
    edges = Mesh(shape.rest, shape.faces).edges
    exact = silhouette(shape.positions, edges, np.zeros(2), HEIGHT, azimuths=720)
    for distance, turn in ((0.06, 0.3), (0.12, 2.0), (0.2, 4.5)):
        beside = distance * np.array([np.cos(turn), np.sin(turn)])
        seen = silhouette(shape.positions, edges, beside, HEIGHT, azimuths=720)
        assert rms_mm(seen, exact) > 1.5
        # By the distance of each part of the hem alone, a quarter to a third would remain.
        assert rms_mm(corrected(seen, beside), exact) < 0.2 * rms_mm(seen, exact)


@pytest.mark.parametrize("rig", [DISC_RIG, Rig((0.2, 0.25), 0.1, "rectangle")],
                         ids=lambda rig: rig.specimen)
def test_on_the_axis_the_outermost_points_stay(rig):
    radius = 0.12 + 0.01 * np.cos(7 * AZIMUTH + 1) + 0.002 * np.cos(31 * AZIMUTH)
    np.testing.assert_allclose(corrected(radius, np.zeros(2), rig), radius, atol=1e-6)


def test_a_camera_around_a_disc_finds_the_same_outline():
    radius, beside = 0.12 + 0.01 * np.cos(7 * AZIMUTH + np.cos(AZIMUTH)), np.array([0.1, 0.05])
    turned = beside @ [[0, 1], [-1, 0]]
    np.testing.assert_allclose(corrected(np.roll(radius, 180), turned),
                               np.roll(corrected(radius, beside), 180), atol=1e-6)


def test_torch_is_not_imported_before_it_is_needed():
    code = "import data.captures.off_axis, sys; assert 'torch' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize(("command", "options", "network", "bundled", "said"), [
    (off_axis, ["cameras=2"], OffAxisNetwork, BUNDLED, "place/height"),
    (hem, [], HemNetwork, HEM, "correlation of log errors"),
], ids=["off_axis", "hem"])
def test_networks_are_trained_alike_twice_and_stored_small(
        command, options, network, bundled, said, cloth_dataset, tmp_path, capsys, monkeypatch):
    files = [tmp_path / name for name in ("first.safetensors", "second.safetensors")]
    for file in files:
        command.main([f"data={cloth_dataset}", f"out={file}", "steps=3", *options])
        # A graph takes seconds; once is enough.
        monkeypatch.setattr(learning, "save_graph", lambda *_, **__: None)
    assert files[0].read_bytes() == files[1].read_bytes()
    assert len(files[0].read_bytes()) == len(bundled.read_bytes()) < 80_000
    network().load_state_dict(load_file(files[0]))
    assert said in capsys.readouterr().out


def test_silhouettes_are_those_of_points_on_the_plane_of_the_plate():
    corners = np.array([[0.1, 0.1], [-0.1, 0.1], [-0.1, -0.1], [0.1, -0.1]])
    square = np.column_stack([corners, np.full(4, -0.1)])
    edges = np.array([[0, 1], [1, 2], [2, 3], [3, 0]])
    seen = silhouette(square, edges, np.array([0.35, 0.0]), HEIGHT)
    # A point 0.1 m below the plate is moved by an eighth of the camera's place.
    assert seen[[0, LEARNED // 2]] == pytest.approx([0.0875 + 0.04375, 0.0875 - 0.04375])


def test_without_drapes_one_line_names_the_command(cloth_dataset, tmp_path):
    out = f"out={tmp_path / 'net.safetensors'}"
    with pytest.raises(InputError, match=r"dataset\.json is missing.*data\.dataset\.generate"):
        main([f"data={tmp_path}", out])
    (tmp_path / MANIFEST).write_bytes((cloth_dataset / MANIFEST).read_bytes())
    with pytest.raises(InputError, match="no drapes to train on"):
        main([f"data={tmp_path}", out])
