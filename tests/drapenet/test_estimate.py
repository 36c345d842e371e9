import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from data.cameras import CameraRig
from data.captures import Capture
from drapenet.checkpoint import Header, read_header
from drapenet.estimate import belief, make_estimate, to_json
from drapenet.network_errors import NetworkErrors
from drapenet.predict import Prediction
from drapenet.table import format_table
from sim.material import MICRO, is_admissible

CAPTURE = Capture(np.zeros((4, 180, 240), np.float32), CameraRig.load().intrinsics, 0.15, None,
                  "square300_cylinder100", Path("here"), ())


def predicted(alpha: list[float], *, axis: float = 0.5, confidence: float = 0.9) -> Prediction:
    """A prediction of alphas in µN·m at 300 g/m² and beta = -2.5 mm alpha."""
    targets = np.concatenate([np.log(np.array(alpha) * MICRO), np.full(3, -2.5e-3)])
    return Prediction(targets, np.full(6, 1e-4), axis, confidence)


@pytest.fixture
def header(untrained_checkpoint: Path) -> Header:
    return read_header(untrained_checkpoint)


@pytest.mark.parametrize(("warp", "names"), [
    (None, ("stiff", "bias", "soft")),
    (0.5, ("warp", "bias", "weft")),
    (0.5 + 0.3, ("warp", "bias", "weft")),
    (0.5 + math.pi / 2, ("weft", "bias", "warp")),
    (0.1 + math.pi, ("warp", "bias", "weft")),
])
def test_the_marked_warp_names_the_directions(
    header: Header, warp: float | None, names: tuple[str, ...]
) -> None:
    capture = dataclasses.replace(CAPTURE, warp_direction=warp)
    estimate = make_estimate(predicted([60, 40, 20]), capture=capture, header=header)
    assert estimate.names == names
    assert estimate.convention == ("stiff/soft" if warp is None else "warp/weft")
    assert estimate.fabric.alpha / MICRO == pytest.approx([30, 20, 10])  # half the density
    assert not estimate.warnings
    content = to_json(estimate, capture=capture, header=header)
    assert content["moduli"][names[2]]["alpha_uN_m"] == pytest.approx(10)
    assert content["moduli"][names[2]]["beta_nN_m2"] == pytest.approx(-25)
    assert names[2] in format_table(content)


def test_an_unclear_axis_leaves_stiff_and_soft(header: Header) -> None:
    capture = dataclasses.replace(CAPTURE, warp_direction=0.5)
    estimate = make_estimate(predicted([60, 40, 55], confidence=0.1), capture=capture,
                             header=header)
    assert estimate.convention == "stiff/soft"
    assert any("not identifiable" in line for line in estimate.warnings)


def test_an_axis_between_the_yarns_is_doubted(header: Header) -> None:
    capture = dataclasses.replace(CAPTURE, warp_direction=0.5 + math.radians(40))
    estimate = make_estimate(predicted([60, 40, 20]), capture=capture, header=header)
    assert any("40°" in line for line in estimate.warnings)


def test_what_lies_outside_the_training_set_is_said(header: Header) -> None:
    estimate = make_estimate(predicted([900, 300, 200]), capture=CAPTURE, header=header)
    assert any("alpha (stiff, bias" in line and "outside" in line for line in estimate.warnings)


def test_disagreeing_view_orders_are_told(header: Header) -> None:
    prediction = dataclasses.replace(predicted([60, 40, 20]), spread=np.full(6, 0.8))
    estimate = make_estimate(prediction, capture=CAPTURE, header=header)
    assert any("view orders disagree" in line for line in estimate.warnings)


def test_an_impossible_plate_becomes_the_nearest_possible_one(header: Header) -> None:
    estimate = make_estimate(predicted([90, 2, 10]), capture=CAPTURE, header=header)
    fabric = estimate.fabric
    assert is_admissible(fabric.alpha, fabric.beta)
    limit = (math.sqrt(90) - math.sqrt(10)) ** 2 / 4 / 2
    assert fabric.alpha[1] / MICRO == pytest.approx(limit, rel=0.02)
    assert fabric.beta / fabric.alpha == pytest.approx([-2.5e-3] * 3)
    assert any("no plate" in line for line in estimate.warnings)


def test_errors_are_in_percent_and_millimetres(header: Header) -> None:
    estimate = make_estimate(predicted([60, 40, 20]), capture=CAPTURE, header=header)
    error = to_json(estimate, capture=CAPTURE, header=header)["typical_error"]["stiff"]
    assert error["alpha_percent"] == pytest.approx(100 * (math.exp(0.5 * 0.9) - 1))
    assert error["beta_over_alpha_mm"] == pytest.approx(0.5 * 2.0)


def test_errors_grow_beyond_the_training_set(header: Header) -> None:
    known, unknown = (
        to_json(make_estimate(predicted(alpha), capture=CAPTURE, header=header), capture=CAPTURE,
                header=header)["typical_error"] for alpha in ([60, 40, 20], [60, 40, 0.2]))
    assert unknown["stiff"] == known["stiff"]
    assert unknown["soft"]["alpha_percent"] > 3 * known["soft"]["alpha_percent"]


def test_belief_is_the_usual_error_and_more_beyond_the_training_set(header: Header) -> None:
    inside, outside = (belief(predicted(alpha), header)
                       for alpha in ([60, 40, 20], [60, 40, 0.2]))
    assert inside.mean == pytest.approx(predicted([60, 40, 20]).targets)
    usual = np.sqrt(np.diag(inside.covariance))
    assert usual[:3] == pytest.approx(0.5 * np.array([0.9, 0.8, 0.8]))
    beyond = -12.4 - math.log(0.2 * MICRO)  # the softest of the training set is at -10.8 - 2 * 0.8
    assert np.sqrt(np.diag(outside.covariance)) == pytest.approx(
        [*usual[:2], math.hypot(usual[2], beyond), *usual[3:]])


def test_measured_errors_make_the_belief(header: Header) -> None:
    half = np.random.default_rng(2).standard_normal((6, 6))
    errors = NetworkErrors(np.array([0.1, -0.2, 0, 0, 3e-4, 0]), np.array([0, 0.3, 0, 0, 0, 0]),
                           math.log(36 * MICRO), half @ half.T, fabrics=50)
    header.content["errors"] = {**errors.as_dict(), "vertices": 101}
    inside, outside = (belief(predicted(alpha), header)
                       for alpha in ([60, 40, 20], [60, 40, 0.2]))
    more = np.log(48e3 / 36**3) / 3  # of the level
    off = np.array([0.1, -0.2 + 0.3 * more, 0, 0, 3e-4, 0])
    assert inside.mean == pytest.approx(predicted([60, 40, 20]).targets - off)
    np.testing.assert_allclose(inside.covariance, errors.covariance)
    estimate = make_estimate(predicted([60, 40, 20]), capture=CAPTURE, header=header)
    assert np.log(estimate.fabric.at_density(0.3).alpha) == pytest.approx(inside.mean[:3])
    np.testing.assert_allclose(header.errors.deviation**2, np.diag(errors.covariance))
    further = outside.covariance - errors.covariance  # in the softest direction alone
    assert np.flatnonzero(np.abs(further) > 1e-12).tolist() == [2 * 6 + 2]


def test_errors_that_depend_on_the_level_are_found() -> None:
    rng = np.random.default_rng(3)
    truth = np.column_stack([rng.normal(-11, 0.8, (4000, 3)), rng.normal(-3e-3, 1e-3, (4000, 3))])
    half = np.diag([0.2] * 3 + [1e-3] * 3) @ rng.standard_normal((6, 6))
    level = truth[:, :3].mean(axis=1)
    drift = np.array([0.0, 0.1, -0.05, 0, 0, 0])
    estimates = truth + np.outer(level + 11, drift) - 0.1 + rng.standard_normal((4000, 6)) @ half.T
    found = NetworkErrors.fit(estimates, truth)
    corrected = estimates - np.array([found.mean_at(row) for row in estimates])
    rest, levels = corrected - truth, estimates[:, :3].mean(axis=1)
    assert np.abs(rest.mean(axis=0)).max() < 1e-9
    assert np.abs(np.cov(rest.T, levels)[-1, :-1]).max() < 1e-9
    assert found.covariance == pytest.approx(np.cov(rest.T), rel=0.01)
    again = NetworkErrors.from_dict(found.as_dict())
    assert again.mean_at(estimates[0]) == pytest.approx(found.mean_at(estimates[0]))
