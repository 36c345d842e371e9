"""Summary of the cases of the study of Table 3; the cases are tested elsewhere."""

from studies import table3
from studies.table3 import NETWORK, OTHER_DRAPE


def _report():
    """Report of fabrics without and with hysteresis, one drape and one case without convergence."""
    def ways(*drapes):
        return {NETWORK: {"error": [0.3, 0.0, 0.0], "drape": drapes[0], "hung": [1.0, 9.0]},
                OTHER_DRAPE: {"drape": drapes[1], "hung": None}}

    return {"settings": {"hysteresis_per_m": 20.0}, "fabrics": {
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
    assert len(table3.draw(report).axes) == 4
