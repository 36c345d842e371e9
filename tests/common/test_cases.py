"""Resumable cases: what is computed, kept and raised; digests, and what a result is made with."""

import json
import subprocess
from pathlib import Path

import numpy as np
import pytest

from common import provenance
from common.cases import load_arrays, run_cases
from common.errors import InputError
from common.provenance import digest


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


def git(folder, *words):
    identity = ("-c", "user.name=Test", "-c", "user.email=test@example.org")
    subprocess.run(["git", "-C", str(folder), *identity, *words], check=True, capture_output=True)


@pytest.fixture
def checkout(tmp_path):
    folder = tmp_path / "project"
    folder.mkdir()
    git(folder, "init", "-q")
    (folder / "code.py").write_text("a = 1\n")
    (folder / ".gitignore").write_text("outputs/\n")
    git(folder, "add", ".")
    git(folder, "commit", "-q", "-m", "first")
    return folder


def test_a_checkout_is_known_by_its_commit(checkout):
    state = provenance.code_state(checkout)
    head = (checkout / ".git" / "HEAD").read_text().split()[1]
    assert state == {"release": provenance.release(), "dirty": False,
                     "commit": (checkout / ".git" / head).read_text().strip()}
    (checkout / "outputs").mkdir()
    (checkout / "outputs" / "drape.json").write_text("{}")
    assert not provenance.code_state(checkout)["dirty"]


@pytest.mark.parametrize("name", ["code.py", "new.py"])
def test_changes_and_new_files_make_it_dirty(checkout, name):
    (checkout / name).write_text("a = 2\n")
    assert provenance.code_state(checkout)["dirty"]


def test_no_checkout_no_commit(checkout, tmp_path, monkeypatch):
    installed = checkout / "site-packages"
    installed.mkdir()
    unborn = tmp_path / "unborn"
    unborn.mkdir()
    git(unborn, "init", "-q")
    outside = {"release": provenance.release(), "commit": None, "dirty": False}
    for folder in (installed, tmp_path, unborn, tmp_path / "nowhere"):
        assert provenance.code_state(folder) == outside
    monkeypatch.setenv("PATH", str(tmp_path))  # no git
    assert provenance.code_state(checkout) == outside


def test_digests_are_those_of_contents(tmp_path):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "file").write_text("1")
    assert digest({"path": tmp_path / "a", "x": np.arange(2)}) == digest(
        {"x": [0, 1], "path": tmp_path / "b"})
    (tmp_path / "b" / "file").write_text("2")
    assert digest(tmp_path / "a") != digest(tmp_path / "b")
    with pytest.raises(TypeError, match="object has no digest"):
        digest(object())


def test_versions_of_what_is_installed():
    assert provenance.package_versions("numpy", "no-such-package") == {"numpy": np.__version__}


def test_an_environment_is_fit_for_json_and_stays_the_same():
    first = provenance.environment()
    assert json.loads(json.dumps(first)) == first == provenance.environment()
    assert {"numpy", "scipy", "numba", "h5py"} <= first["packages"].keys()
