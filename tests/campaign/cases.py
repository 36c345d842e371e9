"""One case in a forked process, its time and memory bounded, and what became of it."""

import json
import os
import resource
import select
import signal
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

from common.errors import MAX_LENGTH, InputError

ACCEPTED, REFUSED = "accepted", "refused"
UNCLEAR, TRACEBACK, MEMORY, TIME, CRASH = "unclear message", "traceback", "memory", "time", "crash"
FINDINGS = (UNCLEAR, TRACEBACK, MEMORY, TIME, CRASH)
"""Outcomes that should never be."""
CPU_SECONDS = 10
WALL_SECONDS = 120.0  # other programs keep the cores busy
MEGABYTES = 1024  # beyond what the process has when it begins


@dataclass(frozen=True)
class Outcome:
    """What became of a case.

    Attributes:
        kind: one of the names above.
        message: of the error; of a traceback with the place where it was raised.
        seconds: of processor time.
        megabytes: at most, beyond those at the beginning; 0 of a process that was ended.
    """

    kind: str
    message: str
    seconds: float
    megabytes: float


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
    _, status, usage = os.wait4(child, 0)
    ended = os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0
    if not in_time or ended in (signal.SIGXCPU, signal.SIGKILL):
        kind, message, megabytes = TIME, "", 0.0
    elif ended or not text:
        kind, message, megabytes = CRASH, f"signal {ended}, status {status}", 0.0
    else:
        kind, message, megabytes = json.loads(text)
    return Outcome(kind, message, usage.ru_utime + usage.ru_stime, megabytes)


def _status(key: str) -> float:
    """MB, of this process."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith(key))


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
        room = int(_status("VmSize") + megabytes) << 20
        resource.setrlimit(resource.RLIMIT_AS, (room, room))
        signal.signal(signal.SIGXCPU, signal.SIG_DFL)
        before = _status("VmRSS")
        kind, message = _outcome(work)
        text = json.dumps([kind, message, _status("VmHWM") - before])
        os.write(writing, text.encode())
    finally:
        os._exit(0)


def _outcome(work: Callable[[], object]) -> tuple[str, str]:
    try:
        work()
        return ACCEPTED, ""
    except InputError as error:
        text = str(error)
        clear = text.isprintable() and 10 < len(text) <= MAX_LENGTH + 3
        return (REFUSED if clear else UNCLEAR), text
    except MemoryError:
        return MEMORY, _place()
    except BaseException:
        return TRACEBACK, _place()


def _place() -> str:
    """The last lines of the traceback."""
    return " | ".join(line.strip() for line in traceback.format_exc().splitlines()[-7:])[:600]
