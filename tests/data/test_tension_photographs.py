"""Extensions by photographs over the mat: rendered pairs, stated marks, faults."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import yaml

from common.errors import InputError
from data.pictures.pose import Pose
from data.render.pulled import MarkedStrip
from drapenet.measured.tension.folder import TensionSet, read_tension
from drapenet.measured.tension.photograph import find_strip

PAIR = {"direction": "bias", "width_mm": 50.0, "gauge_mm": 100.0, "load_g": 50.0,
        "without": "bias_0.jpg", "with": "bias_50.jpg"}
STRAIN = 0.05
LENS = (26.0, 0.01)


@cache
def pictures() -> tuple[MarkedStrip, tuple[bytes, bytes], tuple[Pose, Pose]]:
    """A dark strip on a white mat, without and with a weight, turned by half a turn between."""
    rng = np.random.default_rng([7, 13])
    strip = MarkedStrip.random(rng, gauge=0.1, width=0.05)
    strip = MarkedStrip(**{**vars(strip), "cloth": lambda places: np.full((len(places), 3), 0.08),
                           "marks": tuple(_light(mark) for mark in strip.marks)})
    poses = strip.pose(rng, LENS), strip.pose(rng, LENS)
    files = tuple(strip.photograph(pose, rng, stretch=1 + share, narrow=1 - 0.7 * share, turn=turn,
                                   place=(0.004, -0.003))
                  for pose, share, turn in zip(poses, (0.0, STRAIN), (0.1, np.pi), strict=True))
    return strip, files, poses


def _light(mark):
    return type(mark)(**{**vars(mark), "ink": np.full(3, 0.7), "cover": 0.9, "thickness": 1.2e-3})


def read(folder: Path, **stated) -> TensionSet:
    """A folder with the pair; ``stated`` replaces keys of its entry, or of the file."""
    for name, data in zip(("bias_0.jpg", "bias_50.jpg"), pictures()[1], strict=True):
        (folder / name).write_bytes(data)
    entry = PAIR | {key: value for key, value in stated.items() if key in (*PAIR, "marks_px",
                                                                           "extension_mm")}
    others = {key: value for key, value in stated.items() if key not in entry}
    (folder / "tension.yaml").write_text(yaml.safe_dump(
        {"density_g_m2": 210, "tension": [entry]} | others))
    return read_tension(folder)


def true_extension() -> float:
    strip = pictures()[0]
    return strip.gauge(1 + STRAIN) - strip.gauge()


def test_a_pair_gives_the_extension_with_its_error(tmp_path):
    found = read(tmp_path)
    photographs, strip = found.photographs[0], pictures()[0]
    assert photographs.extension == pytest.approx(true_extension(), abs=2e-4)
    assert abs(photographs.extension - true_extension()) < 2.5 * photographs.error < 4e-4
    assert photographs.gauge == pytest.approx(strip.gauge(), abs=3e-4)
    assert photographs.width == pytest.approx(strip.width, abs=2e-3)
    measured = found.strips[0]
    assert (measured.extension, measured.error) == (photographs.extension, photographs.error)
    assert not found.warnings


def test_marks_are_where_they_were_drawn(tmp_path):
    strip, _, poses = pictures()
    seen = read(tmp_path).photographs[0].courses[0]
    for mark, course in zip(strip.marks, seen, strict=True):
        middle = np.nanmean(course, axis=0)
        along = float(mark.at(np.linspace(-0.4, 0.4, 81)).mean())
        place = np.array([0.004 + along * np.cos(0.1), -0.003 + along * np.sin(0.1), 0.0])
        assert middle == pytest.approx(poses[0].pixels_of(place[None])[0], abs=3)  # 1 mm


def test_stated_marks_give_the_same(tmp_path):
    found = read(tmp_path).photographs[0]
    marks = {name: [[float(x) for x in np.nanmean(course, axis=0) + 2] for course in courses]
             for name, courses in zip(("without", "with"), found.courses, strict=True)}
    stated = read(tmp_path, marks_px=marks).photographs[0]
    assert stated.extension == pytest.approx(found.extension, abs=1.5e-4)
    with pytest.raises(InputError, match=r"bias_0[.]jpg: marks_px=.* is not in the picture"):
        read(tmp_path, marks_px=marks | {"without": [[-5.0, 10.0], [100.0, 10.0]]})


def test_the_printed_bar_scales_lengths_and_a_strip_of_another_width_is_named(tmp_path):
    one, other = (read(tmp_path, mat_bar_mm=bar).photographs[0] for bar in (200.0, 196.0))
    assert other.extension == pytest.approx(0.98 * one.extension, rel=0.02)
    assert other.gauge == pytest.approx(0.98 * one.gauge, rel=2e-3)
    assert [finding.code for finding in read(tmp_path, width_mm=60.0).warnings] == [
        "tension_width_differs"]


@pytest.mark.parametrize("askew", [0, 1])
def test_a_band_that_is_found_askew_is_named_and_gives_the_same(tmp_path, monkeypatch, askew):
    straight = read(tmp_path).photographs[0]
    found = iter((0, 1))

    def turned(picture, width):
        strip = find_strip(picture, width)
        angle = np.radians(5.0 * (next(found) == askew))  # 0.4 mm of a gauge of 100 mm
        cos, sin = np.cos(angle), np.sin(angle)
        return replace(strip, along=np.array([[cos, -sin], [sin, cos]]) @ strip.along)

    monkeypatch.setattr("drapenet.measured.tension.photograph.find_strip", turned)
    read_askew = read(tmp_path)
    assert read_askew.photographs[0].extension == pytest.approx(straight.extension, abs=1e-4)
    warning, = read_askew.warnings
    assert (warning.code, warning.values["value"]) == ("tension_askew", pytest.approx(5, abs=1))


@pytest.mark.parametrize(("stated", "words"), [
    ({"without": "bias_50.jpg", "with": "bias_0.jpg"}, "are the pictures exchanged"),
    ({"gauge_mm": 150.0}, r"bias_0[.]jpg: no two lines across the strip are seen 138 to 162 mm"),
])
def test_faults_are_refused_in_one_line(tmp_path, stated, words):
    with pytest.raises(InputError, match=words) as error:
        read(tmp_path, **stated)
    assert "\n" not in str(error.value)


def test_a_picture_without_a_strip_or_without_a_mat_is_refused(tmp_path):
    rng = np.random.default_rng(3)
    strip, _, poses = pictures()
    bare = MarkedStrip(**{**vars(strip), "width": 1e-4})
    read(tmp_path)
    (tmp_path / "bias_0.jpg").write_bytes(bare.photograph(poses[0], rng))
    with pytest.raises(InputError, match=r"bias_0[.]jpg: no strip of 50 mm is seen that differs"):
        read_tension(tmp_path)
    far = MarkedStrip(**{**vars(strip), "length": 1.5, "width": 1.0})
    (tmp_path / "bias_0.jpg").write_bytes(far.photograph(poses[0], rng))
    with pytest.raises(InputError, match="fewer than six markers of the mat are seen"):
        read_tension(tmp_path)
