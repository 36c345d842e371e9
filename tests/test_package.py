"""The installed project: importable from anywhere, with its data files."""

import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def test_imports_from_outside_the_repository(tmp_path):
    code = (
        "import sim.draping, data.captures.capture, drapenet.network.checkpoint, train, infer;"
        "import serve;"
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


def test_an_estimate_imports_nothing_heavy(tmp_path):
    code = (f"import sys, infer; infer.main(['capture=examples/captures/twill_photograph', "
            f"'drapes=0', 'out={tmp_path}']); "
            "print(sorted({'torch', 'open3d', 'h5py', 'sklearn', 'pandas', 'matplotlib', 'numba', "
            "'scipy.signal', 'scipy.stats', 'trimesh', 'fastapi'} & set(sys.modules)), "
            "len(sys.modules))")
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    heavy, _, count = done.stdout.splitlines()[-1].rpartition(" ")
    assert heavy == "[]" and int(count) < 1300, done.stdout + done.stderr
