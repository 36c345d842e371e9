"""Install the Ctrl-C handler. A command imports this module before all others.

The other imports take seconds; an interruption during them, before
:func:`common.cli.run_command` runs, then prints one line instead of a traceback. The exit code is
that of a process ended by Ctrl-C, 130 in a shell.
"""

import signal
import sys
import threading
from types import TracebackType

from common.ctrl_c import interrupt

_previous_hook = sys.excepthook


def _report(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Report an uncaught exception: one line for Ctrl-C, a traceback otherwise."""
    if issubclass(kind, KeyboardInterrupt):
        print("interrupted", file=sys.stderr)
    else:
        _previous_hook(kind, error, trace)


sys.excepthook = _report
if (threading.current_thread() is threading.main_thread()
        and signal.getsignal(signal.SIGINT) is signal.default_int_handler):
    signal.signal(signal.SIGINT, interrupt)
