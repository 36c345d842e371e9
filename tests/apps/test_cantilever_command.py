"""``python -m apps.cantilever``: strips, estimates, and the curves that it reads."""

import json

import numpy as np
import pytest
from elastica_curves import LAWS, WEIGHT, curves_of, write_curve

from apps.cantilever import main, oriented_curve, read_curve
from common.errors import InputError
from sim.cantilever import elastica, heavy_elastica
from sim.material import gravity_length


def test_gammas_become_json(tmp_path, capsys, monkeypatch):
    main(["hang", "gamma=1,10"])
    printed = json.loads(capsys.readouterr().out)
    assert [row["gamma"] for row in printed] == [1.0, 10.0]
    for row in printed:
        assert row["aspect_ratio"] == pytest.approx(row["elastica_aspect_ratio"], rel=0.005)
    monkeypatch.setattr("apps.cantilever.simulate", lambda gamma: printed[0])
    main(["hang", "gamma=1", f"out={tmp_path / 'a' / 's.json'}"])
    assert json.loads((tmp_path / "a" / "s.json").read_text()) == printed[:1]


def test_estimate_reads_files_and_writes_moduli(tmp_path, capsys):
    alpha, beta = LAWS[0]
    files = [write_curve(tmp_path / f"{k}.csv", c) for k, c in enumerate(curves_of(alpha, beta))]
    out = tmp_path / "moduli.json"
    for method in ("table", "regression"):
        main(["estimate", f"weft={files[0]},{files[1]}", "density=300", f"method={method}",
              f"out={out}"])
        weft = json.loads(out.read_text())["moduli"]["weft"]
        assert weft["alpha_uN_m"] == pytest.approx(1e6 * alpha, rel=0.01)
        assert weft["beta_nN_m2"] == pytest.approx(1e9 * beta, rel=0.03)
    assert "weft" in capsys.readouterr().out


def test_a_curve_that_does_not_determine_beta_is_named(tmp_path, capsys):
    curve = 0.03 * elastica(0.3, 40)
    curve[1:] += np.random.default_rng(0).normal(0, 3e-4, (39, 2))
    almost_straight = write_curve(tmp_path / "short.csv", curve)
    main(["estimate", f"warp={almost_straight}", "density=300"])
    assert "do not determine beta" in capsys.readouterr().out
    curve = write_curve(tmp_path / "long.csv", curves_of(*LAWS[0])[1])
    main(["estimate", f"warp={curve}", "density=300"])
    assert "do not determine beta" not in capsys.readouterr().out


def test_a_curve_reads_the_same_whichever_way_its_axes_point(tmp_path):
    curve = curves_of(*LAWS[0])[0]
    offset = np.array([0.01, 0.02])
    for scale in ((1, 1), (1, -1), (-1, -1)):
        read = read_curve(write_curve(tmp_path / "c.csv", curve + offset, scale=scale))
        assert np.allclose(read, curve, atol=2e-9)


@pytest.mark.parametrize(("header", "row"), [
    ("x_mm;y_mm", "{0};{1}"), ("x_mm,y_mm", '"{0}","{1}"'), ("x_mm\ty_mm", "{0}\t{1}"),
    ("\ufeffX [mm];Y [mm]", "{0};{1}"), ("x (mm),y (mm)", "{2},{3}")])
def test_curves_of_spreadsheets_in_every_locale_are_read(tmp_path, header, row):
    curve = curves_of(*LAWS[0])[0]
    numbers = [[f"{1e3 * value:.4f}" for value in point] for point in curve]
    lines = [row.format(*(value.replace(".", ",") for value in point), *point) for point in numbers]
    (tmp_path / "c.csv").write_text("\n".join([header, *lines]), encoding="utf-8")
    assert np.allclose(read_curve(tmp_path / "c.csv"), curve, atol=1e-7)


def test_a_curve_that_rises_first_is_still_a_curve():
    curve = curves_of(*LAWS[0])[0]
    assert np.allclose(oriented_curve(curve * [1, -1]), curve)


@pytest.mark.parametrize("length", [1.5, 2.5, 4.0])
@pytest.mark.parametrize("noise", [0.0, 3e-4])
def test_a_curve_listed_from_the_free_end_is_refused(length, noise):
    curve = heavy_elastica(20e-6, -50e-9, weight=WEIGHT, points=81,
                           length=length * gravity_length(20e-6, 0.3))
    curve[1:] += np.random.default_rng(0).normal(0, noise, (80, 2))
    assert np.allclose(oriented_curve(curve), curve)
    for scale in ((1, 1), (-1, 1), (1, -1)):
        with pytest.raises(InputError, match="clamp's edge to the free end"):
            oriented_curve(curve[::-1] * scale)


def test_a_nearly_straight_strip_is_a_curve_whatever_its_noise():
    straight = elastica(0.05, 12) * 0.03
    for seed in range(100):
        noise = np.random.default_rng(seed).normal(0, 3e-4, (12, 2))
        noise[[0, -1]] = 0.0  # so that the free end stays below the clamp
        assert np.allclose(oriented_curve(straight + noise), straight + noise)


@pytest.mark.parametrize(("unit", "said"), [(1e-3, r"0\.0449\d* mm"), (1e3, r"449\d\d\S* mm")])
def test_a_curve_in_another_unit_is_refused(tmp_path, unit, said):
    curve = curves_of(*LAWS[0])[1]  # 45 mm from end to end
    with pytest.raises(InputError, match=f"{said} .* in mm"):
        read_curve(write_curve(tmp_path / "c.csv", curve * unit))
