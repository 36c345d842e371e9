"""Moduli, torque and the plate law behind it."""

import numpy as np
import pytest
from scipy.linalg import eigvalsh

from sim.energies import bending_law
from sim.energies.bending_law import constants
from sim.material import (
    SOFTENING_LIMIT,
    Fabric,
    bending_work,
    bias_limit,
    is_admissible,
    plate_constants,
    secant,
    torque,
)

FABRICS = [
    Fabric([20e-6, 20e-6, 20e-6], [-50e-9, -50e-9, -50e-9]),
    Fabric([98.8e-6, 23.5e-6, 21.2e-6], [-247e-9, -58.8e-9, -53e-9]),  # no twist left: c < 0
    Fabric([10e-6, 30e-6, 15e-6], [20e-9, -90e-9, 0.0]),
]
TWISTING = [
    Fabric([30e-6, 20e-6, 15e-6], [-60e-9, -80e-9, -15e-9]),  # the bias softens most
    Fabric([53.1e-6, 16.5e-6, 25.3e-6], [-176e-9, -68.6e-9, -92.1e-9]),  # little twist left
]


def derivatives(s: np.ndarray, plate) -> tuple[float, np.ndarray, np.ndarray]:
    """Energy, gradient (3,) and Hessian (3, 3) of the law at curvatures (3,)."""
    gradient, hessian = np.empty(3), np.empty((3, 3))
    return bending_law.derivatives(s, plate, gradient, hessian), gradient, hessian


def least_stiffness(fabric: Fabric, states: np.ndarray) -> float:
    """Least eigenvalue of the tangent over curvatures (N, 3), relative to the stiffness at rest."""
    plate = constants(fabric)
    rest = derivatives(np.zeros(3), plate)[2]
    return min(eigvalsh(derivatives(s, plate)[2], rest)[0] for s in states)


def cylinders(angles: np.ndarray, curvatures: np.ndarray) -> np.ndarray:
    """(N, 3) curvatures of cylinders bent along ``angles``, degrees."""
    c, s = np.cos(np.deg2rad(angles)), np.sin(np.deg2rad(angles))
    return np.outer(curvatures, np.stack([c * c, s * s, c * s], axis=1)).reshape(-1, 3)


@pytest.mark.parametrize("fabric", FABRICS + TWISTING)
@pytest.mark.parametrize(("direction", "angle"), [(0, 0.0), (1, 45.0), (2, 90.0)])
def test_cylinders_carry_the_torque_of_the_moduli(fabric, direction, angle):
    """The work done up to a curvature is the plate's energy, in warp, bias and weft."""
    c, s = np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))
    for kappa in (5.0, 80.0, 400.0):
        path = np.linspace(0, kappa, 20001)
        moments = torque(path, fabric.alpha[direction], fabric.beta[direction])
        work = np.sum((moments[1:] + moments[:-1]) / 2 * np.diff(path))
        energy = derivatives(kappa * np.array([c * c, s * s, c * s]), constants(fabric))[0]
        assert energy == pytest.approx(work, rel=1e-6)


def test_torque_is_the_parabola_up_to_the_limit_and_grows_beyond():
    alpha, beta = 20e-6, -50e-9
    limit = SOFTENING_LIMIT * alpha / -beta
    below = np.linspace(0, limit, 50)
    assert np.allclose(torque(below, alpha, beta), alpha * below + beta * below**2, rtol=1e-12)
    beyond = torque(np.linspace(limit, 10 * limit, 50), alpha, beta)
    slopes = np.diff(beyond) / (np.diff(np.linspace(limit, 10 * limit, 50)))
    assert np.allclose(slopes, alpha * (1 - 2 * SOFTENING_LIMIT), rtol=1e-9)
    kappa = np.linspace(0, 500, 20)  # a stiffening fabric follows its parabola everywhere
    assert np.allclose(torque(kappa, 1e-5, 3e-8), 1e-5 * kappa + 3e-8 * kappa**2)
    assert torque(10.0, [6e-5, 3e-5], [0, 0]) == pytest.approx([6e-4, 3e-4])


def test_a_secant_is_the_modulus_of_the_same_torque_and_never_negative():
    alpha, beta = np.array([20e-6, 20e-6, 20e-6]), np.array([-50e-9, 0.0, -500e-9])
    assert secant(0.0, alpha, beta).tolist() == alpha.tolist()
    assert secant(60.0, alpha, beta)[:2] == pytest.approx([17e-6, 20e-6])
    # alpha + 60 beta would be -10e-6: the law is straight from 14/m on.
    assert 60 * secant(60.0, alpha, beta)[2] == pytest.approx(torque(60.0, 20e-6, -500e-9))
    assert secant(60.0, alpha, beta)[2] > (1 - 2 * SOFTENING_LIMIT) * 20e-6


@pytest.mark.parametrize("beta", [-60e-9, 0.0, 40e-9])
def test_torque_and_tangent_are_derivatives_of_the_work_of_bending(beta):
    """Central differences on either side of the limit, where the tangent alone has a bend."""
    alpha, step = 20e-6, 1e-3
    limit = SOFTENING_LIMIT * alpha / 60e-9
    kappa = np.concatenate([np.linspace(1, limit - 1, 40), limit * np.linspace(1.01, 5, 40)])
    ahead, at, behind = (bending_work(kappa + d, alpha, beta) for d in (step, 0.0, -step))
    for k in range(2):
        assert np.allclose((ahead[k] - behind[k]) / (2 * step), at[k + 1], rtol=1e-6)
    assert at[2].min() >= alpha * (1 - 2 * SOFTENING_LIMIT) * (1 - 1e-12)
    before, after = (bending_work(limit * (1 + d), alpha, beta) for d in (-1e-9, 1e-9))
    assert np.allclose(before, after, rtol=1e-8, atol=0)
    assert bending_work(0.0, alpha, beta) == (0.0, 0.0, alpha)


def test_fabrics_are_equal_and_hashed_by_value():
    moduli = np.array([20e-6, 30e-6, 25e-6])
    fabric, same = Fabric(moduli, [-1e-9, 0.0, 2e-9]), Fabric(list(moduli), [-1e-9, 0.0, 2e-9])
    assert fabric == same and hash(fabric) == hash(same) and len({fabric, same}) == 1
    for other in (Fabric(moduli), Fabric(1.01 * moduli, fabric.beta),
                  Fabric(moduli, fabric.beta, density=0.2), "fabric"):
        assert fabric != other
    moduli[0] = 1.0  # what a fabric was made from is not the fabric
    assert fabric == same
    assert not fabric.at_density(0.15).alpha.flags.writeable
    with pytest.raises(ValueError, match="read-only"):
        fabric.alpha[0] = 1.0


@pytest.mark.parametrize("fabric", FABRICS + TWISTING)
def test_energy_is_positive_and_its_derivatives_are_right(fabric):
    """Central differences along lines of random directions."""
    rng, plate, step = np.random.default_rng(0), constants(fabric), 1e-3
    errors = []
    for s, direction in rng.normal(0, 150, (200, 2, 3)):
        direction /= np.linalg.norm(direction)
        energy, gradient, hessian = derivatives(s, plate)
        ahead, behind = (derivatives(s + sign * step * direction, plate) for sign in (1, -1))
        slope, bend = ((ahead[k] - behind[k]) / (2 * step) for k in range(2))
        assert energy > 0 and np.allclose(hessian, hessian.T, rtol=1e-12, atol=0)
        errors.append([abs(slope - gradient @ direction) / np.abs(gradient).max(),
                       np.abs(bend - hessian @ direction).max() / np.abs(hessian).max()])
    # Third derivatives jump where a direction reaches its limit: not every line is smooth.
    assert np.median(errors, axis=0).max() < 1e-6 and np.max(errors) < 1e-3


@pytest.mark.parametrize("fabric", TWISTING)
def test_cylinders_are_stable_in_twist(fabric):
    """Two fabrics that would lose all stiffness against twist without the law's last terms.

    Not every fabric is stable everywhere, see docs/physics.md.
    """
    states = cylinders(np.arange(0, 180, 7.5), np.linspace(10, 300, 30))
    assert least_stiffness(fabric, states) > 0.05


def test_one_rate_of_softening_makes_a_convex_law():
    """With beta/alpha**1.5 alike in all directions only sqrt(a) counts; the rest slope is least."""
    alpha = np.array([60e-6, 30e-6, 15e-6])
    fabric = Fabric(alpha, -0.5 * alpha**1.5)
    states = np.random.default_rng(2).normal(0, 300, (500, 3))
    assert least_stiffness(fabric, states) > 1 - 2 * SOFTENING_LIMIT - 1e-9


def test_isotropic_fabric_has_an_isotropic_law():
    """The energy is that of one torque law of |S|, whatever the shape."""
    fabric = FABRICS[0]
    for s in np.random.default_rng(3).normal(0, 150, (20, 3)):
        bent = np.array([np.sqrt(s[0] ** 2 + s[1] ** 2 + 2 * s[2] ** 2), 0.0, 0.0])
        assert derivatives(s, constants(fabric))[0] == pytest.approx(
            derivatives(bent, constants(fabric))[0], rel=1e-12
        )


def test_the_law_is_continuous_in_the_moduli():
    """Sweep the bias through the softening at which the correction changes sides."""
    s = np.array([90.0, -30.0, 40.0])
    sweep = np.linspace(-4e-3, -1e-3, 3001)
    alpha = np.array([40e-6, 18e-6, 10e-6])
    fabrics = (Fabric(alpha, alpha * [-2e-3, ratio, -3e-3]) for ratio in sweep)
    energies = np.array([derivatives(s, constants(fabric))[0] for fabric in fabrics])
    assert np.abs(np.diff(energies)).max() < 5 * np.ptp(energies) / len(sweep)


def test_derivatives_are_those_of_the_quadratic_form_at_rest():
    fabric = FABRICS[1]
    _, gradient, hessian = derivatives(np.zeros(3), constants(fabric))
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


def test_density_scales_moduli_beyond_the_limits_of_units_too():
    fabric = FABRICS[2].at_density(0.15)
    assert np.allclose([fabric.alpha, fabric.beta], [FABRICS[2].alpha / 2, FABRICS[2].beta / 2])
    assert fabric.density == 0.15
    assert Fabric([1.0, 1.0, 1.0], density=0.3).at_density(3.0).alpha == pytest.approx([10.0] * 3)


def test_softest_possible_bias():
    alpha = np.array([90e-6, 0.0, 20e-6])
    alpha[1] = bias_limit(alpha)
    assert not is_admissible(alpha * [1, 0.999, 1], np.zeros(3))
    assert is_admissible(alpha * [1, 1.001, 1], np.zeros(3))
