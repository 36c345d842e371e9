"""Worker processes: which stay for the next call, and how they end."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from joblib import Parallel, delayed

import common
from common import workers
from common.errors import InputError
from common.threads import ONE_THREAD
from common.workers import worker_pool


@pytest.fixture(autouse=True)
def none_is_kept():
    workers._idle_pools.clear()
    yield
    workers._idle_pools.clear()


def process_of(pool) -> int:
    return pool.submit(os.getpid).result()


def slowly() -> int:
    time.sleep(1.0)
    return os.getpid()


def ended(process: int) -> bool:
    """Whether a process ends within some seconds."""
    for _ in range(100):
        try:
            os.kill(process, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.1)
    return False


def test_processes_stay_for_the_next_call():
    with worker_pool(1) as pool:
        first = process_of(pool)
        for name, value in ONE_THREAD.items():
            assert pool.submit(os.getenv, name).result() == value
    with worker_pool(1) as pool:
        assert process_of(pool) == first
        with worker_pool(1) as other:  # one within the other: each has its own
            assert process_of(other) != first
    with worker_pool(2) as pool:
        found = {future.result() for future in [pool.submit(slowly) for _ in range(6)]}
        assert len(found) == 2 and first not in found
    assert ended(first)


def test_joblib_has_a_pool_of_its_own():
    with worker_pool(2) as pool:
        pool.submit(os.getpid).result()
    assert Parallel(n_jobs=2)(delayed(abs)(-k) for k in range(3)) == [0, 1, 2]
    with worker_pool(2) as pool:
        assert pool.submit(os.getenv, "MKL_CBWR").result() == "AUTO"


def test_nobody_comes_and_they_end(monkeypatch):
    monkeypatch.setattr(workers, "IDLE_SECONDS", 0.5)
    with worker_pool(1) as pool:
        process = process_of(pool)
    assert ended(process)
    with worker_pool(1) as pool:
        assert process_of(pool) != process


@pytest.mark.filterwarnings("error")
def test_what_went_wrong_is_not_kept():
    with pytest.raises(ZeroDivisionError), worker_pool(1) as pool:
        process = process_of(pool)
        for _ in range(100):  # more than Loky sends to its processes in advance
            pool.submit(time.sleep, 1000)
        raise ZeroDivisionError
    assert ended(process)
    with pytest.raises(InputError, match="was killed"), worker_pool(1) as pool:
        os.kill(process_of(pool), signal.SIGKILL)
        pool.submit(time.sleep, 10).result()
    with worker_pool(1) as pool:
        process = process_of(pool)
    os.kill(process, signal.SIGKILL)  # while nobody uses it
    assert ended(process)
    time.sleep(1.0)
    with worker_pool(1) as pool:
        assert process_of(pool) != process


def test_a_copy_of_the_process_starts_its_own():
    def in_the_copy(connection) -> None:
        with worker_pool(1) as pool:
            connection.send(process_of(pool))
            pool.shutdown()

    with worker_pool(1) as pool:
        first = process_of(pool)
    fork = multiprocessing.get_context("fork")
    here, there = fork.Pipe()
    copy = fork.Process(target=in_the_copy, args=(there,))
    copy.start()
    assert here.poll(60) and here.recv() != first
    copy.join(60)
    assert copy.exitcode == 0
    with worker_pool(1) as pool:
        assert process_of(pool) == first


SCRIPT = """
import os, sys, time
from common.workers import worker_pool

def slowly():
    time.sleep(1.0)
    return os.getpid()

with worker_pool(2) as pool:
    print(*{future.result() for future in [pool.submit(slowly) for _ in range(6)]}, flush=True)
    if sys.argv[1] == "busy":
        pool.submit(time.sleep, 1000).result()
time.sleep(1000)
"""


@pytest.mark.parametrize("at_work", ["busy", "idle"])
def test_they_end_with_a_main_process_that_is_killed(at_work):
    environment = os.environ | {"PYTHONPATH": str(Path(common.__file__).parents[1])}
    main = subprocess.Popen([sys.executable, "-c", SCRIPT, at_work], stdout=subprocess.PIPE,
                            stderr=subprocess.DEVNULL, text=True, env=environment)
    processes = [int(word) for word in main.stdout.readline().split()]
    assert len(processes) == 2
    main.kill()
    main.communicate()
    assert all(ended(process) for process in processes)


def large_array(megabytes: int) -> int:
    import numpy as np

    return len(np.ones(megabytes * 2**17))


def test_a_process_that_has_made_large_arrays_stays(recwarn):
    with worker_pool(1) as pool:
        first = process_of(pool)
        for _ in range(3):
            assert pool.submit(large_array, 400).result()
            time.sleep(1.1)  # Loky looks at the memory once a second
        assert process_of(pool) == first
    assert not recwarn.list
