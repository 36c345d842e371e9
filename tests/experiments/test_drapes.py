"""Estimates of simulated captures, and what is computed from them."""

import numpy as np
import pytest

from drapenet.network.checkpoint import BUNDLED
from experiments.drapes import (
    capture_drape,
    drape_specimen,
    ideal_setups,
    infer,
    plan_specimen,
    posterior_bound,
    spread,
)
from experiments.report import read_report, rms

trained = pytest.mark.skipif(not BUNDLED.exists(), reason="no network is bundled")


@trained
def test_the_posterior_bound_has_the_unit_of_the_errors():
    absolute = read_report("information")["rms"]["all nuisances unknown"]["log_alpha"]
    assert posterior_bound() * rms(spread()[:3]) == pytest.approx(absolute, rel=0.03)
    # The report's network had fabrics of nearly the same spread.
    assert read_report("views")["bound"] == pytest.approx(posterior_bound(), rel=0.05)


@trained
def test_estimates_are_along_the_true_warp_for_all_orientations():
    plan = plan_specimen(4, seed=1)
    theta = plan.theta.copy()
    theta[:3] = np.log([120e-6, 40e-6, 15e-6])
    theta[3:] = -1e-3
    shape = drape_specimen(type(plan)(**{**plan.__dict__, "theta": theta}), edge=6e-3)
    for number in range(3):
        found = infer(capture_drape(shape, ideal_setups(), np.random.default_rng(number)))
        mean = found.estimate.samples.mean(axis=0)
        assert mean[0] > mean[2] + 0.5
