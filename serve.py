"""Serve the estimator: a page for people, and an HTTP interface for programs.

    python serve.py [port=8000] [results=DIR] [workers=N] [queue=N]

Open http://localhost:8000 and drop a capture; ``/docs`` describes the interface. Limits are in
``configs/serve.yaml``. Finished results stay in ``results`` when the service is started again.
"""

import common.interrupt  # noqa: F401

# isort: split
import os
from typing import NoReturn

from common.cli import parse_overrides, run_command
from common.threads import ONE_THREAD
from data.configs import read_config


def main(argv: list[str]) -> None:
    """The command line: words ``key=value`` over ``configs/serve.yaml``."""
    config = parse_overrides(read_config("serve"), argv)
    os.environ.update(ONE_THREAD)  # of the worker processes; this one calculates nothing
    from drapenet.service.app import serve

    serve(config)


def entry() -> NoReturn:
    """Console script."""
    run_command(main, usage=__doc__)


if __name__ == "__main__":
    entry()
