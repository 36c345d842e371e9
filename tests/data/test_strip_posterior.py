"""Evidence of moduli from strips: truth, errors that matter, faces, repeats, bending lengths."""

import numpy as np
import pytest
from elastica_curves import LAWS, PRIOR, WEIGHT, curves_of

import drapenet.measured.strips.posterior
from common.errors import InputError
from drapenet.measured.strips.posterior import (
    BendingLength,
    MeasuredStrip,
    StripEvidence,
    direction_evidence,
)
from sim.cantilever import hang, heavy_elastica
from sim.cloth import Laws
from sim.energies.bending_variants import Hysteresis
from sim.material import Fabric
from sim.solver.newton import Status

ALPHA, BETA = LAWS[0]
NOISE = 2e-5  # m


def told(strips: list[MeasuredStrip], lengths: tuple[BendingLength, ...] = ()) -> StripEvidence:
    """Their evidence with the usual prior."""
    return direction_evidence(strips, lengths, weight=WEIGHT, prior=PRIOR)


@pytest.fixture
def equal_specimens(monkeypatch):
    """Strips of a fabric without scatter."""
    monkeypatch.setattr(drapenet.measured.strips.posterior, "SPECIMEN_SCATTER", 1e-4)
    monkeypatch.setattr(drapenet.measured.strips.posterior, "SCATTERS", np.array([1e-4]))


def measured(curve: np.ndarray, *, scale: float = 0.0, length_error: float = 3e-4, sign: int = 1,
             true_scale: float = 1.0) -> MeasuredStrip:
    """A curve with small independent errors, and a relative error of its ``scale``."""
    length = np.linalg.norm(np.diff(curve, axis=0), axis=1).sum()
    seen = true_scale * curve
    covariance = NOISE**2 * np.eye(seen.size) + scale**2 * np.outer(seen.ravel(), seen.ravel())
    return MeasuredStrip(seen, covariance, length, length_error, sign)


@pytest.mark.usefixtures("equal_specimens")
@pytest.mark.parametrize("law", LAWS)
def test_exact_curves_give_the_moduli(law):
    alpha, beta = law
    found = told([measured(curve) for curve in curves_of(alpha, beta)])
    assert found.alpha == pytest.approx(alpha, rel=4e-3)
    assert found.beta == pytest.approx(beta, rel=2e-2)
    assert found.misfit < 0.5 and abs(found.curl[0]) < found.curl[1]
    (low, high), (lower, upper) = found.intervals(0.9)
    assert low < alpha < high and lower < beta < upper


@pytest.mark.usefixtures("equal_specimens")
def test_an_error_of_the_scale_is_three_of_alpha_unless_the_length_is_known():
    curves = curves_of(ALPHA, BETA)
    loose = told([measured(c, scale=0.005, length_error=np.inf, true_scale=1.005) for c in curves])
    tight = told([measured(c, scale=0.005, length_error=2e-5, true_scale=1.005) for c in curves])
    deviation = np.sqrt(loose.posterior.covariance[0, 0])
    # The error of 0.5 % is another one for each of the two strips.
    assert 0.6 * 3 * 0.005 / np.sqrt(2) < deviation < 1.6 * 3 * 0.005 / np.sqrt(2)
    assert loose.posterior.mean[0] - np.log(ALPHA) == pytest.approx(3 * np.log(1.005), rel=0.3)
    assert abs(tight.posterior.mean[0] - np.log(ALPHA)) < 0.005
    assert tight.posterior.covariance[0, 0] < deviation**2 / 2


@pytest.mark.usefixtures("equal_specimens")
@pytest.mark.parametrize("curl", [-4.0, 4.0])
def test_both_faces_give_the_natural_curvature(curl):
    strips = [measured(heavy_elastica(ALPHA, BETA, weight=WEIGHT, length=0.04, points=81,
                                      curl=sign * curl), sign=sign) for sign in (1, -1)]
    both = told(strips)
    assert both.curl[0] == pytest.approx(curl, abs=3 * both.curl[1]) and both.curl[1] < 1
    assert both.alpha == pytest.approx(ALPHA, rel=0.01)
    # Of one face the shape of the curve alone determines the natural curvature.
    one = told(strips[:1])
    assert one.posterior.covariance[0, 0] > 9 * both.posterior.covariance[0, 0]
    assert one.curl[1] > 2 * both.curl[1]
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
    found = told([], (length,))
    # The rigidity rho g c³ is that of the strip's curvature: softer than alpha if beta < 0.
    rigidity = WEIGHT * length.length**3
    assert 1.0 < found.alpha / rigidity < 1.3 and found.curl[1] == pytest.approx(7.1, rel=0.1)
    rows = found.measured.rows
    assert rows.shape == (1, 3), "one number determines one modulus"
    # Of linear cloth without natural curvature; a specimen differs from the fabric.
    gap = rows[0] @ [np.log(rigidity), 0.0, 0.0] - found.measured.values[0]
    assert abs(gap) < 1.0 and 1 / abs(rows[0, 0]) == pytest.approx(np.hypot(0.1, 0.03), rel=0.35)


@pytest.mark.parametrize("count", [2, 3, 5])
def test_ordinary_repeats_are_estimated_and_say_how_specimens_differ(count):
    """Of 27 to 31 mm, as users of the standards have them: 15 % of alpha about its mean."""
    repeats = [BendingLength(1e-3 * each, 2e-5 * each, sign)
               for each in np.linspace(27.0, 31.0, count) for sign in (1, -1)]
    found, alike = told([], tuple(repeats)), told([], tuple(repeats[:2]) * count)
    assert found.misfit < 3 and found.scatter > 1.15 * alike.scatter
    assert alike.scatter <= 0.13  # assumed of one specimen: 0.12
    deviations = [np.sqrt(each.posterior.covariance[0, 0]) for each in (found, alike)]
    assert deviations[1] < deviations[0] < 0.5
    # The standards' way: the mean of the rigidities.
    rigidity = np.mean([WEIGHT * each.length**3 for each in repeats])
    assert found.alpha == pytest.approx(1.15 * rigidity, rel=0.13)


def test_entries_of_one_specimen_do_not_tell_how_specimens_differ():
    repeats = [BendingLength(0.02, 4e-4, specimen=name) for name in ("a", "a", "a")]
    apart = [BendingLength(0.02, 4e-4) for _ in range(3)]
    same, each = told([], tuple(repeats)), told([], tuple(apart))
    assert abs(same.measured.rows[0, 0]) < 0.8 * abs(each.measured.rows[0, 0])


def test_a_bending_length_that_contradicts_a_curve_is_named():
    strips = [measured(curves_of(ALPHA, BETA)[1])]
    with pytest.raises(InputError, match=r"the strips differ by .* of one direction"):
        told(strips, (BendingLength(0.05, 2e-4),))


def test_strips_of_different_fabrics_are_refused():
    strips = [measured(curves_of(*law)[0]) for law in LAWS[:2]]
    with pytest.raises(InputError, match="of one direction"):
        told(strips)
