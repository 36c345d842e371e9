"""Strips against the heavy elastica: the check that the moduli are those of the simulated cloth."""

import numpy as np
import pytest

from sim.cantilever import aspect_ratio, elastica, fabric_of_gamma, hang_strip

TRIANGULATIONS = {
    "alternating": {"diagonals": "alternating"},
    "equal": {"diagonals": "equal"},
    "random": {"diagonals": "random", "seed": 1},
    "jittered": {"diagonals": "random", "jitter": 0.2, "seed": 2},
}


def deviation(gamma: float, **mesh) -> float:
    end, result = hang_strip(fabric_of_gamma(gamma, 0.09), **mesh)
    assert result.status.value == "converged"
    return aspect_ratio(end) / aspect_ratio(elastica(gamma)[-1]) - 1


def test_elastica_tends_to_the_beam_of_small_deflections():
    assert aspect_ratio(elastica(1e-3)[-1]) == pytest.approx(1e-3 / 8, rel=1e-5)


@pytest.mark.parametrize("gamma", [0.1, 10.0, 1000.0])
def test_elastica_balances_torque_everywhere(gamma):
    """curvature = gamma * integral of (x(s') - x(s)) ds' beyond s, from the shape alone (Eq. 5)."""
    shape = elastica(gamma, points=20001)
    s = np.linspace(0, 1, len(shape))
    tangent = np.gradient(shape, s, axis=0)
    curvature = np.gradient(np.arctan2(tangent[:, 1], tangent[:, 0]), s)
    steps = np.diff(s)
    moment_x = np.concatenate([np.cumsum(((shape[:-1, 0] + shape[1:, 0]) / 2 * steps)[::-1])[::-1],
                               [0.0]])
    torque = gamma * (moment_x - shape[:, 0] * (1 - s))
    inner = slice(10, -10)
    assert np.allclose(curvature[inner], torque[inner], atol=2e-3 * np.abs(torque).max())


@pytest.mark.parametrize("mesh", TRIANGULATIONS)
@pytest.mark.parametrize(("gamma", "tolerance"), [(1, 0.005), (10, 0.005), (100, 0.015)])
def test_strip_matches_the_heavy_elastica(gamma, tolerance, mesh):
    """90 × 30 mm, edges of 3 mm, on four triangulations."""
    assert abs(deviation(gamma, **TRIANGULATIONS[mesh])) < tolerance


def test_error_falls_with_the_square_of_the_spacing():
    coarse, fine = (abs(deviation(100, edge=edge)) for edge in (6e-3, 3e-3))
    assert 1.6 < np.log2(coarse / fine) < 2.6
