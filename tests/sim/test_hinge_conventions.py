"""Conversions: the same hinge stores the same energy under the foreign formula."""

import numpy as np
import pytest
from test_hinges import BOTH, one_hinge

from sim.energies.hinges import ARCSIM, DISCRETE_SHELLS, HingeLaw
from sim.material import Fabric

ALPHA, BETA = 25e-6, -30e-9
ANGLE = 0.5  # rad; kappa = 91 1/m, far below the peak of the torque at 417 1/m


def own_energy(beta: float) -> float:
    mesh, q, _, _ = one_hinge(ANGLE)
    return HingeLaw("hinge")(mesh, BOTH, fabric=Fabric([ALPHA] * 3, [beta] * 3)).value(q)


def work(torque_at, edge: float) -> float:
    """Integral of a torque per edge length over the angle, Simpson's rule."""
    angle = np.linspace(0, ANGLE, 2001)
    value = torque_at(angle)
    return edge * ANGLE / 6000 * (value[0] + value[-1] + 4 * value[1::2].sum()
                                  + 2 * value[2:-1:2].sum())


def test_arcsim_stores_the_same_energy():
    """k l² theta²/(8 A), and k from a table over kappa = theta l/A for the non-linear law."""
    _, _, edge, (h0, h1) = one_hinge(ANGLE)
    area = edge * (h0 + h1) / 2
    k, b = ALPHA / ARCSIM, BETA / ARCSIM**2
    assert (k, b) == pytest.approx((4 * ALPHA, 16 * BETA))
    assert k * edge**2 / (2 * area) * ANGLE**2 / 4 == pytest.approx(own_energy(0.0), rel=1e-12)
    curvature = 1 / (2 * (h0 + h1))
    nonlinear = work(lambda t: k * curvature * t + b * (curvature * t) ** 2, edge)
    assert nonlinear == pytest.approx(own_energy(BETA), rel=1e-10)
    table = work(lambda t: 4 * (ALPHA + BETA * t * edge / area) * edge / (4 * area) * t, edge)
    assert table == pytest.approx(own_energy(BETA), rel=1e-10)


def test_discrete_shells_store_the_same_energy():
    """a theta² e/(2 h) with h a third of the mean height; half of a without the half."""
    _, _, edge, (h0, h1) = one_hinge(ANGLE)
    height = (h0 + h1) / 2 / 3
    a, b = ALPHA / DISCRETE_SHELLS, BETA / DISCRETE_SHELLS**2
    assert (a, b) == pytest.approx((ALPHA / 3, BETA / 9))
    assert a * ANGLE**2 * edge / (2 * height) == pytest.approx(own_energy(0.0), rel=1e-12)
    assert ALPHA / 6 * ANGLE**2 * edge / height == pytest.approx(own_energy(0.0), rel=1e-12)
    nonlinear = work(lambda t: a * t / height + b * (t / height) ** 2, edge)
    assert nonlinear == pytest.approx(own_energy(BETA), rel=1e-10)
