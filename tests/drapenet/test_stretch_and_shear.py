"""Stretch and shear of strips under weights in estimates: alone, beside others, in batches."""

import csv
import io
import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image
from workbooks import cells

import drapenet
import infer
from common.errors import InputError

EXAMPLES = Path(__file__).parents[2] / "examples" / "captures"
BIAS = {"direction": "bias", "width_mm": 50, "gauge_mm": 100, "load_g": 50, "extension_mm": 4.1}
WARP = {"direction": "warp", "width_mm": 50, "gauge_mm": 200, "load_g": 500, "extension_mm": 4.2}
KNOWN = {"thickness_mm": 0.42, "thickness_kpa": 0.2, "friction_deg": {"fabric": 24, "board": 18.5}}


def folder(path: Path, *strips: dict, **stated) -> Path:
    path.mkdir(parents=True)
    (path / "tension.yaml").write_text(yaml.safe_dump(
        {"density_g_m2": 210, "tension": list(strips or (BIAS, WARP))} | stated))
    return path


def content(path: Path) -> dict:
    return json.loads((path / "estimate.json").read_text())


def test_alone_and_beside_strips_and_a_capture(tmp_path, capsys):
    tension = folder(tmp_path / "t", known=KNOWN)
    infer.main([f"tension={tension}", f"out={tmp_path / 'alone'}"])
    printed = capsys.readouterr().out
    assert "by strips under weights: shear " in printed and "weight that stretches" in printed
    alone = content(tmp_path / "alone")["tension"]
    low, high = alone["shear_n_per_m"]["interval_90"]
    # Load over four times the extension, 60, without the yarns' stretch.
    assert low < 60 < high and 50 < alone["shear_n_per_m"]["median"] < 75
    assert 3000 < alone["stretch_n_per_m"]["warp"]["median"] < 5000
    assert alone["measured"] == ["warp", "bias"]
    page = (tmp_path / "alone" / "report.html").read_text()
    assert "Stretch and shear" in page and "thickness: 0.42 mm at 0.2 kPa" in page
    assert "slides on board at: 18.5°" in page and "By 2 strips under weights" in page
    assert "the strips as they were read, with marks, loads and extensions" in page
    picture = np.asarray(Image.open(tmp_path / "alone" / "strips.png").convert("RGB")).astype(int)
    points = (picture[..., 0] > 150) & (picture[..., 1:] < 90).all(axis=2)  # of both directions
    assert points[:, : points.shape[1] // 2].any() and points[:, points.shape[1] // 2 :].any()

    infer.main([f"tension={tension}", f"capture={EXAMPLES / 'twill'}", f"out={tmp_path / 'both'}",
                "drapes=0"])
    both, plain = content(tmp_path / "both"), drapenet.estimate(EXAMPLES / "twill")
    assert both["tension"] == alone and len(both["captures"]) == 1
    assert not (tmp_path / "both" / "report.html").exists()  # of drapes=0
    assert both["moduli"]["warp"]["alpha_uN_m"]["median"] == pytest.approx(
        1e6 * float(sorted(plain.moduli()[0][:, 0])[len(plain.samples) // 2]), rel=0.01)
    found = drapenet.load(tmp_path / "both")
    assert found.names == ("warp", "bias", "weft")


def test_python_and_batches_take_the_folder(tmp_path):
    tension = folder(tmp_path / "root" / "denim" / "strips",
                     known={"friction_deg": {"fabric": 24}})
    assert drapenet.estimate(tension=tension).density == pytest.approx(0.21)
    infer.main([f"captures={tmp_path / 'root'}", f"out={tmp_path / 'out'}", "workers=1"])
    tension = content(tmp_path / "out" / "denim")["tension"]
    assert tension["strips"] == 2
    warp, shear = (tension[f"{name}_n_per_m"] for name in ("stretch", "shear"))
    row, = csv.DictReader(io.StringIO((tmp_path / "out" / "fabrics.csv").read_text()))
    assert float(row["stretch_warp_n_per_m"]) == pytest.approx(warp["warp"]["median"], rel=1e-5)
    assert float(row["shear_n_per_m_high68"]) == pytest.approx(shear["interval_68"][1], rel=1e-5)
    assert row["stretch_weft_n_per_m"] == ""  # not measured
    found = [line.get("stretch, of bias: shear median [N/m]")
             for line in cells(tmp_path / "out" / "results.xlsx", 1)]
    assert found == [pytest.approx(warp["warp"]["median"]), pytest.approx(shear["median"]), None]


def test_contradictions_are_warnings_and_refused_if_strict(tmp_path):
    wrong = folder(tmp_path / "t", BIAS, BIAS | {"load_g": 1000, "extension_mm": 8})
    infer.main([f"tension={wrong}", f"out={tmp_path / 'out'}", "drapes=0"])
    assert [one["code"] for one in content(tmp_path / "out")["warnings"]] == ["tension_differs"]
    with pytest.raises(InputError, match="contradict each other"):
        infer.main([f"tension={wrong}", f"out={tmp_path / 'strict'}", "strict=true"])


def test_strips_along_the_yarns_need_a_marked_warp_and_those_of_the_bias_none(tmp_path):
    photograph = tmp_path / "capture"
    photograph.mkdir()
    (photograph / "capture.yaml").write_text(yaml.safe_dump({
        "density_g_m2": 210, "tester": "disc300_support180",
        "known": {"drape_coefficient_percent": 50}}))
    bias, warp = folder(tmp_path / "bias", BIAS), folder(tmp_path / "warp", WARP)
    assert drapenet.estimate(photograph, tension=bias).names[0] == "stiff"
    with pytest.raises(InputError, match="need captures whose warp is marked"):
        drapenet.estimate(photograph, tension=warp)
