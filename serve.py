"""Serve the estimator: a web page and an HTTP interface.

    python serve.py [port=8000] [results=DIR] [workers=N] [queue=N] [checkpoint=FILE]
    DRAPENET_PASSWORD=... python serve.py host=0.0.0.0     for other machines

Open http://localhost:8000 and drop a capture; ``/docs`` describes the interface. Limits are in
``configs/serve.yaml``. Finished results stay in ``results`` when the service is started again.
"""

import common.interrupt  # noqa: F401

# isort: split
import os

from common.command import command
from common.workers import ONE_THREAD
from drapenet.config import ServeConfig


@command("serve", ServeConfig)
def main(settings: ServeConfig) -> None:
    """Serve until interrupted."""
    os.environ.update(ONE_THREAD)  # inherited by the worker processes
    from drapenet.service.app import serve

    serve(settings)


if __name__ == "__main__":
    main()
