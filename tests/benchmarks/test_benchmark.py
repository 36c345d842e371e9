"""The benchmark: its stored captures, and scores that are known beforehand."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.__main__ import ESTIMATORS, estimator_named, main, table_of
from benchmarks.estimators import coefficient_alone
from benchmarks.protocol import CASES, estimates, read_cases, score
from common.errors import InputError
from data.captures.capture import DepthCapture, OutlineCapture
from drapenet.network.checkpoint import read_header

FOLDER = CASES.parent


@pytest.fixture(scope="module")
def cases():
    return read_cases()


def test_the_captures_are_small_and_of_different_fabrics(cases):
    assert sum(file.stat().st_size for file in CASES.rglob("*")) < 2e6
    kinds = {"outline": OutlineCapture, "depth": DepthCapture}
    assert all(isinstance(case.capture, kinds[case.kind]) for case in cases)
    assert [sum(case.kind == kind for case in cases) for kind in kinds] == [24, 16]
    assert len({tuple(np.round(case.truth[:3] / case.truth[0], 3)) for case in cases}) == 24
    assert all(case.capture.warp_direction is not None and 0 < case.coefficient < 100
               for case in cases)


def test_perfect_estimates_have_no_error_and_cover_the_truth(cases):
    near = 1 + 1e-3 * np.linspace(-1, 1, 21)[:, None]
    some = [case for case in cases if case.name.endswith("_00")]
    for found in score(some, [case.truth * near for case in some]).values():
        assert max(found["log_alpha_rms"], found["log_beta_median"]) < 1e-9
        assert found["alpha_inside_68"] == found["beta_inside_90"] == 1.0
        assert found["beta_of_wrong_sign"] == found["drapes_failed"] == 0
        assert found["drape_coefficient_rms"] < 8.0  # other folds, no natural curvature


def test_a_constant_estimate_has_the_errors_of_the_constant(cases):
    some = [case for case in cases if case.name.endswith(("disc300_support180_00", "_03"))]
    constant = np.array([[30e-6] * 3 + [5e-9] * 3])  # beta of the wrong sign
    scored = score(some, estimates(lambda capture: constant, some))
    for kind, found in scored.items():
        truth = np.array([case.truth for case in some if case.kind == kind])
        assert found["log_alpha_rms"] == pytest.approx(
            np.sqrt(np.square(np.log(truth[:, :3] / 30e-6)).mean()))
        assert found["beta_of_wrong_sign"] == (truth[:, 3:] < 0).mean() > 0.5
        assert found["alpha_inside_90"] is found["beta_inside_68"] is None  # of one sample
        assert found["drape_coefficient_rms"] > 1.0
    assert len(table_of({"mine:constant": scored}).splitlines()) == 4


def test_the_coefficient_alone_tells_limp_from_stiff_and_scales_with_density(cases):
    capture = cases[-1].capture
    first, heavier = (coefficient_alone(replace(capture, density=factor * capture.density))
                      for factor in (1, 2))
    np.testing.assert_allclose(heavier, 2 * first)
    middle = np.log([np.median(coefficient_alone(case.capture), axis=0)[:3].mean()
                     / case.capture.density for case in cases])
    true = np.log([case.truth[:3].mean() / case.capture.density for case in cases])
    assert np.corrcoef(middle, true)[0, 1] > 0.7


@pytest.mark.parametrize(("samples", "complaint"), [
    (np.ones(6), "the estimate of depth_.*give finite samples"),
    (np.full((2, 6), np.nan), "finite samples"), (np.zeros((3, 6)), "give positive ones"),
    (np.full((2, 6), 30.0), "alpha of 30 N·m, .*not µN·m"),
    (np.ones((0, 6)), "no samples")])
def test_other_estimates_are_refused(cases, samples, complaint):
    with pytest.raises(InputError, match=complaint):
        estimates(lambda capture: samples, cases)


def test_an_estimator_is_named_by_module_and_function(tmp_path, monkeypatch):
    (tmp_path / "mine.py").write_text("value = 3\ndef guess(capture): return [[1e-5] * 6]\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    assert estimator_named("mine:guess")(None) == [[1e-5] * 6]
    for name, complaint in (("mine", "write MODULE:FUNCTION"), ("mine:value", "no function"),
                            ("mine:other", "cannot be imported"), ("theirs:f", "cannot be")):
        with pytest.raises(InputError, match=complaint):
            main([f"estimator={name}", "out=scores.json"])
    assert not Path("scores.json").exists()


def test_the_page_has_the_table_that_the_command_prints():
    content = json.loads((FOLDER / "scores.json").read_text("utf-8"))
    scores = content["scores"]
    assert content["weights_sha256"] == read_header().sha256, "of weights that are not bundled"
    assert tuple(scores) == (*ESTIMATORS, "truth")
    assert table_of(scores) in (FOLDER / "README.md").read_text("utf-8")
    for kind, found in scores[ESTIMATORS[0]].items():
        assert found["log_alpha_rms"] < scores[ESTIMATORS[1]][kind]["log_alpha_rms"]
