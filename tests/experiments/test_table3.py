"""Summary of the cases of the study of Table 3; the cases are tested elsewhere."""

from experiments.papers import table3
from experiments.papers.table3 import NETWORK, OTHER_DRAPE


def _report():
    """Report of fabrics, with one drape and one case without convergence."""
    def ways(*drapes):
        return {NETWORK: {"error": [0.3, 0.0, 0.0], "drape": drapes[0], "hung": [1.0, 9.0]},
                OTHER_DRAPE: {"drape": drapes[1], "hung": None}}

    return {"settings": {}, "fabrics": {
        "fabric_00": {"ways": ways([1.0, 10.0], [4.0, 20.0])},
        "fabric_01": {"ways": ways(None, [6.0, 40.0])},
        "fabric_02": {"failed": "it did not converge"}}}


def test_medians_are_over_the_converged_drapes():
    report = _report()
    head, lines = table3.rows(report)
    assert lines == [["network", "2, 0.17", "1.00 (10%)", "1.00 (9%)"],
                     ["another drape of the fabric", "2", "5.00 (30%)", "–"]]
    assert len(head) == 4
    assert "network 1.00 mm (1.00 to 1.00)" in table3.summarise(report)
    assert len(table3.draw(report).axes) == 2
