"""Files for Browzwear's VStitcher."""

import json

import pytest
from exported import ALPHA, BETA, IN_A_DRAPE, exported


def test_browzwear_gets_dyne_centimetres_and_a_main_file_that_names_them(estimate):
    file = exported(estimate, "u3m")
    physics = json.loads(file.read_text())["material"]["physics"]
    assert physics["weight"] == 210
    fab = json.loads((file.parent / physics["devices"]["fab"]).read_text())
    assert set(fab) == {"schema", "raw_data", "custom"} and fab["raw_data"] is None
    bend = fab["custom"]["browzwear"]["bend"]
    assert float(bend["length"]) * 1e-5 * 1e-2 == pytest.approx(IN_A_DRAPE[0])
    assert float(bend["width"]) * 1e-5 * 1e-2 == pytest.approx(IN_A_DRAPE[2])
    assert "thickness" not in fab["custom"]["browzwear"]


def test_browzwear_gets_all_that_is_known(known):
    file = exported(known, "u3m")
    custom = json.loads((file.parent / "fabric.fab.json").read_text())["custom"]
    found = custom["browzwear"]
    assert (float(found["thickness"]), float(found["friction"])) == (0.42, 0.31)
    assert json.loads(file.read_text())["material"]["physics"]["thickness"] == 0.42  # mm
    assert {key: float(value) for key, value in found["stretch"].items()} == {
        "length": 900.0, "width": 400.0} and float(found["shear"]) == 35.0
    assert custom["drapenet"]["tool_defaults"] == [
        "hysteresis", "shear_linearity", "shrink", "stretch_linearity"]


def test_the_secant_stands_for_the_law_where_it_is_wanted(estimate):
    fab = exported(estimate, "u3m", curvature_1_m=30.0).parent / "fabric.fab.json"
    bend = json.loads(fab.read_text())["custom"]["browzwear"]["bend"]
    assert float(bend["length"]) * 1e-7 == pytest.approx(ALPHA[0] + 30 * BETA[0])
