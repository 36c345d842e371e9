import json
import shutil
import subprocess

import pytest

import data.dataset.config
import drapenet.network.dataset
from common import provenance
from common.provenance import ROOT, sources_digest
from tools.check_layers import imports, modules

SOURCES = {"data.dataset.simulate": data.dataset.config.SOURCES,
           "drapenet.network.dataset": drapenet.network.dataset.SOURCES}


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


@pytest.mark.parametrize("entry", SOURCES)
def test_sources_are_all_that_is_imported(entry):
    """Besides ``common``, which computes nothing, and the folder of a dataset."""
    files = modules(ROOT)
    reached, found = [entry], {entry, "data.dataset.folder"}
    while reached:
        new = imports(name := reached.pop(), files[name], set(files)) - found
        reached += [name for name in new if not name.startswith("common.")]
        found |= new
    named = {file for pattern in SOURCES[entry] for file in ROOT.glob(pattern)}
    assert all(any(ROOT.glob(pattern)) for pattern in SOURCES[entry])
    assert {name for name in found if files[name] not in named
            and not name.startswith("common.")} == {"data.dataset.folder"}


def test_sources_are_known_by_name_and_content_wherever_they_are(tmp_path):
    patterns = SOURCES["data.dataset.simulate"]

    def changed(name: str = "", text: str = "") -> str:
        """Digest in a copy of the project with a file of this text."""
        copy = tmp_path / f"copy_{len(list(tmp_path.iterdir()))}"
        for package in ("data", "sim"):
            shutil.copytree(ROOT / package, copy / package)
        if name:
            (copy / name).parent.mkdir(exist_ok=True)
            (copy / name).write_text(text)
        return sources_digest(*patterns, root=copy)

    here = sources_digest(*patterns)
    assert here == changed() == sources_digest(*reversed(patterns))
    assert here == changed("sim/solver/__pycache__/newton.nbi", "cache")
    assert here == changed("data/captures/capture.py", "another reader")
    newton = (ROOT / "sim/solver/newton.py").read_text(encoding="utf-8")
    assert len({here, changed("sim/solver/newton.py", newton + "\n"),
                changed("sim/solver/other.py", newton)}) == 3


def test_versions_of_what_is_installed():
    import numpy

    assert provenance.package_versions("numpy", "no-such-package") == {"numpy": numpy.__version__}


def test_an_environment_is_fit_for_json_and_stays_the_same():
    first = provenance.environment()
    assert json.loads(json.dumps(first)) == first == provenance.environment()
    assert {"numpy", "scipy", "numba", "h5py"} <= first["packages"].keys()
