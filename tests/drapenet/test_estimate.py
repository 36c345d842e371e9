"""From samples of a posterior to what people read."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from estimates import DOUBT, document_of, estimate_of

import drapenet
from common.errors import InputError
from common.files import replace_json
from common.findings import Finding, texts
from data.fabrics.fabrics import ClothProperties
from drapenet.measured.base import Quantity
from drapenet.network.checkpoint import Header, read_header
from drapenet.network.predict import Draws
from drapenet.result.estimate import make_estimate
from drapenet.result.files import read_document, write_estimate
from drapenet.result.terminal import terminal_text
from sim.material import DIRECTIONS, DRAPE_CURVATURE, MICRO, NANO, is_admissible

DENSITY = 0.15


def drawn(alpha: list[float], *, known: bool = True, deviation: float = 0.1) -> Draws:
    """Samples around alphas in µN·m at 300 g/m² and beta = -2.5 mm alpha."""
    rng = np.random.default_rng(0)
    theta = np.concatenate([np.log(np.array(alpha) * MICRO), np.full(3, -2.5e-3)])
    samples = theta + rng.normal(size=(4000, 6)) * np.array([deviation] * 3 + [3e-4] * 3)
    cloth = ClothProperties(samples, rng.normal(2, 0.5, (4000, 2)),
                            rng.lognormal(np.log(600), 0.1, 4000), rng.uniform(0.1, 0.3, 4000))
    return Draws(cloth, known, 0.0)


@pytest.fixture
def header(untrained_checkpoint) -> Header:
    return read_header(untrained_checkpoint)


@pytest.mark.parametrize(("known", "names"), [
    (True, ("warp", "bias", "weft")), (False, ("stiff", "bias", "soft"))])
def test_a_stated_warp_names_the_directions(header, known, names):
    estimate = make_estimate(drawn([60, 40, 20], known=known), density=DENSITY, header=header)
    assert estimate.names == names and not estimate.warnings
    assert estimate.fabric.alpha / MICRO == pytest.approx([30, 20, 10], rel=0.02)  # half density
    assert estimate.nuisances.membrane == pytest.approx(600, rel=0.02)


@pytest.mark.parametrize(("alpha", "impossible", "doubt", "times"), [
    ([60, 40, 20], 0.3, "30% of the posterior samples", 1),
    ([6000, 4000, 2000], 0.1, "extrapolation", 3)])
def test_what_is_doubtful_is_told(header, alpha, impossible, doubt, times):
    draws = replace(drawn(alpha), impossible=impossible)
    estimate = make_estimate(draws, density=DENSITY, header=header)
    assert sum(doubt in line for line in texts(estimate.warnings)) == times


def test_the_median_is_a_possible_fabric(header):
    """Samples on both sides of the impossible: none of them is impossible, their medians are."""
    draws = drawn([60, 40, 20])
    theta = draws.cloth.theta.copy()
    theta[:, :3] = np.log(MICRO * np.array([60, 2.4, 20.0]))
    theta[::2, 1] += 2.0
    theta[1::2, 0] -= 1.0
    draws = Draws.possible(replace(draws.cloth, theta=theta), known=True)
    estimate = make_estimate(draws, density=DENSITY, header=header)
    assert is_admissible(estimate.fabric.alpha, estimate.fabric.beta)


def test_a_document_holds_medians_intervals_correlations_and_the_law(header):
    estimate = make_estimate(drawn([60, 40, 20], deviation=0.2), density=DENSITY, header=header)
    content = document_of(estimate).content()
    json.dumps(content, allow_nan=False)
    for part, factor in (("moduli", 0.5), ("moduli_at_300_g_m2", 1.0)):
        alpha = content[part]["warp"]["alpha_uN_m"]
        assert alpha["median"] == pytest.approx(60 * factor, rel=0.02)
        assert alpha["interval_68"] == pytest.approx(
            60 * factor * np.exp([-0.2, 0.2]), rel=0.03)
        assert alpha["interval_90"] == pytest.approx(
            60 * factor * np.exp([-0.329, 0.329]), rel=0.03)
        beta = content[part]["weft"]["beta_nN_m2"]["median"]
        assert beta == pytest.approx(-50 * factor, rel=0.03)
        in_a_drape = content[part]["warp"]["drape_stiffness_uN_m"]
        stiffness = 60 * factor * (1 - 2.5e-3 * DRAPE_CURVATURE)
        assert in_a_drape["median"] == pytest.approx(stiffness, rel=0.02)
        # As wide as alpha's: the ratio of beta to alpha is known here.
        assert in_a_drape["interval_90"] == pytest.approx(
            stiffness * np.exp([-0.329, 0.329]), rel=0.05)
    assert np.shape(content["correlations"]["matrix"]) == (6, 6)
    law = content["torque_mN"]
    expected = 30e-6 * 25 * (1 - 2.5e-3 * 25) * 1e3
    assert law["warp"]["median"][0] == pytest.approx(expected, rel=0.02)
    assert np.shape(law["warp"]["interval_90"]) == (2, len(law["curvature_1_m"]))
    assert content["poorly_constrained"] == []
    assert content["cloth"]["membrane_n_per_m"]["median"] == pytest.approx(300, rel=0.02)


def test_what_is_as_wide_as_the_prior_is_poorly_constrained(header):
    document = document_of(make_estimate(drawn([60, 40, 20], deviation=0.8), density=DENSITY,
                                         header=header))
    assert "alpha bias" in document.poorly_constrained
    assert "alpha warp/weft" in document.poorly_constrained
    assert "beta/alpha bias" not in document.poorly_constrained
    assert document.mostly_usual[0].text in terminal_text(document)


@pytest.mark.parametrize(("median", "low", "high", "text"), [
    (12.3456, 11.0, 14.0, ("12.3", "11.0 to 14.0")),
    (123.456, 90.0, 150.0, ("123", "90 to 150")),
    (0.012345, 0.011, 0.014, ("0.0123", "0.0110 to 0.0140")),
])
def test_digits_follow_the_uncertainty(median, low, high, text):
    quantity = Quantity(median=median, interval_68=[low, high], interval_90=[low, high])
    assert quantity.texts() == text


def test_an_estimate_is_loaded_with_its_samples(tmp_path):
    """As docs/use.md shows it."""
    alpha = np.array([60.0, 40.0, 20.0]) * MICRO
    estimate = estimate_of(alpha, np.zeros(3), density=0.15, deviation=0.1)
    write_estimate(tmp_path, estimate, document_of(estimate, warnings=[DOUBT]))
    loaded = drapenet.load(tmp_path)
    np.testing.assert_array_equal(loaded.samples, estimate.samples)
    assert np.median(loaded.moduli()[0], axis=0) == pytest.approx(alpha)  # N·m
    assert (loaded.names, loaded.density, loaded.warnings) == (DIRECTIONS, 0.15, (DOUBT,))
    cloth = vars(estimate.cloth) | {"spread": estimate.spread}
    for change in ({"theta": estimate.samples + 1}, {"theta": np.zeros((9, 5))},
                   {"spread": np.ones(5)}, {"curl": np.zeros(13)}, {"theta": np.array([{}])}):
        np.savez(tmp_path / "samples.npz", **cloth | change)
        with pytest.raises(InputError, match=r"samples\.npz"):
            drapenet.load(tmp_path / "estimate.json")


def test_readings_and_intervals_of_an_estimate_are_those_of_its_document():
    estimate = estimate_of(np.array([60.0, 40.0, 20.0]) * MICRO, np.zeros(3), density=0.15,
                           deviation=0.1)
    found = document_of(estimate).laboratory
    for key in ("bending_length_mm", "kes_b_gf_cm2_per_cm"):
        samples = estimate.reading(key)
        for k, name in enumerate(DIRECTIONS):
            stated = getattr(found[name], key)
            assert np.median(samples[:, k]) == pytest.approx(stated.median)
            assert drapenet.interval(samples)[:, k] == pytest.approx(stated.interval_68)
            assert drapenet.interval(samples, 0.9)[:, k] == pytest.approx(stated.interval_90)
    with pytest.raises(InputError, match="no tester reads softness; choose from bending_length_mm"):
        estimate.reading("softness")
    assert {"Capture", "Estimate", "interval"} <= set(drapenet.__all__)
    with pytest.raises(AttributeError, match="no attribute 'intervals'"):
        drapenet.intervals  # noqa: B018


def test_an_estimate_prints_as_one_line():
    estimate = estimate_of(np.array([60.0, 40.0, 20.0]) * MICRO, np.zeros(3), density=0.15)
    text, count = repr(estimate), len(estimate.samples)
    assert text.startswith("Estimate(warp, bias, weft: Fabric(alpha [60, 40, 20] µN·m, beta [")
    assert text.endswith(f", 150 g/m²), {count} samples, 0 warnings)") and "\n" not in text


def test_the_stiffness_in_a_drape_is_told_where_it_is_known():
    document = document_of(estimate_of(np.full(3, 30 * MICRO), np.full(3, -75 * NANO)))
    assert "stiffness in a drape (secant at 60 1/m): warp 25.5" in terminal_text(document)
    content = document.content()
    for moduli in content["moduli"].values():
        del moduli["drape_stiffness_uN_m"]
    assert "in a drape" not in terminal_text(type(document).of(content, Path("earlier.json")))


def test_document_is_read_as_written(tmp_path):
    part = Finding("part_has_warning", {"label": "a", "count": 1, "first": DOUBT.record})
    document = document_of(estimate_of(np.full(3, 30 * MICRO), np.zeros(3)),
                           warnings=[part, DOUBT])
    file = tmp_path / "estimate.json"
    replace_json(file, document.content())
    assert read_document(file) == document
    assert read_document(file).content() == document.content()
    assert read_document(file).warnings == [part, DOUBT]
    assert part.text.endswith(f"by itself: {DOUBT.text}")


@pytest.mark.parametrize("change", [
    {"code": "none"}, {"code": []}, {"values": {"value": 2.9}}, {"values": 2.9}, {"source": 2},
    {"values": {"value": "x", "limit": 2.6}}])
def test_a_finding_that_cannot_be_said_is_refused(tmp_path, change):
    content = document_of(estimate_of(np.full(3, 30 * MICRO), np.zeros(3))).content()
    replace_json(tmp_path / "estimate.json", content | {"warnings": [DOUBT.record | change]})
    with pytest.raises(InputError, match=r"warnings\.0.* is not the record of a finding"):
        read_document(tmp_path / "estimate.json")
