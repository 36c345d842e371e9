"""Drawn photographs of rectangles: read or refused, and held against pretended drapes."""

import json

import numpy as np
import pytest

import experiments.physics.photographs
from common.errors import InputError
from data.captures.photograph import signed_area
from experiments.physics.photographs import (
    HARMONICS,
    KINDS,
    READINGS,
    TABLE,
    Row,
    crossings,
    drape_case,
    run,
)
from experiments.shadows import POINTS
from tests.photographs import CURVE, RADIUS, drawn, write

AREA_CM2 = 1e4 * signed_area(CURVE)
NUMBERS = {"short_mm": 240, "long_mm": 300, "plate_mm": 180, "area_cm2_published": AREA_CM2,
           "drape_coefficient_percent_published": 40, "mm_per_px": 0.4}


def fill(folder, *rows):
    """Write the table; each row has a file and changed cells."""
    lines = [",".join(Row.model_fields)]
    for file, changes in rows:
        cells = {"file": file} | NUMBERS | changes
        lines.append(",".join(str(cells[name]) for name in Row.model_fields))
    (folder / TABLE).write_text("\n".join(lines) + "\n", encoding="utf-8")


def pretend(*, alpha, seeds, **_):
    """Drapes that are wider the stiffer the cloth, of seven folds, and fail once."""
    radii = (RADIUS[:: len(RADIUS) // POINTS] * (0.9 + 0.1 * np.log10(alpha)))[None]
    return {"failed": 1, "depths_mm": [90.0 + alpha] * (seeds - 1), "arrays": {
        name: np.repeat(scale * radii, seeds - 1, axis=0) for name, (_, scale) in READINGS.items()}}


@pytest.fixture
def config(tmp_path, monkeypatch):
    """Settings of a short comparison with a sound photograph, a wrong area and a bare ground."""
    monkeypatch.setattr(experiments.physics.photographs, "drape_case", pretend)
    folder = write(tmp_path / "pictures", drawn(), "sound.png")
    write(folder, drawn(), "wrong.png")
    write(folder, 0 * drawn() + 200, "bare.png")
    fill(folder, ("sound.png", {}), ("wrong.png", {"area_cm2_published": 1.1 * AREA_CM2}),
         ("bare.png", {}), ("missing.png", {}))
    return {"photographs": str(folder), "alphas": [1.0, 5.0, 30.0], "ratio_mm": -2.5,
            "hysteresis": 0.17, "edge_mm": 9.0, "seeds": 3, "workers": 1,
            "cases": str(tmp_path / "cases")}


def test_photographs_are_read_or_refused_and_the_sound_ones_compared(config):
    report, figure = run(config)
    json.dumps(report, allow_nan=False)
    photographs = report["photographs"]
    assert [one["read"] for one in photographs.values()] == [True, True, False, False]
    assert photographs["sound.png"]["ratio"] == pytest.approx(1, abs=3e-3)
    assert photographs["wrong.png"]["ratio"] == pytest.approx(1 / 1.1, abs=3e-3)
    assert "plate's centre is not known" in photographs["sound.png"]["warnings"][-1]
    for name, reason in (("bare", "differs from its ground"), ("missing", "cannot be read")):
        assert reason in photographs[f"{name}.png"]["reason"]
        assert photographs[f"{name}.png"]["ratio"] is None
    assert (report["read"], report["sound"], report["of"], report["failed"]) == (2, 1, 4, 6)
    summaries = [report["summary"][reading][kind] for reading in READINGS for kind in KINDS]
    for summary in summaries:
        assert summary["photographs"] == 1 and summary["outside"] == []
        assert summary["alpha_uN_m"] == pytest.approx(10, rel=0.15)
        assert summary["folds"] == {"real": 7, "simulated": 7, "rms": 0, "scatter": 0}
        for name in ("real", "simulated"):
            assert len(summary["spectrum_mm"][name]) == len(HARMONICS)
            assert np.argmax(summary["spectrum_mm"][name]) == 6
    scale = READINGS["as the bare plate shows"][1]
    deviations = [summary["deviation_mm"]["real"] for summary in summaries]
    assert deviations[-1] == pytest.approx(scale * deviations[0])
    assert len(figure.axes) == 3


def test_a_coefficient_outside_of_the_grid_is_named(config):
    report, figure = run(config | {"alphas": [1.0, 5.0]})
    assert [axes.axison for axes in figure.axes] == [True, False, False]
    for name, kinds in report["summary"].items():
        for kind, summary in kinds.items():
            assert summary == {"photographs": 0, "outside": ["sound.png"]}
            row = report["readings"][name][kind]["sound.png"]
            assert row["alphas_uN_m"] == [] and max(row["coefficients"]) < row["real"][0]


def test_the_softest_fabric_counts_where_the_coefficient_is_not_monotonic():
    places, values = np.arange(5.0), np.array([0.1, 0.3, 0.2, 0.4, 0.5])
    assert crossings(places, values, 0.25) == pytest.approx([0.75, 1.5, 2.25])
    assert crossings(places, values, 0.45) == pytest.approx([3.5])
    assert not len(crossings(places, values, 0.6))


def test_no_sound_photograph_leaves_no_comparison(config, tmp_path):
    fill(tmp_path / "pictures", ("bare.png", {}))
    report, figure = run(config)
    assert figure is None and report["sound"] == 0
    assert {summary["photographs"] for kinds in report["summary"].values()
            for summary in kinds.values()} == {0}


@pytest.mark.parametrize("kind", KINDS)
def test_drapes_of_both_kinds_are_seen_in_all_readings(kind):
    found = drape_case(kind=kind, tester="rectangle160x200_cylinder100", alpha=100.0,
                       ratio_mm=-2.5, hysteresis=0.17, edge_mm=10.0, seeds=1)
    assert found["failed"] == 0 and 20 < found["depths_mm"][0] < 90
    means = [radii.mean() for radii in found["arrays"].values()]
    assert list(found["arrays"]) == list(READINGS)
    assert means == sorted(means, reverse=True) and means[-1] > 0.05  # the nearer, the smaller


@pytest.mark.parametrize(("changes", "complaint"), [
    ({"short_mm": "wide"}, "line 2: short_mm='wide' is not a number"),
    ({"mm_per_px": 0}, "line 2: mm_per_px=0.0"),
    ({"plate_mm": 20}, "line 2: the specimen of sound.png has a plate of 20 mm"),
])
def test_faults_of_the_table_are_sentences(config, tmp_path, changes, complaint):
    fill(tmp_path / "pictures", ("sound.png", changes))
    with pytest.raises(InputError, match=complaint) as refusal:
        run(config)
    assert "\n" not in str(refusal.value)


def test_a_folder_without_table_columns_or_rows_is_a_sentence(config, tmp_path):
    file = tmp_path / "pictures" / TABLE
    for text, complaint in (("file,short_mm\n", "has no column long_mm"),
                            (",".join(Row.model_fields), "has no rows")):
        file.write_text(text, encoding="utf-8")
        with pytest.raises(InputError, match=complaint):
            run(config)
    file.unlink()
    with pytest.raises(InputError, match="cannot be read"):
        run(config)
