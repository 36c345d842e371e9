"""The posterior of moduli from strips: truth, errors that matter, faces, and bending lengths."""

import numpy as np
import pytest
from elastica_curves import LAWS, WEIGHT, curves_of

from common.errors import InputError
from data.strips.posterior import (
    CURL_PRIOR,
    RATIO_PRIOR,
    BendingLength,
    MeasuredStrip,
    direction_posterior,
)
from sim.cantilever import hang, heavy_elastica
from sim.cloth import Laws
from sim.energies.bending_variants import Hysteresis
from sim.material import Fabric
from sim.solver.newton import Status

ALPHA, BETA = LAWS[0]
NOISE = 2e-5  # m


def measured(curve: np.ndarray, *, scale: float = 0.0, length_error: float = 3e-4, sign: int = 1,
             true_scale: float = 1.0) -> MeasuredStrip:
    """A curve with small independent errors, and a relative error of its ``scale``."""
    length = np.linalg.norm(np.diff(curve, axis=0), axis=1).sum()
    seen = true_scale * curve
    covariance = NOISE**2 * np.eye(seen.size) + scale**2 * np.outer(seen.ravel(), seen.ravel())
    return MeasuredStrip(seen, covariance, length, length_error, sign)


@pytest.mark.parametrize("law", LAWS)
def test_exact_curves_give_the_moduli(law):
    alpha, beta = law
    found = direction_posterior([measured(curve) for curve in curves_of(alpha, beta)],
                                weight=WEIGHT)
    assert found.alpha == pytest.approx(alpha, rel=4e-3)
    assert found.beta == pytest.approx(beta, rel=2e-2)
    assert found.misfit < 0.5 and abs(found.curl[0]) < found.curl[1]
    (low, high), (lower, upper) = found.intervals(0.9)
    assert low < alpha < high and lower < beta < upper


def test_an_error_of_the_scale_is_three_of_alpha_unless_the_length_is_known():
    curves = curves_of(ALPHA, BETA)
    loose = direction_posterior([measured(c, scale=0.005, length_error=np.inf, true_scale=1.005)
                                 for c in curves], weight=WEIGHT)
    tight = direction_posterior([measured(c, scale=0.005, length_error=2e-5, true_scale=1.005)
                                 for c in curves], weight=WEIGHT)
    deviation = np.sqrt(loose.covariance[0, 0])
    # The error of 0.5 % is another one for each of the two strips.
    assert 0.6 * 3 * 0.005 / np.sqrt(2) < deviation < 1.6 * 3 * 0.005 / np.sqrt(2)
    assert loose.mean[0] - np.log(ALPHA) == pytest.approx(3 * np.log(1.005), rel=0.3)
    assert abs(tight.mean[0] - np.log(ALPHA)) < 0.005 and tight.covariance[0, 0] < deviation**2 / 2


@pytest.mark.parametrize("curl", [-4.0, 4.0])
def test_both_faces_give_the_natural_curvature(curl):
    strips = [measured(heavy_elastica(ALPHA, BETA, weight=WEIGHT, length=0.04, points=81,
                                      curl=sign * curl), sign=sign) for sign in (1, -1)]
    both = direction_posterior(strips, weight=WEIGHT)
    assert both.curl[0] == pytest.approx(curl, abs=3 * both.curl[1]) and both.curl[1] < 1
    assert both.alpha == pytest.approx(ALPHA, rel=0.01)
    # Of one face the shape of the curve alone determines the natural curvature.
    one = direction_posterior(strips[:1], weight=WEIGHT)
    assert one.covariance[0, 0] > 9 * both.covariance[0, 0] and one.curl[1] > 2 * both.curl[1]
    (low, high), _ = one.intervals(0.9)
    assert low < ALPHA < high


@pytest.mark.parametrize("curl", [-6.0, 6.0])
def test_curled_elasticas_are_the_curled_strips_of_the_simulator(curl):
    length, laws = 0.04, Laws(Hysteresis(curvature=(curl, 0.0, 0.0)))
    hung = hang(Fabric([ALPHA] * 3, [BETA] * 3), length=length, edge=1e-3, across=2, width=2e-3,
                laws=laws)
    assert hung.result.status is Status.CONVERGED
    model = heavy_elastica(ALPHA, BETA, weight=WEIGHT, length=length, curl=curl)
    flat = heavy_elastica(ALPHA, BETA, weight=WEIGHT, length=length)
    moved = np.linalg.norm(model[-1] - flat[-1])
    assert moved > 1e-3 and np.linalg.norm(hung.curve[-1] - model[-1]) < 0.05 * moved


def test_a_bending_length_gives_the_rigidity_of_the_standard():
    length = BendingLength(0.02, 2e-4)
    found = direction_posterior([], [length], weight=WEIGHT)
    # The rigidity rho g c³ is that of the strip's curvature: softer than alpha if beta < 0.
    rigidity = WEIGHT * length.length**3
    assert 1.0 < found.alpha / rigidity < 1.3 and found.curl[1] == pytest.approx(CURL_PRIOR)
    precision, vector = found.likelihood()
    unit = [1, 1e-3, 10]
    values = np.linalg.eigvalsh(precision * np.outer(unit, unit))
    assert abs(values[:2]).max() < 1e-6 * values[2], "one number determines one modulus"
    linear = np.array([np.log(rigidity), 0.0, 0.0])
    assert 0.5 * (linear - found.mean) @ precision @ (linear - found.mean) < 1.0
    assert np.isfinite(vector).all() and found.mean[1] == pytest.approx(RATIO_PRIOR[0], abs=1e-5)


def test_a_bending_length_that_contradicts_a_curve_is_named():
    strips = [measured(curves_of(ALPHA, BETA)[1])]
    with pytest.raises(InputError, match="standard deviations from them"):
        direction_posterior(strips, [BendingLength(0.05, 2e-4)], weight=WEIGHT)


def test_strips_of_different_fabrics_are_refused():
    strips = [measured(curves_of(*law)[0]) for law in LAWS[:2]]
    with pytest.raises(InputError, match="of one direction"):
        direction_posterior(strips, weight=WEIGHT)
