"""Differences between estimates of drapes on several meshes."""

import json

import numpy as np
import pytest

import experiments.estimation.meshes_of_data
from experiments.estimation.meshes_of_data import KINDS, TOGETHER, run

TESTERS = ["disc300_support180", "square300_cylinder100"]
BIAS = -0.03  # of log alpha per mm of edge


def pretend(*, number, alpha_uN_m, testers, edges_mm, **_):
    """A case whose estimates are biased by the edges, and one drape of which fails."""
    rows = []
    for edge in edges_mm:
        for tester in testers:
            row = {"tester": tester, "edge_mm": edge}
            rows.append(row)
            if number == 1 and edge == 8 and tester == TESTERS[0]:
                continue
            row |= {"coefficient": 0.5 - 0.01 * edge, "folds": 7 + (number == 2 and edge == 8),
                    "length_mm": 10.0}
            read = [np.log(alpha_uN_m) + BIAS * edge, 0.2, 0.3]
            row |= dict.fromkeys(KINDS if tester == TESTERS[0] else (*KINDS, TOGETHER), read)
    return {"alpha_uN_m": alpha_uN_m, "drapes": rows}


@pytest.fixture
def report(tmp_path, monkeypatch):
    monkeypatch.setattr(experiments.estimation.meshes_of_data, "run_case", pretend)
    found = run({"testers": TESTERS, "fabrics": 9, "alphas_uN_m": [2.0, 200.0],
                 "edges_mm": [2.0, 4.0, 8.0], "seed": 0, "checkpoint": "", "workers": 1,
                 "cases": str(tmp_path)}).report
    json.dumps(found, allow_nan=False)
    return found["testers"]


def test_bias_is_that_of_pairs_on_two_meshes(report):
    for tester in TESTERS:
        for edge, pairs in (("4", 9), ("8", 9 if tester == TESTERS[1] else 8)):
            summary = report[tester][edge]["all"]
            apart = float(edge) - 2
            assert summary["pairs"] == pairs
            assert summary["coefficient"] == pytest.approx([-apart, 0.0], abs=1e-9)
            for kind in KINDS:
                assert summary[kind]["log_alpha"][0] == pytest.approx(BIAS * apart)
                assert summary[kind]["bias"][0] == pytest.approx(BIAS * apart / 0.2)
                assert summary[kind]["of_single"][0] == pytest.approx(BIAS * apart / 0.3)
            assert (TOGETHER in summary) == (tester == TESTERS[1])
            assert sum(c["pairs"] for c in report[tester][edge]["by_alpha_uN_m"].values()) == pairs


def test_pairs_with_other_folds_are_left_out_of_fit_and_summary(report):
    found = report[TESTERS[1]]["8"]
    assert found["all"]["same_folds"] == found["same folds"]["pairs"] == found["fit"]["pairs"] == 8
    assert found["fit"]["mean"][0] == pytest.approx(6 * BIAS)
    assert found["fit"]["by_log_alpha"][0] == pytest.approx(0, abs=1e-9)
