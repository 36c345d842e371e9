"""Shared conduct of the command lines: one-line errors, exit codes."""

import errno
import os
import signal
import sys
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from typing import Any, NoReturn

from common.ctrl_c import end, require_interruption
from common.errors import InputError
from common.memory import keep_freed_memory

FULL_ERROR = "HYDRA_FULL_ERROR"
"""With the value 1 in the environment, a user's mistake has its traceback, as with Hydra."""
LIMITS = {"seed": 2**63 - 1, "workers": 1024, "threads": 1024}
"""The most that keys of these names take: what 64 bits hold, and what no machine is asked for."""


def refuse_repeated(words: Iterable[str]) -> None:
    """InputError for words ``key=value`` that give a key twice."""
    keys = [word.partition("=")[0].lstrip("+") for word in words]
    for key in keys:
        if keys.count(key) > 1:
            raise InputError(f"{key}= is given {keys.count(key)} times; give it once")


def check_counts(config: Mapping[str, Any]) -> None:
    """InputError for numbers beyond :data:`LIMITS`."""
    for key, most in LIMITS.items():
        if isinstance(value := config.get(key), int) and value > most:
            raise InputError(f"{key}={value} must not be above {most}")


def run_command(main: Callable[[list[str]], None], *, usage: str | None = None) -> NoReturn:
    """Run ``main(sys.argv[1:])``; a user's mistake ends with one line and exit code 2.

    With ``usage``, the words -h and --help print that text instead.
    """
    if usage and {"-h", "--help"} & set(sys.argv[1:]):
        print(usage)
        sys.exit(0)
    import common.interrupt  # noqa: F401 (of a command that does not begin with it)

    keep_freed_memory()
    open_output()
    try:
        main(sys.argv[1:])
        sys.stdout.flush()
    except InputError as error:
        if os.environ.get(FULL_ERROR) == "1":
            raise
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    except (KeyboardInterrupt, SystemError) as error:
        require_interruption(error)
        print("interrupted", file=sys.stderr)
        signal.signal(signal.SIGINT, end)
        sys.exit(130)
    except BrokenPipeError:
        # Whoever read the output, such as `head`, has seen enough; Python's own last flush must
        # not complain about it.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            raise
        with suppress(OSError):
            print(f"error: {error.strerror}; make room, or send the output elsewhere",
                  file=sys.stderr)
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(2)
    sys.exit(0)


def open_output() -> None:
    """Let standard output and error be there, whoever closed them, and take every text: names of
    files may be none, and terminals may know ASCII only.
    """
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w"))
        elif hasattr(getattr(sys, name), "reconfigure"):
            getattr(sys, name).reconfigure(errors="backslashreplace")
