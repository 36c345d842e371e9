"""A free torque curve is recovered from the strips that it makes."""

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from common.errors import InputError
from sim.cantilever.elastica import elastica, strip_shape, tabulated_law
from sim.cantilever.moduli import fit_torque_curve
from sim.energies.bending_variants import TorqueLaw
from sim.energies.midedge import MidEdgeBending
from sim.material import Fabric, torque
from sim.mesh import strip

WEIGHT = 0.3 * 9.81


def stiffening_then_soft(kappa: np.ndarray) -> np.ndarray:
    """No parabola: friction holds the cloth at first, later it yields. N per width."""
    return 12e-6 * kappa + 9e-4 * np.tanh(kappa / 40.0)


def strips_of(law, lengths=(0.05, 0.08, 0.11)) -> list[np.ndarray]:
    kappa = np.linspace(0, 400, 2001)
    return [strip_shape(tabulated_law(kappa, law(kappa)), weight=WEIGHT, length=length, points=101)
            for length in lengths]


def straight(kappa: np.ndarray) -> np.ndarray:
    return 30e-6 * kappa


@pytest.mark.parametrize(("law", "knots", "start", "end", "tolerance"), [
    (stiffening_then_soft, 5, 0.15, 0.9, 0.05), (straight, 4, 0.1, 0.95, 0.01)])
def test_laws_are_recovered_from_their_strips(law, knots, start, end, tolerance) -> None:
    fit = fit_torque_curve(strips_of(law), weight=WEIGHT, knots=knots)
    kappa = np.linspace(start, end, 20) * fit.reached
    moment = PchipInterpolator(fit.curvature, fit.torque)(kappa)
    np.testing.assert_allclose(moment, law(kappa), rtol=tolerance)
    assert fit.misfit < 2e-3
    assert (np.diff(fit.torque) > 0).all()


def test_the_misfit_is_that_of_the_points_and_their_noise() -> None:
    noisy = strips_of(stiffening_then_soft)
    rng = np.random.default_rng(1)
    for curve in noisy:
        curve[1:] += rng.normal(0, 3e-4, (100, 2))
    found = fit_torque_curve(noisy, weight=WEIGHT)
    assert found.misfit * 0.08 == pytest.approx(3e-4, rel=0.2)  # across the strip, one component


def test_knots_are_checked() -> None:
    with pytest.raises(InputError, match="between 2 and 8"):
        fit_torque_curve(strips_of(straight), weight=WEIGHT, knots=1)


def test_strips_of_a_steep_clamp_are_refused() -> None:
    """No law makes a nearly straight one hang from a level clamp."""
    with pytest.raises(InputError, match="level clamp"):
        fit_torque_curve([0.05 * elastica(1.0, slope=0.8)], weight=WEIGHT)


def test_a_parabola_of_torque_is_the_law_of_an_isotropic_fabric() -> None:
    fabric = Fabric(np.full(3, 30e-6), np.full(3, -90e-9))
    kappa = np.linspace(0, 300, 601)
    mesh, held = strip(length=0.04, width=0.03, edge=0.01, clamp=0.01)
    active = ~held[mesh.faces].all(axis=1)
    law = TorqueLaw(kappa, torque(kappa, 30e-6, -90e-9))(mesh, active, fabric=fabric)
    plate = MidEdgeBending(mesh, active, fabric=fabric)
    bent = np.random.default_rng(0).normal(0, 60, (40, 3))
    bent[0] = 0.0
    np.testing.assert_allclose(law.density(bent), plate.density(bent), rtol=1e-5)
    for one, two in zip(law.stress(bent), plate.stress(bent), strict=True):
        np.testing.assert_allclose(one, two, rtol=2e-3, atol=2e-3 * np.abs(two).max())


@pytest.mark.parametrize(("torques", "word"), [
    ([0.0, 1.0], "as many torques"), ([0.0, 2.0, 1.0], "increase from 0"),
    ([1.0, 2.0, 3.0], "increase from 0"), ([0.0, 1.0, np.nan], "increase from 0")])
def test_impossible_torque_laws_are_refused(torques: list[float], word: str) -> None:
    with pytest.raises(InputError, match=word):
        TorqueLaw([0.0, 10.0, 20.0], torques)
