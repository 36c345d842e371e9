"""Values of testers alone: to an estimate, to files for tools, and back."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from data.captures.description import Labels
from data.readings import QUANTITIES
from data.readings.quantity import moduli_at
from drapenet.config import EstimateOptions
from drapenet.convert import convert, main
from drapenet.evidence.state import cloth_of_state, fabric_prior, state_of
from drapenet.fabric.estimate import estimate_fabric
from drapenet.fabric.sources import Source
from drapenet.measured.values import ValuesDescription, ValueSet
from drapenet.network.checkpoint import BUNDLED, read_header
from sim.material import DRAPE_CURVATURE, secant

pytestmark = pytest.mark.skipif(not BUNDLED.exists(), reason="no network is bundled")
DENSITY = 0.21


def readings(cloth, name: str, noise=0.0) -> dict[str, float]:
    """What a tester reads of a cloth, along warp and weft."""
    values = QUANTITIES[name].of(cloth, DENSITY)[0] * np.exp(QUANTITIES[name].error * noise)
    return {"warp": float(values[0]), "weft": float(values[2])}


def test_readings_of_a_fabric_come_back_from_the_files_of_tools(tmp_path):
    cloth = cloth_of_state(state_of(fabric_prior(read_header("")))[[2]])
    convert(out=tmp_path, export="u3m", density_g_m2=1e3 * DENSITY, shear_n_per_m=31.0,
            stretch_warp_n_per_m=4000.0, kes_emt_weft_percent=8.0, known={
                name: readings(cloth, name) for name in ("bending_length_mm", "overhang_mm")})
    written = json.loads((tmp_path / "fabric.fab.json").read_text("utf-8"))["custom"]
    stated = json.loads((tmp_path / "estimate.json").read_text("utf-8"))
    assert [one["code"] for one in stated["warnings"]] == 2 * ["value_repeated"]
    assert "By 1 value of a tester. " in (tmp_path / "report.html").read_text("utf-8")
    card = written["browzwear"]
    for key, (yarns, true) in zip(("length", "width"), readings(
            cloth, "browzwear_bend_dyn_cm").items(), strict=True):
        low, high = stated["moduli"][yarns]["drape_stiffness_uN_m"]["interval_68"]
        assert 10 * low < true < 10 * high and 10 * low < float(card["bend"][key]) < 10 * high
    assert float(card["shear"]) == pytest.approx(31, rel=0.03)
    assert float(card["stretch"]["length"]) == pytest.approx(4000, rel=0.03)
    assert 3500 < float(card["stretch"]["width"]) < 490.3 / 0.08  # a secant, without crimp
    first, second = written["drapenet"]["assumed"]
    assert "measured along warp and weft alone" in first and "bending length [mm] 5 %" in second


def test_intervals_hold_the_truth_as_often_as_they_state():
    header, rng, inside = read_header(""), np.random.default_rng(5), []
    states = state_of(fabric_prior(header))
    for row in rng.permutation(len(states))[:80]:
        cloth = cloth_of_state(states[[row]])
        values = readings(cloth, "bending_length_mm", rng.standard_normal(3))
        if min(values.values()) < 5:
            continue  # which is refused
        source = ValueSet.of(ValuesDescription.of(
            {"density_g_m2": 210, "known": {"bending_length_mm": values}}, ""), Path("values"))
        found = estimate_fabric([Source(place=source)], header, EstimateOptions(drapes=0)).estimate
        samples, (true,) = (secant(DRAPE_CURVATURE, *of)
                            for of in (found.moduli(), moduli_at(cloth, DENSITY)))
        low, high = np.quantile(samples, (0.16, 0.84), axis=0)
        inside.append((low < true) & (true < high))
    assert 0.60 < np.mean(inside) < 0.78  # of 400 fabrics 0.72


def test_a_bench_is_a_file_for_the_command(tmp_path, capsys):
    (tmp_path / "values.yaml").write_text(yaml.safe_dump({
        "weight_g": 2.1, "specimen_cm2": 100, "temperature_c": 20, "conditioning_h": "ISO 139",
        "tester": "disc300_support180", "known": {
            "overhang_mm": {"warp": 44.0}, "drape_coefficient_percent": 52.0,
            "friction_deg": {"fabric": 24.0}},
        "tension": [{"direction": "weft", "width_mm": 50, "gauge_mm": 200, "load_g": 1020,
                     "extension_mm": 9.0}]}))
    main([f"values={tmp_path}", f"out={tmp_path / 'out'}", "export=jfab", "fabric=Twill 7"])
    printed = capsys.readouterr().out
    assert "1 capture and 1 strip under a weight" in printed and "at 210 g/m²" in printed
    assert "fabric.jfab" in printed and "errors were assumed" in printed
    card = json.loads((tmp_path / "out/fabric.jfab").read_text("utf-8"))["mapPhysical"]
    assert card["fFriction"] == pytest.approx(0.445, abs=1e-3) and 3e6 < card["fSuK"] < 5e6
    page = (tmp_path / "out/report.html").read_text("utf-8")
    assert "20 °C, conditioned (h): ISO 139" in page and "Twill 7" in page
    main([f"values={tmp_path}", f"out={tmp_path / 'out'}", "weight_g=2.4", "export="])
    assert "at 240 g/m²" in capsys.readouterr().out  # nothing stored of the values before


def test_conditions_of_captures_are_joined():
    joined = Labels.joined([Labels(temperature_c="20"), Labels(temperature_c="23.5")])
    assert joined.conditions == "20 / 23.5 °C"
