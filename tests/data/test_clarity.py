"""What of a hem is not clearly seen, in words, and from where another picture shows it."""

import numpy as np
import photographs
import pytest
import yaml

from common.findings import texts
from data.captures.clarity import DOUBTFUL, Clarity, side, sides
from data.captures.ground import Ground
from data.captures.off_axis import AZIMUTH, AZIMUTHS, MAX_LEAN
from data.captures.reader import read_capture
from data.pictures.mat import QUIET, near_markers

GROUND, CAMERA = Ground("a3", 1.0, 0.15), np.array([0.0, 0.03, 0.9])
RADII = np.full(AZIMUTHS, 0.106)


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
    place, (found,) = Clarity.of(RADII, error, [CAMERA], GROUND).judged(RADII, [CAMERA])
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
    unclear, clear = (Clarity.of(RADII, one, [], None) for one in (error, 0 * error))
    assert Clarity.together([unclear, clear]).judged(RADII, [CAMERA, CAMERA]) == (None, [])
    place, (found,) = Clarity.together([unclear, clear, unclear]).judged(RADII, [CAMERA] * 3)
    assert place is None and found.values["place"] == "at the upper right"
    assert "take another picture from another side" in found.text
    assert found.values["value"] == pytest.approx(0.25, abs=0.01)
    turned = unclear.turned(np.pi / 2)
    assert turned.doubtful[around((95, 175))].all() and not turned.doubtful[around((0, 85))].any()


def captured(folder, **picture):
    """A capture of a drawn photograph over the mat a3."""
    folder.mkdir()
    (folder / "outline.jpg").write_bytes(photographs.over_mat(mat="a3", cloth=(30, 30, 30),
                                                              **picture))
    (folder / "capture.yaml").write_text(yaml.safe_dump({
        "density_g_m2": 150, "tester": "disc300_support180",
        "outline": {"mat": "a3", "plate_height_mm": 150}}))
    return read_capture(folder)


def test_a_picture_from_the_place_that_is_asked_for_is_clear(tmp_path):
    """Of a hem along the border of the paper, and of one that is seen from beside."""
    curve = 0.119 * photographs.AROUND
    bordering = captured(tmp_path / "bordering", curve=curve, beside=(0.0, 0.05))
    line, = texts(bordering.warnings)
    assert line.startswith("the hem at the lower side and upper side lies within 10 mm of the edge "
                           "of the mat's paper")
    x, y, height = bordering.outline.next_camera
    assert not captured(tmp_path / "clear", curve=curve, beside=(x, y), camera=0.15 + height
                        ).warnings
    beside = captured(tmp_path / "beside", beside=(0.15, 0.1))
    line = texts(beside.warnings)[0]
    assert "the hem at the lower left, on the far side" in line
    assert "straight above the plate's centre" in line
    np.testing.assert_allclose(beside.outline.cameras[0], [0.15, 0.1, 1.05], atol=0.02)
    np.testing.assert_allclose(beside.outline.next_camera, [0, 0, 1.05], atol=0.01)
