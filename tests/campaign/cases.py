"""One case in a forked process, its time and memory bounded, and what became of it."""

import json
import os
import resource
import select
import signal
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple, NoReturn

from common.errors import MAX_LENGTH, InputError

ACCEPTED, REFUSED = "accepted", "refused"
UNCLEAR, TRACEBACK, MEMORY, TIME, CRASH = "unclear message", "traceback", "memory", "time", "crash"
FINDINGS = (UNCLEAR, TRACEBACK, MEMORY, TIME, CRASH)
"""Outcomes that should never be."""
CPU_SECONDS = 10
WALL_SECONDS = 120.0  # other programs keep the cores busy
MEGABYTES = 1024  # beyond what the process has when it begins


class Outcome(NamedTuple):
    """One of the kinds above, and the error's message; of a traceback with its place."""

    kind: str
    message: str


def run_case(
    work: Callable[[], object], *, seconds: int = CPU_SECONDS, megabytes: int = MEGABYTES
) -> Outcome:
    """Do ``work`` in a process of its own."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reading)
        _work(work, writing, seconds, megabytes)
    os.close(writing)
    text, in_time = _read(reading, time.monotonic() + WALL_SECONDS)
    if not in_time:
        os.kill(child, signal.SIGKILL)
    status = os.waitpid(child, 0)[1]
    ended = os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0
    if not in_time or ended in (signal.SIGXCPU, signal.SIGKILL):
        return Outcome(TIME, "")
    if ended or not text:
        return Outcome(CRASH, f"signal {ended}, status {status}")
    return Outcome(*json.loads(text))


def _read(descriptor: int, deadline: float) -> tuple[bytes, bool]:
    """All that comes until the other end is closed, and whether that was before ``deadline``."""
    text = b""
    with os.fdopen(descriptor, "rb", buffering=0) as stream:
        while select.select([stream], [], [], max(0.0, deadline - time.monotonic()))[0]:
            if not (piece := stream.read(65536)):
                return text, True
            text += piece
    return text, False


def _work(work: Callable[[], object], writing: int, seconds: int, megabytes: int) -> NoReturn:
    """The child's part; never returns."""
    try:
        quiet = os.open(os.devnull, os.O_RDWR)
        for descriptor in (0, 1, 2):
            os.dup2(quiet, descriptor)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        room = pages * resource.getpagesize() + (megabytes << 20)
        resource.setrlimit(resource.RLIMIT_AS, (room, room))
        signal.signal(signal.SIGXCPU, signal.SIG_DFL)
        os.write(writing, json.dumps(_outcome(work)).encode())
    finally:
        os._exit(0)


def _outcome(work: Callable[[], object]) -> Outcome:
    try:
        work()
        return Outcome(ACCEPTED, "")
    except InputError as error:
        text = str(error)
        clear = text.isprintable() and 10 < len(text) <= MAX_LENGTH + 3
        return Outcome(REFUSED if clear else UNCLEAR, text)
    except MemoryError:
        return Outcome(MEMORY, _place())
    except BaseException:
        return Outcome(TRACEBACK, _place())


def _place() -> str:
    """The last lines of the traceback."""
    return " | ".join(line.strip() for line in traceback.format_exc().splitlines()[-7:])[:600]
