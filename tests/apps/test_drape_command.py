"""``python -m apps.drape``: files, figures, and one line for a mistake."""

import ast
import json
import os
import platform
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import apps
from apps.drape import main
from common.ctrl_c import deferred, require_interruption
from common.errors import InputError
from common.workers import worker_pool
from sim.mesh.specimen import make_specimen
from sim.rig import Rig


def run(*words: str) -> subprocess.CompletedProcess:
    command = [sys.executable, "-m", "apps.drape", *words]
    return subprocess.run(command, capture_output=True, text=True)


def test_writes_mesh_picture_and_figures(tmp_path):
    done = run("alpha=60,60,60", "edge_mm=12", f"out={tmp_path}")
    assert done.returncode == 0, done.stderr
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "drape.json", "drape.npz", "drape.ply", "drape.png"]
    figures = json.loads((tmp_path / "drape.json").read_text())
    assert figures["status"] == "converged" and figures["positive_definite"]
    assert figures["parameters"]["alpha_uN_m"] == {"warp": 60.0, "bias": 60.0, "weft": 60.0}
    assert 0 < figures["drape_coefficient"] < 1
    assert figures["parameters"]["edge_mm"] == 12 and figures["coarser_meshes"] == []

    import trimesh

    mesh = trimesh.load(tmp_path / "drape.ply", process=False)
    specimen = make_specimen(Rig(), edge=0.012).mesh
    np.testing.assert_array_equal(mesh.faces, specimen.faces)
    assert len(mesh.vertices) == len(specimen.rest)
    assert abs(mesh.vertices[:, 2].max()) < 1e-6 and mesh.vertices[:, 2].min() < -0.05


@pytest.mark.parametrize(
    "words",
    [["alpha=20,20"], ["alpha=20,x,20"], ["alpha=-1,20,20"], ["density=0"], ["density=0.21"],
     ["colour=red"], ["edge_mm=0.2"], ["rig=table"], ["alpha"], ["start=wild"], ["offset=1"]],
    ids=lambda words: words[0],
)
def test_mistakes_end_with_one_line_and_code_2(tmp_path, words):
    done = run(*words, f"out={tmp_path / 'out'}")
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1 and done.stderr.startswith("error: ")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("out", ["/proc/drape", "FILE", "FILE/below", ""])
def test_a_place_that_cannot_be_written_to_is_told_before_the_drape(tmp_path, monkeypatch, out):
    (tmp_path / "file").write_text("mine")
    monkeypatch.setattr("apps.drape.drape", None)
    with pytest.raises(InputError, match="folder"):
        main([f"out={out.replace('FILE', str(tmp_path / 'file'))}"])


def test_figures_of_a_failure_are_json(tmp_path, monkeypatch):
    monkeypatch.setattr("sim.material.ALPHA_RANGE", (0.0, np.inf))
    main(["alpha=1e300,1e300,1e300", "edge_mm=12", f"out={tmp_path}"])

    def refuse(word: str) -> None:
        raise ValueError(word)

    figures = json.loads((tmp_path / "drape.json").read_text(), parse_constant=refuse)
    assert figures["status"] == "not_finite" and figures["residual"] is None


# --- Ctrl-C ---------------------------------------------------------------------------------


def test_ctrl_c_during_the_imports_is_one_line():
    script = "import common.interrupt; raise KeyboardInterrupt"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.stderr == "interrupted\n" and done.returncode == -signal.SIGINT  # 130 in a shell
    done = subprocess.run([sys.executable, "-c", "import common.interrupt; 1 / 0"],
                          capture_output=True, text=True)
    assert "Traceback" in done.stderr and done.returncode == 1


@pytest.fixture
def ctrl_c():
    """Ctrl-C as a program in the foreground has it, and those it starts, wherever tests run."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


COMPILED = """
import common.interrupt
import os, subprocess, time
import numpy as np
from common.ctrl_c import require_interruption
from sim.solver.linear import SparsePattern

stencil = np.random.default_rng(0).integers(0, 20000, (20000, 12))
SparsePattern([stencil], 20000)
met = 0
for _ in range(4):  # from outside: a thread of this process has no turn in a compiled function
    subprocess.Popen(["sh", "-c", f"sleep 0.6; kill -INT {os.getpid()}"])
    try:
        end = time.monotonic() + 20
        while time.monotonic() < end:
            SparsePattern([stencil], 20000)
    except (KeyboardInterrupt, SystemError) as error:
        require_interruption(error)
        met += 1
print(met)
"""


def test_ctrl_c_in_a_compiled_function_is_ctrl_c(ctrl_c):
    done = subprocess.run([sys.executable, "-c", COMPILED], capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("4\n", "")


def test_two_interruptions_at_once_end_a_dataset_like_one(tmp_path, ctrl_c):
    command = [sys.executable, "-m", "data.dataset.generate", f"out={tmp_path / 'set'}",
               "drapes=400", "edge_mm=10", "dataset.drapes_per_shard=4", "workers=2"]
    run = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
                           start_new_session=True)
    time.sleep(4.0)
    os.killpg(run.pid, signal.SIGINT)
    time.sleep(0.001)
    os.killpg(run.pid, signal.SIGINT)
    try:
        _, said = run.communicate(timeout=60)
    finally:
        run.kill()
    assert run.returncode in (130, -signal.SIGINT) and "Traceback" not in said
    assert said.splitlines()[-1] == "interrupted"


def in_a_thread() -> str:
    with deferred():
        return "fine"


def test_ctrl_c_waits_for_the_end_of_what_it_must_not_meet(ctrl_c):
    done = []
    with pytest.raises(KeyboardInterrupt):
        with deferred():
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.1)
            done.append("all of it")
        done.append("more")
    assert done == ["all of it"]
    with pytest.raises(KeyboardInterrupt):
        os.kill(os.getpid(), signal.SIGINT)  # as before
        time.sleep(1)


def test_ctrl_c_that_is_ignored_or_in_another_thread_stays_so(ctrl_c):
    with ThreadPoolExecutor(1) as pool, deferred():
        assert pool.submit(in_a_thread).result() == "fine"
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with deferred():
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.1)


@pytest.mark.parametrize("command", ["train.py", "infer.py", "data/dataset/generate.py",
                                     "apps/drape.py", "apps/cantilever.py"])
def test_commands_see_to_ctrl_c_before_other_imports(command):
    tree = ast.parse((Path(apps.__file__).parents[1] / command).read_text(encoding="utf-8"))
    first = next(node for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom))
    assert ast.unparse(first) == "import common.interrupt"


def test_workers_are_born_deaf_to_ctrl_c_and_the_main_process_is_not():
    def asked_by(pool) -> set:
        return pool.submit(signal.pthread_sigmask, signal.SIG_BLOCK, ()).result()

    before = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    assert signal.SIGINT not in before
    with worker_pool(1) as pool, ThreadPoolExecutor(1) as thread:
        # Processes start as they are needed, perhaps from another thread than the main one.
        assert signal.SIGINT in thread.submit(asked_by, pool).result()
        assert signal.SIGINT not in asked_by(thread)
    assert signal.pthread_sigmask(signal.SIG_BLOCK, ()) == before


@pytest.mark.parametrize("cause", [None, ValueError()])
def test_other_errors_of_python_are_not_ctrl_c(cause):
    with pytest.raises(SystemError, match="bad call"):
        try:
            raise SystemError("bad call") from cause
        except SystemError as error:
            require_interruption(error)


SCRIPT = """
print("imported")
from functools import partial
import numpy as np
from common.workers import worker_pool
from sim.drape import drape
from sim.energies.external import Gravity
from sim.cloth import Laws
from sim.material import Fabric

def heavier(mesh, active, *, fabric):
    return Gravity(mesh, density=fabric.density, gravity=5.0)

fabrics = [Fabric(np.full(3, alpha)) for alpha in (30e-6, 60e-6)]
with worker_pool(2) as pool:
    made = pool.map(partial(drape, edge=0.012, laws=Laws(others=(heavier,))), fabrics)
    print([result.status.value for result in made])
"""


def test_workers_know_what_the_main_script_defines_and_do_not_import_it(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(SCRIPT, encoding="utf-8")
    ran = subprocess.run([sys.executable, script], capture_output=True, text=True,
                         env=os.environ | {"PYTHONPATH": str(Path(apps.__file__).parents[1])})
    assert ran.stdout.splitlines()[-1] == "['converged', 'converged']", ran.stderr
    assert ran.stdout.count("imported") == 1


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="glibc's settings")
def test_commands_keep_the_memory_of_large_arrays():
    def page_faults(prepare: str) -> int:
        script = f"""
import resource
import numpy as np
from common.memory import keep_freed_memory
{prepare}
np.ones(8_000_000)
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(20):
    np.ones(8_000_000)
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""
        environment = {k: v for k, v in os.environ.items() if not k.startswith(("MALLOC", "GLIBC"))}
        return int(subprocess.run([sys.executable, "-c", script], env=environment, check=True,
                                  capture_output=True, text=True).stdout)

    assert page_faults("keep_freed_memory()") < 0.1 * page_faults("")
