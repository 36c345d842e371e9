"""Predictions do not depend on how the capture was turned."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from data.captures.capture import read_capture
from data.fabrics.fabrics import from_theta
from drapenet.inference import network_estimate
from drapenet.network.checkpoint import bundled, load_model, read_header
from drapenet.network.predict import DRAWS, predict
from drapenet.views.directions import AZIMUTHS, ELEVATIONS
from drapenet.views.radial_map import RadialMap
from sim.material import is_admissible


@pytest.fixture(scope="module")
def radial_map_of_a_capture() -> RadialMap:
    azimuth = 2 * np.pi * (np.arange(AZIMUTHS) + 0.5) / AZIMUTHS
    distance = 0.08 + 0.01 * np.cos(2 * azimuth) + 0.004 * np.sin(5 * azimuth)
    distance = distance[:, None] * np.linspace(0.9, 1.1, ELEVATIONS)
    return RadialMap(distance, np.ones_like(distance), 0.3, 4)


def test_samples_are_possible_fabrics_in_the_first_view_s_axes(
    untrained_checkpoint, radial_map_of_a_capture
):
    header = read_header(untrained_checkpoint)
    draws, = predict(load_model(header), header, [radial_map_of_a_capture])
    assert is_admissible(*from_theta(draws.theta)).all()
    assert len(draws.theta) == len(draws.axis) == round(8 * DRAWS * (1 - draws.impossible))
    assert (draws.axis == 0.3).all()


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_a_quarter_turn_of_the_map_exchanges_the_yarns(
    untrained_checkpoint, radial_map_of_a_capture, quarters
):
    header = read_header(untrained_checkpoint)
    network, one = load_model(header), radial_map_of_a_capture
    turned = RadialMap(np.roll(one.distance, quarters * AZIMUTHS // 4, axis=0), one.weight,
                       one.zero - quarters * np.pi / 2, one.views)
    first, second = (draws.theta for draws in predict(network, header, [one, turned]))
    order = [2, 1, 0, 5, 4, 3] if quarters % 2 else list(range(6))
    deviation = first.std(axis=0)
    # Other samples of the same eight answers.
    assert ((second[:, order].mean(axis=0) - first.mean(axis=0)) / deviation) == pytest.approx(
        np.zeros(6), abs=0.1)


def test_what_is_known_changes_the_answer(untrained_checkpoint, radial_map_of_a_capture):
    header = read_header(untrained_checkpoint)
    network = load_model(header)
    unknown, = predict(network, header, [radial_map_of_a_capture])
    known, = predict(network, header, [radial_map_of_a_capture], membrane=1000.0)
    assert abs(known.theta.mean(axis=0) - unknown.theta.mean(axis=0)).max() > 1e-6


def test_what_is_known_of_a_fabric_is_that_of_its_own_density():
    """A fabric half as heavy drapes the same with half the moduli and half the membrane."""
    twill = Path(__file__).parents[2] / "examples" / "captures" / "twill"
    capture = read_capture(twill)
    header = read_header(bundled(capture.rig))
    heavy, light = (
        network_estimate(replace(capture, density=share * 0.3), header,
                      membrane=share * 600.0).estimate for share in (1.0, 0.5))
    np.testing.assert_allclose(light.samples, heavy.samples, rtol=1e-12)
    assert light.fabric.alpha == pytest.approx(heavy.fabric.alpha / 2)
