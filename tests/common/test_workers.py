"""Worker processes that stay for the next call, and those that do not."""

import multiprocessing
import os
import signal
import time

import pytest

from common import workers
from common.errors import InputError
from common.workers import pool_for


@pytest.fixture(autouse=True)
def none_is_kept():
    workers._kept.take(1).shutdown()
    yield
    workers._kept.take(1).shutdown()


def process_of(pool) -> int:
    return pool.submit(os.getpid).result()


def alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


def ended(process: int) -> bool:
    """Whether a process ends within some seconds."""
    for _ in range(100):
        if not alive(process):
            return True
        time.sleep(0.1)
    return False


def test_processes_stay_for_the_next_call_of_as_many():
    with pool_for(1, "nothing") as pool:
        first = process_of(pool)
        assert pool.submit(os.getenv, "MKL_CBWR").result() == "AUTO"
    with pool_for(1, 1.0) as pool:
        assert process_of(pool) == first
        with pool_for(1, 1.0) as other:  # one within the other: each has its own
            assert process_of(other) != first
    with pool_for(2, 1.0) as pool:
        assert process_of(pool) != first
    assert ended(first)


def test_nobody_comes_and_they_end(monkeypatch):
    monkeypatch.setattr(workers, "IDLE_SECONDS", 0.2)
    with pool_for(1, 1.0) as pool:
        process = process_of(pool)
        time.sleep(0.5)
        assert alive(process)
    assert ended(process)


def test_what_went_wrong_is_not_kept():
    with pytest.raises(ZeroDivisionError), pool_for(1, 1.0) as pool:
        process = process_of(pool)
        raise ZeroDivisionError
    assert ended(process)
    with pytest.raises(InputError, match="ended from outside"), pool_for(1, 1.0) as pool:
        os.kill(process_of(pool), signal.SIGKILL)
        pool.submit(time.sleep, 10).result()
    with pool_for(1, 1.0) as pool:
        process = process_of(pool)
    os.kill(process, signal.SIGKILL)  # while nobody uses it
    assert ended(process)
    with pool_for(1, 1.0) as pool:
        assert process_of(pool) != process


def test_processes_that_know_the_main_script_do_not_stay(monkeypatch):
    monkeypatch.setattr("common.workers.defined_in_main", lambda *things: things == ("ours",))
    with pool_for(1, "ours") as pool:
        process = process_of(pool)
    assert ended(process)


def test_a_copy_of_the_process_starts_its_own():
    def in_the_copy(connection) -> None:
        with pool_for(1, 1.0) as pool:
            connection.send(process_of(pool))
        workers._kept.take(1).shutdown()

    with pool_for(1, 1.0) as pool:
        first = process_of(pool)
    fork = multiprocessing.get_context("fork")
    here, there = fork.Pipe()
    copy = fork.Process(target=in_the_copy, args=(there,))
    copy.start()
    assert here.poll(60) and here.recv() != first
    copy.join(60)
    assert copy.exitcode == 0
    with pool_for(1, 1.0) as pool:
        assert process_of(pool) == first
