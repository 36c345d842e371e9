"""Recordings of a turntable: stops are found, and what the files say is read."""

import sqlite3
from pathlib import Path

import numpy as np
import pytest
from turntable import FILE, turntable, write_bag

from common.errors import InputError
from data.captures.capture import read_capture
from data.captures.rosbag import find_rests, median_depth, read_recording


@pytest.fixture(scope="module")
def table() -> tuple:
    return turntable()


def assert_stops(frames: np.ndarray, stops: np.ndarray) -> None:
    assert frames.shape == stops.shape
    assert np.abs(frames * 1e3 - stops).max() < 1e-3  # no hole, no frame of a movement


def test_stops_of_a_bag(table, tmp_path):
    shown, stops, intrinsics = table
    write_bag(tmp_path / "a.bag", shown, intrinsics)
    frames, found = read_recording(tmp_path / "a.bag")
    assert_stops(frames, stops)
    assert found == intrinsics
    write_bag(tmp_path / "b.bag", shown, intrinsics, unit=5e-4)
    assert np.allclose(read_recording(tmp_path / "b.bag")[0], frames / 2)
    assert np.allclose(read_recording(tmp_path / "b.bag", 1e-3)[0], frames)


def test_stops_of_a_file_that_librealsense_recorded(table):
    _, stops, intrinsics = table
    frames, found = read_recording(FILE)
    assert_stops(frames, stops)
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
    ("a.bag", lambda file, table: write_bag(file, table[0], table[2], lens=0.1), "distorted"),
    ("a.bag", lambda file, table: write_bag(file, table[0][:0], table[2]), "no depth pictures"),
    ("a.db3", lambda file, table: sqlite3.connect(file).execute("create table a (b)"),
     "cannot be read"),
    ("a.bag", lambda file, table: write_bag(file, table[0][:, :20, :20], table[2]), "20x20 pixels"),
])
def test_bad_recordings_are_refused_in_one_line(table, tmp_path, name, make, message):
    make(tmp_path / name, table)
    with pytest.raises(InputError, match=message) as raised:
        read_recording(tmp_path / name)
    assert "\n" not in str(raised.value)
