"""Moduli, torque and the plate law behind it."""

import numpy as np
import pytest

from sim.energies import plate_law
from sim.errors import InputError
from sim.material import (
    SOFTENING_LIMIT,
    Fabric,
    bias_limit,
    is_admissible,
    plate_constants,
    softening,
    torque,
)

FABRICS = [
    Fabric([20e-6, 20e-6, 20e-6], [-50e-9, -50e-9, -50e-9]),
    Fabric([98.8e-6, 23.5e-6, 21.2e-6], [-247e-9, -58.8e-9, -53e-9]),  # no twist left: c < 0
    Fabric([10e-6, 30e-6, 15e-6], [20e-9, -90e-9, 0.0]),
]


def law(fabric: Fabric) -> np.ndarray:
    return np.array([*plate_constants(fabric.alpha), *softening(fabric.alpha, fabric.beta),
                     SOFTENING_LIMIT])


@pytest.mark.parametrize("fabric", FABRICS)
@pytest.mark.parametrize(("direction", "angle"), [(0, 0.0), (1, 45.0), (2, 90.0)])
def test_cylinders_carry_the_torque_of_the_moduli(fabric, direction, angle):
    """The work done up to a curvature is the plate's energy, in warp, bias and weft."""
    c, s = np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))
    for kappa in (5.0, 80.0, 400.0):
        path = np.linspace(0, kappa, 20001)
        moments = torque(path, fabric.alpha[direction], fabric.beta[direction])
        work = np.sum((moments[1:] + moments[:-1]) / 2 * np.diff(path))
        energy = plate_law.energy(kappa * np.array([c * c, s * s, c * s]), law(fabric))
        assert energy == pytest.approx(work, rel=1e-6)


def test_torque_is_the_parabola_up_to_the_limit_and_grows_beyond():
    alpha, beta = 20e-6, -50e-9
    limit = SOFTENING_LIMIT * alpha / -beta
    below = np.linspace(0, limit, 50)
    assert np.allclose(torque(below, alpha, beta), alpha * below + beta * below**2, rtol=1e-12)
    beyond = torque(np.linspace(limit, 10 * limit, 50), alpha, beta)
    slopes = np.diff(beyond) / (np.diff(np.linspace(limit, 10 * limit, 50)))
    assert np.allclose(slopes, alpha * (1 - 2 * SOFTENING_LIMIT), rtol=1e-9)


def test_stiffening_fabric_follows_its_parabola_everywhere():
    kappa = np.linspace(0, 500, 20)
    assert np.allclose(torque(kappa, 1e-5, 3e-8), 1e-5 * kappa + 3e-8 * kappa**2)


@pytest.mark.parametrize("fabric", FABRICS)
def test_energy_is_positive_and_its_derivatives_are_right(fabric):
    rng = np.random.default_rng(0)
    gradient, hessian, ahead, behind = np.empty(3), np.empty((3, 3)), np.empty(3), np.empty(3)
    scratch = np.empty((3, 3))
    for s in rng.normal(0, 150, (200, 3)):
        assert plate_law.energy(s, law(fabric)) > 0
        plate_law.derivatives(s, law(fabric), gradient, hessian)
        for k in range(3):
            h = np.zeros(3)
            h[k] = 1e-3
            change = plate_law.energy(s + h, law(fabric)) - plate_law.energy(s - h, law(fabric))
            assert change / 2e-3 == pytest.approx(gradient[k], rel=1e-5, abs=1e-9)
            plate_law.derivatives(s + h, law(fabric), ahead, scratch)
            plate_law.derivatives(s - h, law(fabric), behind, scratch)
            assert np.allclose((ahead - behind) / 2e-3, hessian[k], rtol=1e-3, atol=1e-9)


def test_derivatives_are_those_of_the_quadratic_form_at_rest():
    fabric = FABRICS[1]
    gradient, hessian = np.empty(3), np.empty((3, 3))
    plate_law.derivatives(np.zeros(3), law(fabric), gradient, hessian)
    a11, a22, a12, a66 = plate_constants(fabric.alpha)
    assert np.array_equal(gradient, np.zeros(3))
    assert np.allclose(hessian, [[a11, a12, 0], [a12, a22, 0], [0, 0, 4 * a66]])


def test_plate_constants_are_positive_definite_and_continuous():
    """Sweep the bias modulus from the limit of stability up, through the change of rule."""
    warp, weft = 90e-6, 20e-6
    least = bias_limit(np.array([warp, 0, weft]))
    sweep = least + np.linspace(1e-10, 80e-6, 4000)
    constants = np.array([plate_constants(np.array([warp, b, weft])) for b in sweep])
    a11, a22, a12, a66 = constants.T
    assert (a66 > 0).all() and (a11 * a22 > a12**2).all()
    assert np.allclose(2 * a12 + 4 * a66, 4 * sweep - warp - weft, atol=1e-18)
    assert np.abs(np.diff(constants, axis=0)).max() < 5 * np.diff(sweep).max()


def test_isotropic_fabric_is_an_isotropic_plate():
    a11, a22, a12, a66 = plate_constants(np.full(3, 1e-5))
    assert (a11, a22, a12, a66) == pytest.approx((1e-5, 1e-5, 0.0, 0.5e-5))


def test_density_scales_moduli():
    fabric = FABRICS[2].at_density(0.15)
    assert np.allclose(fabric.alpha, FABRICS[2].alpha / 2)
    assert np.allclose(fabric.beta, FABRICS[2].beta / 2)
    assert fabric.density == 0.15


def test_softest_possible_bias():
    alpha = np.array([90e-6, 0.0, 20e-6])
    alpha[1] = bias_limit(alpha)
    assert not is_admissible(alpha * [1, 0.999, 1], np.zeros(3))
    assert is_admissible(alpha * [1, 1.001, 1], np.zeros(3))


@pytest.mark.parametrize(
    ("alpha", "beta", "density", "word"),
    [
        ([1e-5, 1e-5], [0, 0, 0], 0.3, "three values"),
        ([1e-5, 1e-5, np.nan], [0, 0, 0], 0.3, "finite"),
        ([1e-5, -1e-5, 1e-5], [0, 0, 0], 0.3, "positive"),
        ([1e-5, 1e-5, 1e-5], [0, 0, np.inf], 0.3, "finite"),
        ([1e-5, 1e-5, 1e-5], [0, 0, 0], -0.3, "density"),
        ([1e-4, 1e-6, 1e-6], [0, 0, 0], 0.3, "along the bias"),
    ],
)
def test_nonsense_is_refused_in_words(alpha, beta, density, word):
    with pytest.raises(InputError, match=word):
        Fabric(alpha, beta, density)
