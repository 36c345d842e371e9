"""What the trial of the wheel takes for a fault."""

import pytest

from tools.wheel_trial import REPORT, TrialError, require_whole

ESTIMATE = {"resimulation": {"folds_simulated": 7}, "refined": {"simulations": 25}, "warnings": []}


def test_an_estimate_that_has_all_is_none():
    require_whole(ESTIMATE, REPORT, refined=True)
    require_whole(ESTIMATE | {"refined": None}, (*REPORT, "more"), refined=False)


@pytest.mark.parametrize("part", ["refined", "resimulation", "report.pdf", "drape.glb"])
def test_a_part_left_out_with_a_warning_is_one(part):
    lost = {"text": "the network's estimate is not refined: ModuleNotFoundError, drapenet.surface"}
    estimate = {key: value for key, value in ESTIMATE.items() if key != part}
    with pytest.raises(TrialError, match=rf"lacks {part}; its warnings: .*ModuleNotFoundError"):
        require_whole(estimate | {"warnings": [lost]}, [name for name in REPORT if name != part],
                      refined=True)
