"""Resumable cases: what is computed, kept and recorded."""

from pathlib import Path

import numpy as np
import pytest

from common.cases import load_arrays, run_cases
from common.errors import InputError


def square(log: str, value: float, capture: Path | None = None) -> dict:
    """A case's work that leaves a trace of having been done."""
    with Path(log).open("a", encoding="utf-8") as file:
        file.write(f"{value}\n")
    if value < 0:
        raise InputError("negative")
    return {"square": value**2, "arrays": {"row": np.arange(value)}}


@pytest.fixture
def log(tmp_path):
    """File with the values that were computed."""
    (tmp_path / "log").touch()
    return tmp_path / "log"


def values(log: Path) -> list[str]:
    return sorted(log.read_text().split())


def test_only_missing_damaged_and_changed_cases_are_computed(tmp_path, log):
    capture = tmp_path / "capture"
    capture.mkdir()
    (capture / "view.png").write_bytes(b"1")
    settings = {f"set/case{k}": {"log": str(log), "value": k, "capture": capture} for k in (3, 2)}

    def run(version: int = 1) -> dict:
        return run_cases(square, settings, folder=tmp_path / "cases", version=version)

    expected = {"set/case3": {"square": 9}, "set/case2": {"square": 4}}
    assert run() == run() == expected
    assert values(log) == ["2", "3"]
    assert load_arrays(tmp_path / "cases", "set/case3")["row"].tolist() == [0, 1, 2]
    settings["set/case2"]["value"] = 5
    (tmp_path / "cases/set/case3.json").write_text("{torn")
    assert run() == {"set/case3": {"square": 9}, "set/case2": {"square": 25}}
    assert values(log) == ["2", "3", "3", "5"]
    (capture / "view.png").write_bytes(b"2")  # a path stands for its content
    run()
    assert len(values(log)) == 6
    run(version=2)
    assert len(values(log)) == 8


def test_an_error_is_raised_after_the_other_cases_and_its_case_tried_again(tmp_path, log):
    settings = {str(k): {"log": str(log), "value": k} for k in (-1, 2)}
    for _ in range(2):
        with pytest.raises(InputError, match="negative"):
            run_cases(square, settings, folder=tmp_path)
    assert values(log) == ["-1", "-1", "2"]


def test_no_workers_are_refused(tmp_path):
    with pytest.raises(InputError, match="workers=0"):
        run_cases(square, {}, folder=tmp_path, workers=0)
