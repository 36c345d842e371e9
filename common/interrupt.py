"""Import this before everything else of a command: it sees to what Ctrl-C does.

During the other imports, which take seconds, it is one line, before :func:`common.cli.run_command`
can see to it. The exit code is that of a process ended by Ctrl-C, 130 in a shell.
"""

import signal
import sys
import threading
from types import TracebackType

from common.ctrl_c import interrupt

_others = sys.excepthook


def _tell(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """In place of Python's own report of an error that nothing has caught."""
    if issubclass(kind, KeyboardInterrupt):
        print("interrupted", file=sys.stderr)
    else:
        _others(kind, error, trace)


sys.excepthook = _tell
if (threading.current_thread() is threading.main_thread()
        and signal.getsignal(signal.SIGINT) is signal.default_int_handler):
    signal.signal(signal.SIGINT, interrupt)
