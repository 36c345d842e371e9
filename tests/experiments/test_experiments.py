"""The runner and its cases."""

import json
import subprocess
import sys

import numpy as np
import pytest

from common.errors import InputError
from experiments import study
from experiments.__main__ import main, usage
from experiments.report import REPORTS, ROOT, read_report, table
from experiments.study import FILES, FOLDERS, CaseKeys, samples_of

PAGE = ROOT / "docs" / "studies.md"


def test_places_that_cannot_be_written_to_are_refused_before_the_work(tmp_path):
    (tmp_path / "file").touch()
    for words in (["numbers", "out=/proc/report.json"], ["mats", f"out={tmp_path}"],
                  ["mats", f"out={tmp_path}/file/report.json"],
                  ["mats", f"cases={tmp_path}/file"], ["mats", "cases=/proc/runs"]):
        with pytest.raises(InputError, match="cannot write"):
            main(words)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize("name", ["numbers", "mats"])
def test_the_reports_of_the_documentation_stay_unless_they_are_named(tmp_path, monkeypatch, name):
    this = study.study(name)
    report = read_report(name) | {"settings": 1}
    before = [file.read_bytes() for file in (REPORTS / f"{name}.json", PAGE)]
    monkeypatch.setattr(study, "study", lambda name: study.Study(
        this.keys, lambda keys: report, this.block))
    monkeypatch.chdir(tmp_path)
    main([name])
    written = json.loads((tmp_path / f"outputs/experiments/{name}.json").read_text("utf-8"))
    assert written["settings"] == 1
    assert before == [file.read_bytes() for file in (REPORTS / f"{name}.json", PAGE)]


def test_every_study_has_a_folder_keys_and_a_line():
    assert {file.parent.name for file in FILES.values()} == set(FOLDERS)
    lines = usage().splitlines()
    for name in FILES:
        keys = study.study(name).keys
        assert len(keys.text().splitlines()) == len(keys.model_fields) and keys.read([]) == keys()
        (line,) = (line for line in lines if line.split()[:1] == [name])
        assert line.endswith(".") and len(line) <= 120


class Keys(CaseKeys):
    seed: int = 3
    factors: tuple[float, ...] = (2.0,)  # of all
    name: str = ""


def drawn(rng, *, number: int, factors: tuple[float, ...]) -> dict:
    if number == 3:
        raise InputError("the fourth is refused")
    return {"value": float(factors[0] * rng.random())}


def test_samples_have_their_own_random_numbers_and_are_made_once(tmp_path, capsys):
    keys = Keys(cases=str(tmp_path))
    found = samples_of(drawn, keys, 3)
    assert [one["value"] for one in found.values()] == [
        2 * np.random.default_rng([3, k]).random() for k in range(3)]
    assert "3 to go" in capsys.readouterr().out
    assert samples_of(drawn, keys, 3) == found
    assert "to go" not in capsys.readouterr().out
    with pytest.raises(InputError, match="fourth"):
        samples_of(drawn, keys, 4)


def test_words_are_read_as_yaml_and_texts_and_lists_need_no_quotes():
    keys = Keys.read(["factors=1,0150", "name=12", "seed=7"])
    assert (keys.factors, keys.name, keys.seed) == ((1.0, 150.0), "12", 7)
    assert Keys.read(["factors=[3]", "name="]) == Keys(factors=(3.0,))
    assert Keys.text().splitlines()[-2:] == ["factors: (2.0,)  # of all", "name: ''"]


def test_the_command_lists_the_experiments_and_shows_keys(capsys):
    listed = subprocess.run([sys.executable, "-m", "experiments"], cwd=ROOT, capture_output=True,
                            text=True, check=True).stdout
    assert listed.startswith("Run a study.")
    main(["numbers", "--help"])
    shown = capsys.readouterr().out
    assert shown.startswith("Bending by KES of real fabrics") and "\ncheckpoint: ''" in shown


def test_table_is_aligned():
    lines = table(["name", "x"], [["long name", 1.23456], ["b", 7]]).splitlines()
    assert lines[2] == "| long name | 1.23 |"
    assert len({len(line) for line in lines}) == 1
