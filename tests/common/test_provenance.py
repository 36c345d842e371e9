import json
import subprocess

import numpy as np
import pytest

from common import provenance
from common.provenance import digest


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
    import numpy

    assert provenance.package_versions("numpy", "no-such-package") == {"numpy": numpy.__version__}


def test_an_environment_is_fit_for_json_and_stays_the_same():
    first = provenance.environment()
    assert json.loads(json.dumps(first)) == first == provenance.environment()
    assert {"numpy", "scipy", "numba", "h5py"} <= first["packages"].keys()
