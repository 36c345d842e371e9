"""Estimators of the cantilever tester: curves, regression, table, correction, command line."""

import json

import numpy as np
import pytest

from common.errors import InputError
from sim.cantilever import elastica, heavy_elastica
from sim.cantilever.__main__ import main
from sim.cantilever.curves import Bezier, fit_bezier, oriented_curve, read_curve
from sim.cantilever.fabric import bending_length, correct, estimate, fabric_of, simulate_strips
from sim.cantilever.regression import fit_law, moment_beyond, regress, torque_and_curvature
from sim.cantilever.table import match
from sim.material import DIRECTIONS, SOFTENING_LIMIT, Fabric, torque
from sim.scene import GRAVITY

WEIGHT = 0.3 * GRAVITY
LAWS = [(20e-6, -50e-9), (80e-6, -150e-9), (20e-6, 40e-9), (5e-6, -30e-9)]


def curves_of(alpha: float, beta: float, *, slope: float = 0.0, points: int = 81) -> list:
    """Elastica curves of two strips, 1.5 and 2.5 bending lengths long."""
    return [
        heavy_elastica(alpha, beta, weight=WEIGHT, length=x * bending_length(alpha, 0.3),
                       slope=slope, points=points)
        for x in (1.5, 2.5)
    ]


def test_bezier_knows_the_circle():
    """Curvature, length and derivatives of a cubic that is a quarter circle to 3e-4."""
    k = 4 / 3 * (np.sqrt(2) - 1)
    arc = Bezier(np.array([[0, 0], [k, 0], [1, 1 - k], [1, 1]]) * 0.05)
    assert arc.length == pytest.approx(0.05 * np.pi / 2, rel=1e-3)
    assert arc.curvature(np.linspace(0, 1, 9)) == pytest.approx(np.full(9, 20.0), rel=0.03)
    t, h = np.array([0.3, 0.6]), 1e-6
    assert np.allclose((arc.at(t + h) - arc.at(t - h)) / (2 * h), arc.at(t, 1), rtol=1e-6)
    assert np.allclose((arc.at(t + h, 1) - arc.at(t - h, 1)) / (2 * h), arc.at(t, 2), rtol=1e-6)


def test_bezier_fit_finds_the_bezier_it_was_made_of():
    control = np.array([[0, 0], [0.02, 0], [0.04, 0.01], [0.05, 0.03], [0.05, 0.05]])
    points = Bezier(control).at(np.linspace(0, 1, 60) ** 1.3)
    fitted, distance = fit_bezier(points, degree=4)
    assert distance < 5e-6 and np.abs(fitted.control - control).max() < 1e-3
    assert fitted.at(np.zeros(1), 1)[0, 1] == 0.0  # leaves the clamp in its direction


def test_noise_is_not_fitted():
    curve = curves_of(20e-6, -50e-9)[1]
    noisy = curve + np.random.default_rng(0).normal(0, 3e-4, curve.shape)
    clean_degree = len(fit_bezier(curve)[0].control) - 1
    fitted, distance = fit_bezier(noisy)
    assert len(fitted.control) - 1 <= 5 < clean_degree
    assert 2e-4 < distance < 4e-4


def test_moment_of_a_straight_level_strip():
    """x - x_i integrates to (L - x_i)²/2."""
    x = np.linspace(0, 0.1, 101)
    points = np.column_stack([x, np.zeros(101)])
    assert np.allclose(moment_beyond(points), (0.1 - x) ** 2 / 2, atol=1e-15)


def test_torque_along_an_elastica_is_the_law_of_its_curvature():
    alpha, beta = 20e-6, -50e-9
    moment, kappa = torque_and_curvature(curves_of(alpha, beta)[1], weight=WEIGHT)
    assert np.allclose(moment, torque(kappa, alpha, beta), atol=5e-3 * moment.max())


def test_the_fitted_law_has_its_continuation():
    kappa = np.linspace(0, 300, 200)
    alpha, beta, misfit = fit_law(kappa, torque(kappa, 10e-6, -50e-9))
    assert -beta / alpha * kappa[-1] > 3 * SOFTENING_LIMIT
    assert alpha == pytest.approx(10e-6, rel=1e-4) and beta == pytest.approx(-50e-9, rel=1e-3)
    assert misfit < 1e-4


@pytest.mark.parametrize(("alpha", "beta"), LAWS)
def test_regression_reads_elastica_curves(alpha, beta):
    found = regress(curves_of(alpha, beta), weight=WEIGHT)
    assert found.alpha == pytest.approx(alpha, rel=0.005)
    assert found.beta == pytest.approx(beta, rel=0.02)


def test_a_cubic_curve_makes_the_moduli_too_small():
    alpha, beta = LAWS[0]
    assert regress(curves_of(alpha, beta), weight=WEIGHT, degree=3).alpha < 0.95 * alpha


@pytest.mark.parametrize(("alpha", "beta"), LAWS)
def test_the_table_reads_elastica_curves(alpha, beta):
    found = match(curves_of(alpha, beta), weight=WEIGHT)
    assert found.alpha == pytest.approx(alpha, rel=1e-4)
    assert found.beta == pytest.approx(beta, rel=1e-3)


def test_both_read_strips_on_a_ramp():
    alpha, beta = LAWS[0]
    curves = curves_of(alpha, beta, slope=0.4)
    assert regress(curves, weight=WEIGHT, slope=0.4).alpha == pytest.approx(alpha, rel=0.01)
    assert match(curves, weight=WEIGHT, slope=0.4).alpha == pytest.approx(alpha, rel=1e-3)


def test_the_table_stands_noise():
    alpha, beta = LAWS[0]
    rng = np.random.default_rng(1)
    noisy = [curve + rng.normal(0, 3e-4, curve.shape) * (np.arange(81) > 0)[:, None]
             for curve in curves_of(alpha, beta)]
    found = match(noisy, weight=WEIGHT)
    assert found.alpha == pytest.approx(alpha, rel=0.08)
    assert found.beta == pytest.approx(beta, rel=0.35)


@pytest.mark.parametrize("method", ["regression", "table"])
def test_curves_that_no_strip_has_are_refused(method):
    with pytest.raises(InputError, match="hanging strip"):
        estimate({"warp": curves_of(*LAWS[0])[:1]}, density=0.3, method=method,
                 slope=np.radians(89))


def test_a_bezier_curve_bends():
    with pytest.raises(InputError, match="degree 1 cannot bend"):
        fit_bezier(curves_of(*LAWS[0])[0], degree=1)


def test_density_scales_the_moduli():
    curves = {"warp": curves_of(*LAWS[0])}
    light, heavy = (
        estimate(curves, density=d, method="regression")["warp"] for d in (0.15, 0.3))
    assert heavy.alpha == pytest.approx(2 * light.alpha, rel=1e-6)
    assert heavy.beta == pytest.approx(2 * light.beta, rel=1e-5)


FABRIC = Fabric(alpha=[30e-6, 18e-6, 20e-6], beta=[-60e-9, -45e-9, -30e-9])


@pytest.mark.slow
def test_three_free_strips_give_six_moduli():
    """Simulated on one triangulation, corrected on another."""
    lengths = {d: [x * bending_length(a, 0.3) for x in (1.5, 2.5)]
               for d, a in zip(DIRECTIONS, FABRIC.alpha, strict=True)}
    strips = simulate_strips(FABRIC, lengths, cells=24, seed=5)
    found = estimate(strips, density=0.3, method="table")
    raw = fabric_of(found, 0.3)
    corrected = correct(strips, found, density=0.3)
    assert raw.alpha[1] < 0.98 * FABRIC.alpha[1]  # a free bias strip hangs lower than a cylinder
    assert np.abs(corrected.alpha / FABRIC.alpha - 1).max() < 0.02
    assert np.abs(corrected.beta / FABRIC.beta - 1).max() < 0.10


def test_guided_simulated_strips_are_read():
    alpha = FABRIC.alpha[2]
    lengths = {"weft": [x * bending_length(alpha, 0.3) for x in (1.5, 2.5)]}
    strips = simulate_strips(FABRIC, lengths, cells=24, guided=True)
    for method in ("regression", "table"):
        found = estimate(strips, density=0.3, method=method)["weft"]
        assert found.alpha == pytest.approx(alpha, rel=0.02)
        assert found.beta == pytest.approx(FABRIC.beta[2], rel=0.1)


# --- reading a user's curve -----------------------------------------------------------------


def write_curve(path, curve, *, header="x_mm,y_mm", scale=(1.0, 1.0)):
    rows = [f"{x:.6f},{y:.6f}" for x, y in 1e3 * curve * scale]
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


def test_a_curve_reads_the_same_whichever_way_its_axes_point(tmp_path):
    curve = curves_of(*LAWS[0])[0]
    offset = np.array([0.01, 0.02])
    for scale in ((1, 1), (1, -1), (-1, -1)):
        read = read_curve(write_curve(tmp_path / "c.csv", curve + offset, scale=scale))
        assert np.allclose(read, curve, atol=2e-9)


@pytest.mark.parametrize(
    "text",
    ["", "x,y\n1,2\n", "x_mm,y_mm\n0,0\n1,1\n", "x_mm,y_mm\n" + "0,zero\n" * 20,
     "x_mm,y_mm\n" + "0,nan\n" * 20, "x_mm,y_mm\n" + "1,1\n" * 20, "x_mm,y_mm\n" + "7\n" * 20,
     "x_mm,y_mm\n" + "".join(f"{1e5 * i},{i}\n" for i in range(20)),
     "x_mm,y_mm\n" + "".join(f"{i},0\n" for i in range(20)),
     "x_mm,y_mm\n" + "".join(f"{i + 30 * (i % 2)},{i}\n" for i in range(20)),
     "x_mm,y_mm\n" + "0,0\n" * 11 + "60,-30\n"],
    ids=["empty", "names", "few", "word", "nan", "point", "column", "unit", "level", "disorder",
         "repeated"],
)
def test_bad_curves_are_refused_in_one_line(tmp_path, text):
    file = tmp_path / "bad.csv"
    file.write_text(text)
    with pytest.raises(InputError) as caught:
        read_curve(file)
    assert "bad.csv" in str(caught.value) and "\n" not in str(caught.value)


def test_a_missing_file_and_binary_rubbish_are_refused(tmp_path):
    (tmp_path / "rubbish.csv").write_bytes(b"\xff\xfe\x00" * 50)
    for name in ("none.csv", "rubbish.csv"):
        with pytest.raises(InputError):
            read_curve(tmp_path / name)


def test_a_curve_that_rises_first_is_still_a_curve():
    curve = curves_of(*LAWS[0])[0]
    assert np.allclose(oriented_curve(curve * [1, -1]), curve)


@pytest.mark.parametrize("length", [1.5, 2.5, 4.0])
@pytest.mark.parametrize("noise", [0.0, 3e-4])
def test_a_curve_listed_from_the_free_end_is_refused(length, noise):
    curve = heavy_elastica(20e-6, -50e-9, weight=WEIGHT, points=81,
                           length=length * bending_length(20e-6, 0.3))
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


# --- command line ---------------------------------------------------------------------------


def test_gammas_become_json(tmp_path, capsys):
    main(["--gamma", "0.1", "10", "--json", "-"])
    printed = json.loads(capsys.readouterr().out)
    assert [row["gamma"] for row in printed] == [0.1, 10.0]
    for row in printed:
        assert row["aspect_ratio"] == pytest.approx(row["elastica_aspect_ratio"], rel=0.005)
    main(["--gamma", "0.1", "--json", str(tmp_path / "a" / "s.json")])
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


def test_a_curve_that_does_not_tell_beta_is_named(tmp_path, capsys):
    curve = 0.03 * elastica(0.3, 40)
    curve[1:] += np.random.default_rng(0).normal(0, 3e-4, (39, 2))
    almost_straight = write_curve(tmp_path / "short.csv", curve)
    main(["estimate", f"warp={almost_straight}", "density=300"])
    assert "do not tell beta" in capsys.readouterr().out
    curve = write_curve(tmp_path / "long.csv", curves_of(*LAWS[0])[1])
    main(["estimate", f"warp={curve}", "density=300"])
    assert "do not tell beta" not in capsys.readouterr().out


def test_estimate_reads_files_and_writes_a_torque_curve(tmp_path, capsys):
    alpha, beta = LAWS[0]
    files = [write_curve(tmp_path / f"{k}.csv", c) for k, c in enumerate(curves_of(alpha, beta))]
    out = tmp_path / "torque.json"
    main(["estimate", f"weft={files[0]},{files[1]}", "density=300", "method=spline", "knots=5",
          f"out={out}"])
    weft = json.loads(out.read_text())["torque_curves"]["weft"]
    kappa, torque = np.array(weft["curvature_1_m"]), np.array(weft["torque_mN"])
    assert len(kappa) == 6 and kappa[0] == torque[0] == 0
    inside = (kappa > 0) & (kappa < 0.9 * weft["largest_curvature_1_m"])
    expected = 1e3 * (alpha * kappa + beta * kappa**2)
    assert torque[inside] == pytest.approx(expected[inside], rel=0.03)
    assert "torque mN" in capsys.readouterr().out


@pytest.mark.parametrize(
    "words",
    [["--gamma"], ["--gamma", "x"], ["--gamma", "0"], ["--gamma", "nan"], ["--json", "-"],
     ["--colour"], ["estimate"], ["estimate", "warp=none.csv"],
     ["estimate", "warp=none.csv", "density=300"], ["estimate", "colour=red"],
     ["estimate", "warp=none.csv", "density=300", "rounds=-1"]],
    ids=" ".join,
)
def test_mistakes_are_one_line(words):
    with pytest.raises(InputError) as caught:
        main(words)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("words", "said"),
    [(["method=guess"], "regression, table, spline"), (["rounds=1"], "all three"),
     (["degree=50"], "degree 50"), (["slope=95"], "slope"), (["slope=nan"], "slope: 'nan'"),
     (["method=spline", "slope=5"], "level clamp"), (["method=spline", "knots=1"], "knots=1"),
     (["density=0.3"], "5 to 5000 g/m²"), (["density=300000"], "5 to 5000 g/m²"),
     (["weft=FILE,,"], "weft=.*comma"), (["out=/proc/moduli.json"], "cannot write"),
     (["out=FILE/moduli.json"], "cannot write")],
    ids=lambda value: " ".join(value) if isinstance(value, list) else None,
)
def test_estimates_that_make_no_sense_are_refused(tmp_path, words, said):
    file = write_curve(tmp_path / "w.csv", curves_of(*LAWS[0])[0])
    words = [word.replace("FILE", str(file)) for word in words]
    with pytest.raises(InputError, match=said):
        main(["estimate", f"warp={file}", "density=300", *words])


@pytest.mark.parametrize("out", ["/proc/strips.json", "."])
def test_strips_are_not_simulated_for_a_file_that_cannot_be_written(monkeypatch, out):
    monkeypatch.setattr("sim.cantilever.__main__.simulate", None)
    with pytest.raises(InputError, match="cannot write"):
        main(["--gamma", "1", "--json", out])
