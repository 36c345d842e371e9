import io
import json
import subprocess
import tokenize

import numpy as np
import pytest

from common import provenance
from common.imports import closure, modules
from common.provenance import ROOT, digest, sources_digest


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


PROJECT = {"sim/__init__.py": "", "sim/mesh.py": "SIZE = 1\n", "data/__init__.py": "",
           "data/reader.py": "import sim.drape\n", "sim/drape.py": """
def drape():
    "Drapes."
    from sim import mesh  # late
    return mesh.SIZE
"""}


@pytest.mark.parametrize(("name", "old", "new", "same"), [
    ("sim/drape.py", "Drapes.", "Drapes # cloth.", True),
    ("sim/drape.py", "# late", "#  'later", True),
    ("sim/mesh.py", "SIZE = 1", '"""Of meshes.\n\n  # too\n"""\n\nSIZE = 1  # edge', True),
    ("sim/mesh.py", "SIZE = 1", 'SIZE = 1\n"""Of edges."""\n', True),
    ("data/reader.py", "import", "import sys\nimport", True),
    ("sim/mesh.py", "1", "2", False),
    ("sim/mesh.py", "1", "'1 # one'", False),
    ("sim/drape.py", "mesh.SIZE", "2 * mesh.SIZE", False),
])
def test_code_is_known_by_what_it_does_and_imports(tmp_path, name, old, new, same):
    def digest_of(folder, **changed: str) -> str:
        for file, text in (PROJECT | changed).items():
            (folder / file).parent.mkdir(parents=True, exist_ok=True)
            (folder / file).write_text(text, encoding="utf-8")
        return sources_digest("sim.drape", root=folder)

    changed = digest_of(tmp_path / "b", **{name: PROJECT[name].replace(old, new)})
    assert (changed == digest_of(tmp_path / "a")) == same


def test_packages_and_files_of_settings_are_named_too():
    named = {sources_digest(*names) for names in (
        ["sim"], ["sim.draping"], ["sim.draping", "configs/sensor/*.yaml"])}
    assert len(named) == 3
    with pytest.raises(ValueError, match="sim/drapes"):
        sources_digest("sim/drapes")


def words(code: bytes) -> list[str]:
    """The tokens of code that has an effect."""
    layout = (tokenize.COMMENT, tokenize.NL, tokenize.INDENT, tokenize.DEDENT, tokenize.ENCODING)
    found = [(token.type, token.string) for token in tokenize.tokenize(io.BytesIO(code).readline)
             if token.type not in layout]
    return [text for (before, _), (kind, text), (after, _) in zip(
        [(tokenize.NEWLINE, ""), *found], found, [*found[1:], (0, "")], strict=False)
        if kind != tokenize.NEWLINE and not (kind == tokenize.STRING and before == after == (
            tokenize.NEWLINE))]


@pytest.mark.parametrize("entry", ["data.dataset.batches", "drapenet.network.dataset"])
def test_code_without_comments_is_the_same_code(entry):
    """Of all that makes shards and maps."""
    found = closure([entry], modules(ROOT))
    assert {"sim.energies.midedge", "data.fabrics.nuisances"} < {module.name for module in found}
    for module in found:
        assert words(module.code) == words(module.file.read_bytes()), module.name


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
