"""The installed project: importable from anywhere, with its data files."""

import os
import re
import subprocess
import sys
import zipfile
from importlib import import_module
from pathlib import Path

import pytest

from drapenet.network.checkpoint import BUNDLED

ROOT = Path(__file__).resolve().parent.parent


def test_imports_from_outside_the_repository(tmp_path):
    code = (
        "import sim.drape, data.captures.capture, drapenet.network.checkpoint, train, infer, serve;"
        "from common.configs import CONFIG_DIR;"
        "assert (CONFIG_DIR / 'infer.yaml').is_file()"
    )
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_console_scripts_are_functions():
    scripts = re.findall(r'^drapenet-\w+ = "([\w.]+):(\w+)"$',
                         (ROOT / "pyproject.toml").read_text(), re.M)
    assert len(scripts) > 8
    for module, name in scripts:
        assert callable(getattr(import_module(module), name))


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The project's wheel."""
    folder = tmp_path_factory.mktemp("wheel")
    subprocess.run(
        [sys.executable, "-m", "pip", "wheel", "--no-deps", "--quiet", "-w", folder, ROOT],
        check=True,
    )
    (wheel,) = folder.glob("*.whl")
    return wheel


@pytest.mark.slow
@pytest.mark.skipif(not BUNDLED.exists(), reason="no network is bundled")
def test_an_installed_wheel_estimates_from_another_folder(wheel, tmp_path):
    target = tmp_path / "installed"
    subprocess.run([sys.executable, "-m", "pip", "install", "--no-deps", "--quiet", "--target",
                    target, wheel], check=True)
    environment = os.environ | {"PYTHONPATH": str(target)}

    def run(*words: str) -> subprocess.CompletedProcess:
        return subprocess.run([sys.executable, target / "bin" / words[0], *words[1:]],
                              cwd=tmp_path, env=environment, capture_output=True, text=True)

    assert f"file://{target / 'configs'}" in run("drapenet-train", "--info", "searchpath").stdout
    capture = ROOT / "examples" / "captures" / "twill"
    done = run("drapenet-infer", f"capture={capture}", "out=out", "drapes=0", "export=jfab")
    assert done.returncode == 0, done.stderr
    assert {file.name for file in (tmp_path / "out").iterdir()} == {
        "estimate.json", "samples.npz", "observation.npz", "fabric.jfab"}


@pytest.mark.slow
def test_wheel_holds_every_package_config_and_weight(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    tracked = subprocess.run(
        ["git", "ls-files", "sim", "data", "drapenet", "configs", "train.py", "infer.py",
         "serve.py"],
        cwd=ROOT, capture_output=True, text=True, check=True,
    ).stdout.split()
    assert set(tracked) <= names
