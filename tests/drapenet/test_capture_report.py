"""What a refinement makes of the network's estimate."""

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest

from data.cameras import CameraRig
from drapenet.estimate import Estimate
from drapenet.refine import capture_report
from drapenet.refine.optimisers import Status
from drapenet.refine.views import RefinedViews
from sim.material import MICRO

SPREAD = np.array([0.9, 0.8, 0.9, 1.4e-3, 1.4e-3, 1.4e-3])


def before(*names: str) -> Estimate:
    """Samples around 60, 40 and 20 µN·m at 300 g/m², the first the least certain."""
    theta = np.concatenate([np.log(np.array([60, 40, 20]) * MICRO), np.full(3, -2.5e-3)])
    deviation = np.array([0.35, 0.2, 0.1, 3e-4, 2e-4, 1e-4])
    samples = theta + deviation * np.random.default_rng(0).normal(size=(4000, 6))
    return Estimate(samples, names, 0.5, 0.9, 0.15, SPREAD)


def refined(alpha: list[float], covariance: np.ndarray | None = None) -> RefinedViews:
    """Moduli (µN·m at 300 g/m², along the axes of the specimen) that were found."""
    theta = np.concatenate([np.log(np.array(alpha) * MICRO), np.full(3, -2e-3)])
    uncertainty = None if covariance is None else SimpleNamespace(covariance=covariance,
                                                                  reduced_chi2=1.0)
    return RefinedViews(
        start=theta, start_value=2.0, best=SimpleNamespace(theta=theta, nuisance=np.array([0.5]),
                                                           value=1.0),
        drape=None, objective=None, uncertainty=uncertainty, simulations=20, seconds=1.0,
        status=Status.CONVERGED, message="")


def test_samples_are_those_of_the_uncertainty_found() -> None:
    covariance = np.diag(np.array([0.1, 0.05, 0.02, 1e-4, 1e-4, 1e-4]) ** 2)
    after = capture_report._corrected(before("warp", "bias", "weft"),
                                      refined([30, 40, 60], covariance))
    assert after.names == ("warp", "bias", "weft") and after.axis == 0.5
    assert after.fabric.alpha / MICRO == pytest.approx([15, 20, 30], rel=0.01)
    assert np.cov(after.samples.T) / covariance.max() == pytest.approx(
        covariance / covariance.max(), abs=0.05)


def test_yarns_that_change_places_are_the_stiff_ones_then() -> None:
    one = before("stiff", "bias", "soft")
    after = capture_report._corrected(one, refined([30, 40, 60]))
    assert after.names == ("stiff", "bias", "soft")
    assert after.fabric.alpha / MICRO == pytest.approx([30, 20, 15], rel=0.02)
    assert after.axis == pytest.approx(0.5 + math.pi / 2)
    # Without an uncertainty of its own it keeps that of each yarn.
    assert after.samples.std(axis=0)[[2, 1, 0]] == pytest.approx(one.samples.std(axis=0)[:3],
                                                                 rel=0.05)
    assert any("no uncertainty" in warning for warning in after.warnings)


def test_the_change_is_that_of_each_direction() -> None:
    one = before("warp", "bias", "weft")
    found = refined([66, 40, 30])
    change = capture_report._content(one, capture_report._corrected(one, found), found)
    percent = {name: row["alpha_percent"] for name, row in change["refined"]["change"].items()}
    assert percent == pytest.approx({"warp": 10, "bias": 0, "weft": 50}, abs=2.5)


def test_an_interruption_at_the_last_moment_loses_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    seen = []

    def render(positions: np.ndarray, nuisance: np.ndarray) -> np.ndarray:
        seen.append(nuisance)
        return np.zeros((4, 180, 240))

    monkeypatch.setattr(capture_report, "fit_nuisances", interrupted)
    drape = SimpleNamespace(positions=np.zeros((3, 3)), status=Status.CONVERGED)
    objective = SimpleNamespace(camera=CameraRig.load().nominal(), render=render)
    found = dataclasses.replace(refined([60, 40, 30]), drape=drape, objective=objective)
    shown = capture_report._resimulation(np.zeros((4, 180, 240)), found)
    assert shown.turn == 0.5 and seen[0] is found.best.nuisance
