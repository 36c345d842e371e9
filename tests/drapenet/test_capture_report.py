"""What a refinement makes of the network's estimate."""

import dataclasses
import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from data.cameras import CameraRig
from data.captures import Capture
from drapenet.checkpoint import Header, read_header
from drapenet.estimate import Estimate, belief, make_estimate
from drapenet.predict import Prediction
from drapenet.refine import capture_report
from drapenet.refine.optimisers import Status
from drapenet.refine.views import RefinedViews
from sim.material import MICRO

CAPTURE = Capture(np.zeros((4, 180, 240), np.float32), CameraRig.load().intrinsics, 0.15, 0.5,
                  "square300_cylinder100", Path("here"), ())
SPREAD = np.array([0.35, 0.2, 0.01, 3e-4, 2e-4, 1e-4])


@pytest.fixture
def header(untrained_checkpoint: Path) -> Header:
    return read_header(untrained_checkpoint)


@pytest.fixture
def before(header: Header) -> Estimate:
    """Warp stiff, beyond the fabrics trained on; the view orders disagree on the warp only."""
    theta = np.concatenate([np.log(np.array([4000, 40, 20]) * MICRO), np.full(3, -2.5e-3)])
    return make_estimate(Prediction(theta, SPREAD, 0.5, 0.9), capture=CAPTURE, header=header)


def refined(alpha: list[float]) -> RefinedViews:
    """Moduli (µN·m at 300 g/m², along the axes of the specimen) found without an uncertainty."""
    theta = np.concatenate([np.log(np.array(alpha) * MICRO), np.full(3, -2e-3)])
    return RefinedViews(
        start=theta, start_value=2.0, best=SimpleNamespace(theta=theta, nuisance=np.array([0.5]),
                                                           value=1.0),
        drape=None, objective=None, uncertainty=None, simulations=20, seconds=1.0,
        status=Status.CONVERGED, message="")


def test_yarns_that_change_places_take_their_names_and_spread_along(before: Estimate) -> None:
    assert before.names == ("warp", "bias", "weft")
    after = capture_report._corrected(before, refined([30, 40, 60]), density=0.15)
    assert after.names == ("weft", "bias", "warp")
    assert after.fabric.alpha / MICRO == pytest.approx([30, 20, 15])
    spread = dict(zip(after.names, after.prediction.spread, strict=False))
    assert spread == {"warp": SPREAD[0], "bias": SPREAD[1], "weft": SPREAD[2]}
    assert after.prediction.axis == pytest.approx(0.5 + math.pi / 2)
    same = capture_report._corrected(before, refined([60, 40, 30]), density=0.15)
    assert same.names == before.names and np.array_equal(same.prediction.spread, SPREAD)


@pytest.mark.parametrize("alpha", [[60, 40, 30], [30, 40, 60]])
def test_without_an_uncertainty_the_networks_errors_stand(
    before: Estimate, header: Header, alpha: list[float]
) -> None:
    known = belief(before.prediction, header)
    found = refined(alpha)
    after = capture_report._corrected(before, found, density=0.15)
    content = capture_report._content(before, after, found, known)
    errors = {name: content["typical_error"][name]["alpha_percent"] for name in before.names}
    expected = 100 * np.expm1(np.sqrt(np.diag(known.covariance))[:3])
    assert errors == pytest.approx(dict(zip(before.names, expected, strict=True)))
    assert errors["warp"] > 2 * errors["weft"]
    assert any("no uncertainty" in warning for warning in content["warnings"])


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
