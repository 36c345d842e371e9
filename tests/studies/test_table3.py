"""Summary of the cases of the study of Table 3; the cases are tested elsewhere."""

import numpy as np
import pytest

from studies import table3
from studies.table3 import (
    METHODS,
    NETWORK,
    OTHER_DRAPE,
    PRIOR,
    REFINED,
    REFINED_FRICTION,
    SCANS,
    TRUE_MODULI,
)

CONFIG = {"scanned": 9, "samples": 2, "workers": 1, "cases": "", "refined": True}


def _report(scans=()):
    """Report of fabrics without and with friction, one drape and one case without convergence."""
    def ways(*drapes):
        return {NETWORK: {"error": [0.3, 0.0, 0.0], "drape": drapes[0], "hung": [1.0, 9.0]},
                OTHER_DRAPE: {"drape": drapes[1], "hung": None}}

    return {"settings": {"friction_un": 100.0}, "scans": dict(scans), "fabrics": {
        "fabric_00": {"group": "without", "ways": ways([1.0, 10.0], [4.0, 20.0])},
        "fabric_01": {"group": "with", "ways": ways([7.0, 70.0], [8.0, 80.0])},
        "fabric_02": {"group": "without", "ways": ways(None, [6.0, 40.0])},
        "fabric_03": {"group": "with", "failed": "it did not converge"}}}


def test_medians_are_over_the_converged_drapes_of_one_group():
    report = _report()
    head, lines = table3.rows(report)
    network, truth = lines
    assert network == ["network", "2, 0.17", "1.00 (10%)", "1.00 (9%)", "1, 0.17", "7.00 (70%)",
                       "1.00 (9%)"]
    assert truth[2:4] == ["5.00 (30%)", "–"] and len(head) == len(network)
    assert "network 1.00 mm (1.00 to 1.00)" in table3.summarise(report)


def test_scans_add_columns_and_panels():
    scan = {at: dict.fromkeys(METHODS) for at in SCANS}
    scan["own"][REFINED] = [2.5, 90.0]
    report = _report({"fabric_1_sample_1": scan})
    head, lines = table3.rows(report)
    refined, = (line for line in lines if line[0] == REFINED)
    assert refined[-2:] == ["–", "2.50 (90%)"] and len(head) == len(refined)
    assert len(table3.draw(report).axes) == 6 and len(table3.draw(_report()).axes) == 4
    assert "1 scans of real fabrics" in table3.summarise(report)


@pytest.mark.parametrize("folder", ["", "nowhere"])
def test_without_scans_their_columns_are_omitted(folder, tmp_path, capsys):
    assert table3._release_at_scans(CONFIG | {"scans": folder and str(tmp_path / folder)}) == {}
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_a_scan_gets_the_moduli_of_another_sample_along_its_own_yarns(tmp_path, monkeypatch):
    for name in ("fabric_1_sample_1_capture_1", "fabric_1_sample_1_capture_2",
                 "fabric_1_sample_3_capture_1", "fabric_1_sample_4_capture_1",
                 "fabric_2_sample_1_capture_1"):
        (tmp_path / f"{name}.npz").touch()
    calls = []

    def run_cases(work, cases, **_):
        calls.append(cases)
        if work is table3.estimate_scan:
            return {name: {method: {"theta": [float(k)] * 6, "friction": 0.0, "warp": 10.0 + k}
                           for method in (NETWORK, REFINED, REFINED_FRICTION)}
                    for k, name in enumerate(cases)}
        return {name: {OTHER_DRAPE: [5.0, 50.0]} | {method: [float(one["theta"][0]), one["warp"]]
                                             for method, one in case["cloths"].items()}
                for name, case in cases.items()}

    monkeypatch.setattr(table3, "run_cases", run_cases)
    found = table3._release_at_scans(CONFIG | {"scans": str(tmp_path)})
    # Two samples of the first fabric; the other has only one.
    assert list(found) == ["fabric_1_sample_1_capture_1", "fabric_1_sample_3_capture_1"]
    first = found["fabric_1_sample_1_capture_1"]
    assert first["other"][REFINED] == [1.0, 10.0] and first["own"][REFINED] == [0.0, 10.0]
    assert first["other"][PRIOR][1] == 10.0 and first["own"][PRIOR] is None
    assert first["other"][OTHER_DRAPE] == [5.0, 50.0] and first["other"][TRUE_MODULI] is None
    assert np.shape(calls[1]["fabric_1_sample_1_capture_1"]["cloths"]["other network"]["theta"]) \
        == (6,)
