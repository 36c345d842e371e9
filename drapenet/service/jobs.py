"""Queued, running and finished estimates: bounded queue, worker processes, folder of results."""

import logging
import multiprocessing
import os
import re
import secrets
import shutil
import threading
import time
from concurrent import futures
from contextlib import suppress
from pathlib import Path
from typing import Any

from pebble import ProcessPool

from common.errors import InputError, one_line
from drapenet.config import ServeConfig
from drapenet.service.uploads import RequestError, Upload
from drapenet.service.work import (
    ENDED,
    FAILED,
    LOST,
    QUEUED,
    UPLOADED,
    change_state,
    estimate_upload,
    read_state,
    warm_up,
)

_LOG = logging.getLogger(__name__)
_ID = re.compile(r"[A-Za-z0-9_-]{22}")
_MAX_TASKS = 500  # estimates after which a worker process is replaced


class Jobs:
    """The estimates of a service; those that a previous one did not finish are interrupted."""

    def __init__(self, settings: ServeConfig):
        self.settings = settings
        self._places, self._lock = threading.Semaphore(settings.queue), threading.Lock()
        self._unfinished: set[futures.Future] = set()
        settings.folder.mkdir(parents=True, exist_ok=True)
        for folder, state in self._states():
            if state is None:
                shutil.rmtree(folder, ignore_errors=True)  # an upload that was never complete
            elif state["state"] not in ENDED:
                self._end(folder, LOST, "the service was started again before this estimate was "
                          "finished; upload the capture again")
        self._pool = self._workers()

    def _workers(self) -> ProcessPool:
        pool = ProcessPool(
            max_workers=self.settings.processes, max_tasks=_MAX_TASKS, initializer=warm_up,
            initargs=[self.settings.checkpoint], context=multiprocessing.get_context("spawn"))
        pool.schedule(os.getpid)  # starts them
        return pool

    def close(self) -> None:
        """End all worker processes; the next service marks their estimates as interrupted."""
        self._pool.stop()
        self._pool.join(timeout=5)

    def reserve(self) -> None:
        """Take a place in the queue, until :meth:`release` or the end of the estimate."""
        if not self._places.acquire(blocking=False):
            raise RequestError(429, f"{self.settings.queue} estimates are waiting or under way, as "
                               "many as this service takes; try again in a minute")

    def release(self) -> None:
        """Give a place in the queue back."""
        self._places.release()

    def submit(self, upload: Upload) -> str:
        """Start the estimate of an upload in the reserved place of the queue; its identity."""
        identity = secrets.token_urlsafe(16)
        folder = self.settings.folder / identity
        try:
            (folder / UPLOADED).mkdir(parents=True)
            for name, data in upload.files.items():
                (folder / UPLOADED / name).write_bytes(data)
            change_state(folder, id=identity, name=upload.name, state=QUEUED, stage=None,
                         progress=None, error=None, warnings=[], ended=None)
            self._schedule(folder, {"refine": upload.refine, "scan": upload.scan,
                                    "name": upload.name, "specimen": upload.specimen,
                                    "checkpoint": self.settings.checkpoint})
        except BaseException as error:
            self.release()
            shutil.rmtree(folder, ignore_errors=True)
            if isinstance(error, (OSError, InputError)):
                _LOG.error("an upload cannot be stored: %s", one_line(error))
                raise RequestError(507, "the upload cannot be stored; say so to whoever runs this "
                                   "service, whose log states the reason") from None
            raise
        return identity

    def _schedule(self, folder: Path, options: dict[str, Any]) -> None:
        with self._lock:
            if not self._pool.active:  # a thread of the pool has died: it finishes no estimate
                self.close()
                for waiting in tuple(self._unfinished):
                    waiting.cancel()  # calls _ended
                self._pool = self._workers()
            future = self._pool.schedule(estimate_upload, args=[folder], kwargs=options,
                                         timeout=self.settings.job_seconds)
            self._unfinished.add(future)
            future.add_done_callback(lambda done: self._ended(folder, done))

    def state(self, identity: str) -> tuple[Path, dict[str, Any]]:
        """Folder and state of an estimate."""
        folder = self.settings.folder / identity
        state = read_state(folder) if _ID.fullmatch(identity) else None
        if state is None:
            raise RequestError(404, "no such estimate; it may have been removed for its age")
        return folder, state

    def tidy(self) -> None:
        """Remove results that are too old or too many."""
        ended = sorted((state.get("ended") or 0.0, folder) for folder, state in self._states()
                       if state is not None and state["state"] in ENDED)
        for k, (moment, folder) in enumerate(ended):
            old = time.time() - moment > self.settings.keep_seconds
            if old or len(ended) - k > self.settings.keep:
                shutil.rmtree(folder, ignore_errors=True)

    def _states(self) -> list[tuple[Path, dict[str, Any] | None]]:
        """Folders of estimates with their states."""
        return [(folder, read_state(folder)) for folder in self.settings.folder.iterdir()
                if _ID.fullmatch(folder.name) and folder.is_dir() and not folder.is_symlink()]

    def _ended(self, folder: Path, done: futures.Future) -> None:
        """Release the place and record failures, at the end of a task or at its cancellation."""
        self._unfinished.discard(done)
        self.release()
        error = futures.CancelledError() if done.cancelled() else done.exception()
        if error is None:
            shutil.rmtree(folder / UPLOADED, ignore_errors=True)
        elif isinstance(error, futures.TimeoutError):
            self._end(folder, FAILED, f"not finished in {self.settings.job_seconds:g} s, as long "
                      "as an estimate may take here")
        else:
            # The text of an error may contain paths: it is for the log only.
            _LOG.error("the estimate %s failed", folder.name, exc_info=error)
            self._end(folder, FAILED, "the estimate failed by a fault of the program, which the "
                      "service's log states; please report this capture")

    def _end(self, folder: Path, state: str, sentence: str) -> None:
        with suppress(Exception):  # a full disk must not end the thread that serves all others
            change_state(folder, state=state, error=sentence)
        shutil.rmtree(folder / UPLOADED, ignore_errors=True)
