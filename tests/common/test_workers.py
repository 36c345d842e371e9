"""Worker processes, and Ctrl-C: how they end."""

import ast
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import common
from common.errors import InputError
from common.workers import ONE_THREAD, worker_pool

ROOT = Path(common.__file__).parents[1]


def ended(process: int) -> bool:
    """Whether a process ends within some seconds."""
    for _ in range(100):
        try:
            os.kill(process, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.1)
    return False


@pytest.mark.filterwarnings("error")
def test_workers_have_one_thread_ignore_ctrl_c_and_end_with_a_failing_block():
    before, environment = signal.pthread_sigmask(signal.SIG_BLOCK, ()), dict(os.environ)
    with pytest.raises(ZeroDivisionError), worker_pool(1) as pool:
        process = pool.submit(os.getpid).result()
        assert [pool.submit(os.getenv, name).result() for name in ONE_THREAD] == [
            *ONE_THREAD.values()]
        assert signal.SIGINT in pool.submit(signal.pthread_sigmask, signal.SIG_BLOCK, ()).result()
        for _ in range(100):
            pool.submit(time.sleep, 1000)
        raise ZeroDivisionError
    assert ended(process)
    assert signal.pthread_sigmask(signal.SIG_BLOCK, ()) == before
    assert os.environ == environment


def test_a_failing_block_leaves_the_workers_of_other_pools_alone():
    with worker_pool(1) as other:
        process = other.submit(os.getpid).result()
        with pytest.raises(ZeroDivisionError), worker_pool(1) as pool:
            pool.submit(os.getpid).result()
            raise ZeroDivisionError
        assert other.submit(os.getpid).result() == process


def test_a_script_without_a_main_guard_is_told_so_once(tmp_path):
    script = tmp_path / "script.py"
    script.write_text("from sim import Fabric, drape_many\n"
                      "plan = {'fabric': Fabric([6e-5] * 3), 'edge': 0.02}\n"
                      "print(len(drape_many([plan] * 2, workers=2)))\n")
    environment = os.environ | {"PYTHONPATH": str(ROOT)}

    def run() -> subprocess.CompletedProcess:
        return subprocess.run([sys.executable, script], capture_output=True, text=True,
                              env=environment, cwd=tmp_path)

    done = run()
    assert done.returncode and not done.stdout
    assert done.stderr.count("Traceback") == 1
    assert 'below a line  if __name__ == "__main__":' in done.stderr.splitlines()[-1]
    first, *others = script.read_text().splitlines()
    script.write_text("\n".join([first, 'if __name__ == "__main__":',
                                 *(f"    {line}" for line in others)]))
    assert run().stdout == "2\n"


@pytest.mark.parametrize(("how", "laws", "complaint"), [
    ("-", "None", "the script is <stdin>"),
    ("-c", "Mine()", "defined in a cell or a command"),
    ("-c", "lambda **_: None", "cannot be sent to worker processes")])
def test_what_a_worker_cannot_load_is_named(tmp_path, how, laws, complaint):
    code = f"""
from sim import Fabric, drape_many
from sim.cloth import Laws
class Mine(Laws): pass
drape_many([{{'fabric': Fabric([6e-5] * 3), 'edge': 0.02, 'laws': {laws}}}] * 2, workers=2)
"""
    done = subprocess.run([sys.executable, how, *[code] * (how == "-c")], input=code,
                          capture_output=True, text=True, cwd=tmp_path,
                          env=os.environ | {"PYTHONPATH": str(ROOT)})
    assert complaint in done.stderr.splitlines()[-1]


def test_a_killed_worker_is_an_input_error():
    with pytest.raises(InputError, match="was killed"), worker_pool(1) as pool:
        os.kill(pool.submit(os.getpid).result(), signal.SIGKILL)
        pool.submit(time.sleep, 10).result()
    with worker_pool(1) as pool:
        process = pool.submit(os.getpid).result()
    assert ended(process)


SCRIPT = """
import common.interrupt
import os, sys, time
from pathlib import Path
from common.files import replacing
from common.workers import worker_pool

def slowly():
    time.sleep(0.5)
    return os.getpid()

if __name__ == "__main__":
    with worker_pool(2) as pool, replacing(Path(sys.argv[1])) as file:
        print(*{future.result() for future in [pool.submit(slowly) for _ in range(6)]}, flush=True)
        pool.submit(time.sleep, 1000).result()
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_workers_end_with_the_main_process(tmp_path, number):
    """The signal of Ctrl-C is sent to all processes, and twice, as certain shells do."""
    (tmp_path / "script.py").write_text(SCRIPT)
    (tmp_path / "out").mkdir()
    main = subprocess.Popen([sys.executable, tmp_path / "script.py", tmp_path / "out" / "file"],
                            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                            env=os.environ | {"PYTHONPATH": str(ROOT)}, start_new_session=True,
                            preexec_fn=lambda: signal.signal(signal.SIGINT,
                                                             signal.default_int_handler))
    processes = [int(word) for word in main.stdout.readline().split()]
    assert len(processes) == 2
    if number == signal.SIGINT:
        os.killpg(main.pid, number)
        os.killpg(main.pid, number)
    else:
        main.kill()
    _, message = main.communicate(timeout=60)
    assert all(ended(process) for process in processes)
    if number == signal.SIGINT:
        assert main.returncode == 130 and message == "interrupted\n"
        assert not any((tmp_path / "out").iterdir())


COMPILED = """
import common.interrupt
import time
import numpy as np
from sim.solver.linear import SparsePattern

stencil = np.random.default_rng(0).integers(0, 20000, (20000, 12))
SparsePattern([stencil], 20000)
print("ready", flush=True)
while True:
    SparsePattern([stencil], 20000)
"""


def test_ctrl_c_in_a_compiled_function_is_one_line():
    main = subprocess.Popen([sys.executable, "-c", COMPILED], cwd=ROOT, text=True,
                            stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                            preexec_fn=lambda: signal.signal(signal.SIGINT,
                                                             signal.default_int_handler))
    main.stdout.readline()
    main.send_signal(signal.SIGINT)
    _, message = main.communicate(timeout=60)
    assert (main.returncode, message) == (130, "interrupted\n")


@pytest.mark.parametrize("command", ["train.py", "infer.py", "serve.py", "data/dataset/generate.py",
                                     "apps/drape.py"])
def test_commands_see_to_ctrl_c_before_other_imports(command):
    tree = ast.parse((ROOT / command).read_text(encoding="utf-8"))
    first = next(node for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom))
    assert ast.unparse(first) == "import common.interrupt"
