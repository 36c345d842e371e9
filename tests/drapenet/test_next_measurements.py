"""What a further measurement is expected to add, against posteriors of what it measures."""

import numpy as np
import pytest

from common.normal import Linear, Normal
from drapenet.fabric.next_measurements import another_disc, drapes_evidence, reductions
from drapenet.measured.strips.photograph import expected_strip
from drapenet.measured.strips.posterior import direction_evidence, expected_evidence
from drapenet.views.observation import Observation
from sim.cantilever import heavy_elastica
from sim.rig import GRAVITY, Rig

WEIGHT = 0.3 * GRAVITY
DEVIATIONS = np.array([0.2, 0.2, 0.2, 2e-3, 2e-3, 2e-3, 3.0, 3.0, 0.3, 0.1])


def cloth(ratio: float = -2e-3) -> Normal:
    mean = np.array([-10.0, -10.5, -11.0, ratio, ratio, ratio, 0.0, 0.0, 6.0, 0.2])
    return Normal(mean, np.diag(np.square(DEVIATIONS)))


def test_evidence_as_accurate_as_an_estimate_narrows_it_by_the_root_of_two():
    rows = np.zeros((1, 10))
    rows[0, 0] = 1 / DEVIATIONS[0]
    alpha, beta = reductions(cloth(ratio=0.0), Linear(rows, np.zeros(1)))
    np.testing.assert_allclose(alpha, [1 - np.sqrt(0.5), 0, 0], atol=1e-9)
    np.testing.assert_allclose(beta, 0, atol=1e-9)  # alpha and beta/alpha 0 are independent


def test_beta_is_narrower_where_alpha_is_if_it_is_a_share_of_alpha():
    rows = np.zeros((1, 10))
    rows[0, 0] = 1e3  # alpha of the warp is known
    before, after = np.hypot(2e-3, 0.02 * 0.2), 2e-3  # of beta over alpha's mean
    _, beta = reductions(cloth(ratio=-0.02), Linear(rows, np.zeros(1)))
    assert beta[0] == pytest.approx(1 - after / before, rel=1e-3) and beta[1] == 0


def test_evidence_of_drapes_leads_from_one_posterior_to_the_other():
    before = cloth()
    after = Normal(before.mean, before.covariance.copy())
    after.covariance[1, 1] /= 4
    found = before.updated(drapes_evidence(before, after))
    np.testing.assert_allclose(found.covariance, after.covariance, rtol=1e-6, atol=1e-15)


def test_expected_strips_say_what_strips_of_the_same_curves_do():
    state, strips = np.array([np.log(40e-6), -2e-3, 1.0]), []
    for sign, length in ((1, 0.036), (-1, 0.06)):
        strips.append(expected_strip(heavy_elastica(
            40e-6, -2e-3 * 40e-6, weight=WEIGHT, length=length, curl=sign * state[2], points=61),
            length, sign=sign))
    prior = Normal(state, np.diag([0.5, 2e-3, 3.0]) ** 2)
    measured = direction_evidence(strips, weight=WEIGHT, prior=prior)
    expected = prior.updated(expected_evidence(strips, weight=WEIGHT, state=state))
    np.testing.assert_allclose(np.sqrt(np.diag(expected.covariance)),
                               np.sqrt(np.diag(measured.posterior.covariance)), rtol=0.05)
    assert 0.04 < np.sqrt(expected.covariance[0, 0]) < 0.07  # two specimens that differ by 7 %


@pytest.mark.parametrize(("tester", "share", "disc"), [
    ("disc300_support180", 0.9, "disc360_support180"),
    ("disc300_support180", 0.2, "disc240_support180"), ("disc360_support180", 0.9, None)])
def test_a_flat_drape_asks_for_a_larger_disc(tester, share, disc):
    found = another_disc([Observation(Rig.from_name(tester), 1, True, coefficient=share)])
    assert (found and found.name) == disc
    assert another_disc([]).name == "disc300_support180"
