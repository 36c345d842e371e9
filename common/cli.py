"""Running commands: one-line error messages, exit codes."""

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
"""Environment variable: with the value 1, an InputError has a traceback, as in Hydra."""
MAX_VALUES = {"seed": 2**63 - 1, "workers": 1024, "threads": 1024}
"""Upper limits of keys: 63 bits of a seed, and more processes or threads than machines have."""


def refuse_repeated(words: Iterable[str]) -> None:
    """InputError for arguments ``key=value`` that set a key twice."""
    keys = [word.partition("=")[0].lstrip("+") for word in words]
    for key in keys:
        if keys.count(key) > 1:
            raise InputError(f"{key}= is given {keys.count(key)} times; give it once")


def check_counts(config: Mapping[str, Any]) -> None:
    """InputError for numbers above :data:`MAX_VALUES`."""
    for key, limit in MAX_VALUES.items():
        if isinstance(value := config.get(key), int) and value > limit:
            raise InputError(f"{key}={value} must not be above {limit}")


def run_command(main: Callable[[list[str]], None], *, usage: str | None = None) -> NoReturn:
    """Run ``main(sys.argv[1:])`` and exit; an InputError is printed as one line, exit code 2.

    With ``usage``, the options -h and --help print that text instead.
    """
    if usage and {"-h", "--help"} & set(sys.argv[1:]):
        print(usage)
        sys.exit(0)
    import common.interrupt  # noqa: F401 (for commands that do not import it first)

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
        # The reader, such as `head`, has closed the pipe; Python's final flush must not fail.
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
    """Make standard output and error usable: replace closed streams, and escape characters that
    they cannot encode, such as undecodable file names or non-ASCII text on ASCII terminals.
    """
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w"))
        elif hasattr(getattr(sys, name), "reconfigure"):
            getattr(sys, name).reconfigure(errors="backslashreplace")
