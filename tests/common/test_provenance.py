import json
import subprocess

import pytest

from common import provenance


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


def test_versions_of_what_is_installed():
    import numpy

    assert provenance.package_versions("numpy", "no-such-package") == {"numpy": numpy.__version__}


def test_an_environment_is_fit_for_json_and_stays_the_same():
    first = provenance.environment()
    assert json.loads(json.dumps(first)) == first == provenance.environment()
    assert {"numpy", "scipy", "numba", "h5py"} <= first["packages"].keys()
