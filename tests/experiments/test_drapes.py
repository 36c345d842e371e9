"""Estimates of simulated captures."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from data.captures.capture import DepthCapture
from data.render.setups import Setups
from drapenet.fabric.stages import by_network
from drapenet.network.checkpoint import BUNDLED, read_header
from sim.draping import drape
from sim.material import MICRO, REFERENCE_DENSITY, Fabric
from sim.rig import SQUARE_RIG

CLEAN = replace(Setups.load("real"), views=(0.0, 0.0, 0.0, 1.0), sensors={"smooth": 1.0}, turn=0.0,
                focal=0.0, border=0, holes=0, hem_share=0.0)


@pytest.mark.skipif(not BUNDLED.exists(), reason="no network is bundled")
def test_estimates_are_along_the_true_warp_for_all_orientations():
    alpha = np.array([120.0, 40.0, 15.0]) * MICRO
    shape = drape(Fabric(alpha, -1e-3 * alpha), edge=6e-3, seed=4)
    for number in range(3):
        taken = CLEAN.capture(shape.positions, shape.faces, np.random.default_rng(number),
                              rig=SQUARE_RIG)
        captured = DepthCapture(taken.views, taken.intrinsics, taken.turns, rig=SQUARE_RIG,
                                density=REFERENCE_DENSITY, path=Path(),
                                warp_direction=taken.orientation % np.pi)
        mean = by_network(captured, read_header()).estimate.samples.mean(axis=0)
        assert mean[0] > mean[2] + 0.5
