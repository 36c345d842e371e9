"""Estimates of simulated captures, and what is computed from them."""

import numpy as np
import pytest

from drapenet.fabric.stages import by_network
from drapenet.network.checkpoint import BUNDLED
from experiments.drapes import (
    as_read,
    capture_drape,
    drape_specimen,
    header,
    ideal_setups,
    plan_specimen,
)

trained = pytest.mark.skipif(not BUNDLED.exists(), reason="no network is bundled")


@trained
def test_estimates_are_along_the_true_warp_for_all_orientations():
    plan = plan_specimen(4, seed=1)
    theta = plan.theta.copy()
    theta[:3] = np.log([120e-6, 40e-6, 15e-6])
    theta[3:] = -1e-3
    shape = drape_specimen(type(plan)(**{**plan.__dict__, "theta": theta}), edge=6e-3)
    for number in range(3):
        captured = capture_drape(shape, ideal_setups(), np.random.default_rng(number))
        found = by_network(as_read(captured), header())
        mean = found.estimate.samples.mean(axis=0)
        assert mean[0] > mean[2] + 0.5
