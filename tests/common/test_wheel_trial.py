"""What the trial of the wheel takes for a fault."""

import zipfile

import pytest

from tools.wheel_trial import REPORT, TrialError, files_of, require_files, require_whole

ESTIMATE = {"resimulation": {"folds_simulated": 7}, "refined": {"simulations": 25}, "warnings": []}


def test_an_estimate_that_has_all_is_none():
    require_whole(ESTIMATE, REPORT, refined=True)
    require_whole(ESTIMATE | {"refined": None}, (*REPORT, "more"), refined=False)


@pytest.mark.parametrize("part", ["refined", "resimulation", "report.pdf", "drape.glb"])
def test_a_part_left_out_with_a_warning_is_one(part):
    lost = "the network's estimate is not refined: ModuleNotFoundError, drapenet.surface"
    estimate = {key: value for key, value in ESTIMATE.items() if key != part}
    with pytest.raises(TrialError, match=rf"lacks {part}; its warnings: .*ModuleNotFoundError"):
        require_whole(estimate | {"warnings": [lost]}, [name for name in REPORT if name != part],
                      refined=True)


def test_the_wheel_has_all_of_the_tree_and_no_more(tmp_path):
    source, wheel = tmp_path / "source", tmp_path / "some.whl"
    mine = {"serve.py", "sim/rig.py", "drapenet/surface/__init__.py", "drapenet/service/tables.sql",
            "another/module.py"}
    for name in (*mine, "README.md", "tests/test_rig.py", ".ci/run"):
        (source / name).parent.mkdir(parents=True, exist_ok=True)
        (source / name).touch()
    assert files_of(source) == mine

    def pack(names: set[str]) -> None:
        with zipfile.ZipFile(wheel, "w") as target:
            for name in (*names, "drapenet-0.1.0.dist-info/METADATA"):
                target.writestr(name, "")

    pack(mine)
    require_files(wheel, files_of(source))
    for name in mine:
        pack(mine - {name})
        with pytest.raises(TrialError, match=f"lacks \\['{name}'\\] and has \\[\\] in addition"):
            require_files(wheel, files_of(source))
    pack(mine | {"notes.txt"})
    with pytest.raises(TrialError, match=r"lacks \[\] and has \['notes.txt'\]"):
        require_files(wheel, files_of(source))
