"""Estimators of the cantilever tester: smoothing, regression, table, correction."""

import numpy as np
import pytest
from cylinders import guided
from elastica_curves import LAWS, WEIGHT, curves_of

from common.errors import InputError
from sim.cantilever.moduli import (
    Bezier,
    correct,
    estimate_moduli,
    fabric_of,
    fit_bezier,
    fit_degree,
    fit_law,
    match,
    moment_beyond,
    regress,
    torque_and_curvature,
)
from sim.cantilever.strip import simulate_strips
from sim.cloth import Laws
from sim.material import DIRECTIONS, SOFTENING_LIMIT, Fabric, gravity_length, torque


def test_a_bezier_arc_has_the_length_and_curvature_of_a_circle():
    """Curvature, length and derivatives of a cubic that is a quarter circle to 3e-4."""
    k = 4 / 3 * (np.sqrt(2) - 1)
    arc = Bezier(np.array([[0, 0], [k, 0], [1, 1 - k], [1, 1]]) * 0.05)
    assert arc.length == pytest.approx(0.05 * np.pi / 2, rel=1e-3)
    assert arc.sample(9)[1] == pytest.approx(np.full(9, 20.0), rel=0.03)
    t, h = np.array([0.3, 0.6]), 1e-6
    assert np.allclose((arc.at(t + h) - arc.at(t - h)) / (2 * h), arc.at(t, 1), rtol=1e-6)
    assert np.allclose((arc.at(t + h, 1) - arc.at(t - h, 1)) / (2 * h), arc.at(t, 2), rtol=1e-6)


def test_bezier_fit_finds_the_bezier_it_was_made_of():
    control = np.array([[0, 0], [0.02, 0], [0.04, 0.01], [0.05, 0.03], [0.05, 0.05]])
    points = Bezier(control).at(np.linspace(0, 1, 60) ** 1.3)
    fitted, distance = fit_degree(points, 4)
    assert distance < 5e-6 and np.abs(fitted.control - control).max() < 1e-3
    assert fitted.at(np.zeros(1), 1)[0, 1] == 0.0  # leaves the clamp in its direction


def test_noise_is_not_fitted():
    curve = curves_of(20e-6, -50e-9)[1]
    noisy = curve + np.random.default_rng(0).normal(0, 3e-4, curve.shape)
    clean, degree = (len(fit_bezier(points).control) - 1 for points in (curve, noisy))
    assert degree <= 5 < clean
    assert 2e-4 < fit_degree(noisy, degree)[1] < 4e-4


def test_moment_of_a_straight_level_strip():
    """x - x_i integrates to (L - x_i)²/2."""
    x = np.linspace(0, 0.1, 101)
    points = np.column_stack([x, np.zeros(101)])
    assert np.allclose(moment_beyond(points), (0.1 - x) ** 2 / 2, atol=1e-15)


def test_torque_along_an_elastica_is_the_law_of_its_curvature():
    alpha, beta = 20e-6, -50e-9
    moment, kappa = torque_and_curvature(fit_bezier(curves_of(alpha, beta)[1]), weight=WEIGHT)
    assert np.allclose(moment, torque(np.abs(kappa), alpha, beta), atol=5e-3 * moment.max())


def test_the_fitted_law_has_its_continuation():
    kappa = np.linspace(0, 300, 200)
    alpha, beta, misfit = fit_law(kappa, torque(kappa, 10e-6, -50e-9))
    assert -beta / alpha * kappa[-1] > 3 * SOFTENING_LIMIT
    assert alpha == pytest.approx(10e-6, rel=1e-4) and beta == pytest.approx(-50e-9, rel=1e-3)
    assert misfit < 1e-4


@pytest.mark.parametrize(("method", "of_alpha", "of_beta"),
                         [(regress, 0.005, 0.02), (match, 1e-4, 1e-3)])
@pytest.mark.parametrize(("alpha", "beta"), LAWS)
def test_moduli_of_elastica_curves_are_those_of_their_law(method, of_alpha, of_beta, alpha, beta):
    moduli = method(curves_of(alpha, beta), weight=WEIGHT)
    assert moduli.alpha == pytest.approx(alpha, rel=of_alpha)
    assert moduli.beta == pytest.approx(beta, rel=of_beta)


def test_a_cubic_curve_makes_the_moduli_too_small():
    alpha, beta = LAWS[0]
    fits = [fit_degree(curve, 3)[0] for curve in curves_of(alpha, beta)]
    moment, kappa = np.hstack([torque_and_curvature(fit, weight=WEIGHT) for fit in fits])
    assert fit_law(kappa, moment)[0] < 0.95 * alpha


def test_both_read_strips_on_a_ramp():
    alpha, beta = LAWS[0]
    curves = curves_of(alpha, beta, slope=0.4)
    assert regress(curves, weight=WEIGHT, slope=0.4).alpha == pytest.approx(alpha, rel=0.01)
    assert match(curves, weight=WEIGHT, slope=0.4).alpha == pytest.approx(alpha, rel=1e-3)


def test_the_table_is_accurate_with_noise():
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
        estimate_moduli({"warp": curves_of(*LAWS[0])[:1]}, density=0.3, method=method,
                 slope=np.radians(89))


def test_density_scales_the_moduli():
    curves = {"warp": curves_of(*LAWS[0])}
    light, heavy = (
        estimate_moduli(curves, density=d, method="regression")["warp"] for d in (0.15, 0.3))
    assert heavy.alpha == pytest.approx(2 * light.alpha, rel=1e-6)
    assert heavy.beta == pytest.approx(2 * light.beta, rel=1e-5)


FABRIC = Fabric(alpha=[30e-6, 18e-6, 20e-6], beta=[-60e-9, -45e-9, -30e-9])


@pytest.mark.slow
def test_three_free_strips_give_six_moduli():
    """Simulated on one triangulation, corrected on another."""
    lengths = {d: [x * gravity_length(a, 0.3) for x in (1.5, 2.5)]
               for d, a in zip(DIRECTIONS, FABRIC.alpha, strict=True)}
    strips = simulate_strips(FABRIC, lengths, cells=24, seed=5)
    found = estimate_moduli(strips, density=0.3, method="table")
    raw = fabric_of(found, 0.3)
    corrected = correct(strips, found, density=0.3)
    assert raw.alpha[1] < 0.98 * FABRIC.alpha[1]  # a free bias strip hangs lower than a cylinder
    assert np.abs(corrected.alpha / FABRIC.alpha - 1).max() < 0.02
    assert np.abs(corrected.beta / FABRIC.beta - 1).max() < 0.10


def test_guided_simulated_strips_are_read():
    alpha = FABRIC.alpha[2]
    lengths = {"weft": [x * gravity_length(alpha, 0.3) for x in (1.5, 2.5)]}
    strips = simulate_strips(FABRIC, lengths, cells=24, width=None, across=3,
                             laws=guided(Laws(), 3))
    for method in ("regression", "table"):
        found = estimate_moduli(strips, density=0.3, method=method)["weft"]
        assert found.alpha == pytest.approx(alpha, rel=0.02)
        assert found.beta == pytest.approx(FABRIC.beta[2], rel=0.1)
