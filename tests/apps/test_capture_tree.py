"""Captures in the folders of a tree are checked together."""

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from apps import capture
from common.errors import InputError


def write(folder: Path, radius_mm: float) -> None:
    folder.mkdir(parents=True)
    angle = np.arange(180) * (2 * np.pi / 180)
    radius = radius_mm + 8 * np.cos(6 * angle)
    np.savetxt(folder / "outline.csv", np.c_[radius * np.cos(angle), radius * np.sin(angle)],
               "%.3f", ",", header="x,y", comments="")
    (folder / "capture.yaml").write_text(yaml.safe_dump({
        "density_g_m2": 200, "tester": "disc300_support180", "warp_direction_deg": 0,
        "outline": {"unit": "mm", "centred": True, "camera_height_mm": 1200}}))


def test_all_captures_of_a_tree_are_checked_and_none_stops_it(tmp_path, capsys):
    for name, radius in (("a/face", 115.0), ("b/face", 500.0), ("c/back", 115.0)):
        write(tmp_path / "in" / name, radius)
    (tmp_path / "in/c/back/capture.yaml").write_text("tester: [\n")
    (tmp_path / "in/d").mkdir()
    (tmp_path / "in/d/values.yaml").write_text("{density_g_m2: 210, known: {membrane_n_per_m: 99}}")
    with pytest.raises(InputError, match="2 of 4 captures have faults"):
        capture.main([f"frames={tmp_path / 'in'}", f"out={tmp_path / 'out'}"])
    rows = list(csv.DictReader((tmp_path / "out/checks.csv").open()))
    assert [(row["capture"], row["state"]) for row in rows] == [
        ("a/face", "sound"), ("b/face", "refused"), ("c/back", "refused"), ("d/d", "sound")]
    assert "drape coefficient" in rows[0]["measured"] and "scale" in rows[1]["faults"]
    assert "a/face: sound" in capsys.readouterr().out
    assert (tmp_path / "out/a/face/outline.csv").exists()
    sheet = cv2.imread(str(tmp_path / "out/checks.png"))
    assert (sheet[40:, :360] < 128).any() and not (sheet[40:, 360:720] < 250).any()
