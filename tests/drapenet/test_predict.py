"""Predictions do not depend on how a capture was turned, nor on the order of a set's captures."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from common.errors import InputError
from data.fabrics.fabrics import from_theta
from drapenet.network.checkpoint import Header, read_header
from drapenet.network.predict import DRAWS, network_of, predict
from drapenet.network.trained import Trained
from drapenet.result.files import read_observation, write_observation
from drapenet.views.directions import AZIMUTHS, ELEVATIONS
from drapenet.views.observation import Observation
from drapenet.views.outline import DrapeOutline, outline_of_map
from drapenet.views.radial_map import RadialMap
from sim.material import is_admissible
from sim.rig import DISC_RIG, LARGE_DISC_RIG, SQUARE_RIG

AZIMUTH = 2 * np.pi * (np.arange(AZIMUTHS) + 0.5) / AZIMUTHS
RADIUS = 0.12 + 0.006 * np.cos(2 * AZIMUTH) + 0.004 * np.sin(5 * AZIMUTH)


def depth(known: bool = True) -> Observation:
    distance = 0.66 * RADIUS[:, None] * np.linspace(0.9, 1.1, ELEVATIONS)
    drape = RadialMap(distance, np.ones_like(distance), 0.3, 4)
    return Observation(SQUARE_RIG, 1, known, drape, outline_of_map(drape, SQUARE_RIG))


def outline(known: bool = True, face: int = 1) -> Observation:
    return Observation(DISC_RIG, face, known, outline=DrapeOutline(RADIUS, 1.0))


@pytest.fixture(scope="module")
def network(untrained_checkpoint: Path) -> tuple[Trained, Header]:
    header = read_header(untrained_checkpoint)
    return network_of(header), header


def theta(network: tuple[Trained, Header], *captures: Observation) -> np.ndarray:
    return predict(*network, [captures])[0].cloth.theta


def turned(capture: Observation, cells: int) -> Observation:
    rolled = replace(capture.outline, radius=np.roll(capture.outline.radius, cells))
    drape = capture.map and replace(capture.map, distance=np.roll(capture.map.distance, cells, 0))
    return replace(capture, map=drape, outline=rolled)


@pytest.mark.parametrize("capture", [depth(), outline()])
def test_samples_are_possible_fabrics(network, capture: Observation) -> None:
    draws, = predict(*network, [[capture]])
    assert is_admissible(*from_theta(draws.cloth.theta)).all()
    assert len(draws.cloth.theta) == len(draws.cloth.curl) == round(
        DRAWS * (1 - draws.impossible))


@pytest.mark.parametrize(("capture", "cells"), [
    (depth(), AZIMUTHS // 2), (outline(), AZIMUTHS // 2),
    (depth(known=False), AZIMUTHS // 4), (outline(known=False), 3 * AZIMUTHS // 4)])
def test_symmetries_do_not_change_the_answer(
    network, capture: Observation, cells: int
) -> None:
    first, second = theta(network, capture), theta(network, turned(capture, cells))
    # Other samples of the same answers.
    assert (second.mean(axis=0) - first.mean(axis=0)) / first.std(axis=0) == pytest.approx(
        np.zeros(6), abs=0.1)


def test_the_order_of_captures_does_not_matter(network) -> None:
    captures = depth(), outline(), Observation(LARGE_DISC_RIG, -1, True, coefficient=0.5, nodes=6)
    np.testing.assert_allclose(theta(network, *captures[::-1]), theta(network, *captures),
                               rtol=1e-3, atol=1e-8)
    assert np.abs(theta(network, *captures).mean(axis=0)
                  - theta(network, captures[0]).mean(axis=0)).max() > 1e-6


def test_sets_of_one_call_do_not_mix(network) -> None:
    together = predict(*network, [[depth(), outline()], [outline()]])
    np.testing.assert_allclose(together[1].cloth.theta.mean(axis=0),
                               theta(network, outline()).mean(axis=0), rtol=0.05)


def test_an_unknown_warp_of_one_capture_is_unknown_for_all(network) -> None:
    draws, = predict(*network, [[depth(), outline(known=False)]])
    assert not draws.known


def test_the_height_of_the_camera_matters(network) -> None:
    near = replace(outline(), outline=DrapeOutline(RADIUS, 0.5))
    unknown = replace(outline(), outline=DrapeOutline(RADIUS, np.nan))
    answers = [theta(network, capture).mean(axis=0) for capture in (outline(), near, unknown)]
    assert all(np.abs(answers[a] - answers[b]).max() > 1e-6 for a, b in ((0, 1), (0, 2), (1, 2)))


@pytest.mark.parametrize("capture", [
    depth(), outline(face=-1), Observation(LARGE_DISC_RIG, -1, False, coefficient=0.5, nodes=6)],
    ids=["depth", "outline", "numbers"])
def test_what_the_network_has_read_is_kept_beside_the_estimate(network, tmp_path, capture) -> None:
    write_observation(tmp_path, capture)
    again = read_observation(tmp_path)
    assert (again.rig, again.face, again.known) == (capture.rig, capture.face, capture.known)
    np.testing.assert_array_equal(theta(network, again), theta(network, capture))
    (tmp_path / "observation.npz").write_bytes((tmp_path / "observation.npz").read_bytes()[:-99])
    with pytest.raises(InputError, match=r"observation\.npz cannot be read"):
        read_observation(tmp_path)
