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
from drapenet.service.settings import Settings
from drapenet.service.uploads import RequestError, Upload, write_upload
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
_RESTARTED = ("the service was started again before this estimate was finished; upload the capture "
              "again")


class Jobs:
    """The estimates of one service.

    Estimates that a previous service did not finish are marked as interrupted; its finished ones
    are available.
    """

    def __init__(self, settings: Settings):
        self.settings = settings
        self._places, self._lock = threading.Semaphore(settings.queue), threading.Lock()
        self._unfinished: set[futures.Future] = set()
        settings.folder.mkdir(parents=True, exist_ok=True)
        for folder in self._folders():
            state = read_state(folder)
            if state is None:
                shutil.rmtree(folder, ignore_errors=True)  # an upload that was never complete
            elif state["state"] not in ENDED:
                self._end(folder, LOST, _RESTARTED)
        self._pool = self._workers()

    def _workers(self) -> ProcessPool:
        """Start the worker processes."""
        pool = ProcessPool(
            max_workers=self.settings.processes, max_tasks=_MAX_TASKS, initializer=warm_up,
            context=multiprocessing.get_context("spawn"))
        pool.schedule(os.getpid)  # starts them
        return pool

    def close(self) -> None:
        """End all worker processes; the next service marks their estimates as interrupted."""
        self._pool.stop()
        self._pool.join(timeout=5)

    def reserve(self) -> None:
        """Reserve a place in the queue, to be released by :meth:`release` unless :meth:`submit` is
        called, which releases it; RequestError with the status 429 if none is free.
        """
        if not self._places.acquire(blocking=False):
            raise RequestError(429, f"{self.settings.queue} estimates are waiting or under way, as "
                               "many as this service takes; try again in a minute")

    def release(self) -> None:
        """Release a place in the queue."""
        self._places.release()

    def submit(self, upload: Upload) -> str:
        """Start the estimate of an upload in the reserved place of the queue; its identity."""
        identity = secrets.token_urlsafe(16)
        folder = self.settings.folder / identity
        try:
            write_upload(upload, folder / UPLOADED)
            change_state(folder, id=identity, name=upload.name, state=QUEUED, stage=None,
                         refine=upload.refine, progress=None, error=None, warnings=[],
                         created=time.time(), ended=None)
            density = upload.fields.get("density_g_m2")
            self._schedule(folder, {
                "refine": upload.refine, "scan": upload.scan, "name": upload.name,
                "density": density and 1e-3 * density})
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
            for _ in range(2):
                try:
                    future = self._pool.schedule(estimate_upload, args=[folder], kwargs=options,
                                                 timeout=self.settings.job_seconds)
                except RuntimeError:  # a thread of the pool has died
                    self._replace_pool()
                    continue
                self._unfinished.add(future)
                future.add_done_callback(lambda done: self._ended(folder, done))
                return
        raise RequestError(503, "the worker processes cannot be started; the service's log says "
                           "why")

    def _replace_pool(self) -> None:
        """Replace a broken pool, which finishes none of its estimates: they fail."""
        self.close()
        for future in tuple(self._unfinished):
            future.cancel()  # calls _ended
        self._pool = self._workers()

    def found(self, identity: str) -> tuple[Path, dict[str, Any]]:
        """Folder and state of an estimate; RequestError with the status 404 where there is none."""
        folder = self.settings.folder / identity
        state = read_state(folder) if _ID.fullmatch(identity) else None
        if state is None:
            raise RequestError(404, "no such estimate; it may have been removed for its age")
        return folder, state

    def tidy(self) -> None:
        """Remove results that are too old or too many."""
        now, ended = time.time(), []
        for folder in self._folders():
            state = read_state(folder)
            if state is not None and state["state"] in ENDED:
                ended.append((state.get("ended") or 0.0, folder))
        ended.sort(key=lambda item: item[0])
        for k, (moment, folder) in enumerate(ended):
            if now - moment > self.settings.keep_seconds or len(ended) - k > self.settings.keep:
                shutil.rmtree(folder, ignore_errors=True)

    def _folders(self) -> list[Path]:
        return [folder for folder in self.settings.folder.iterdir()
                if _ID.fullmatch(folder.name) and folder.is_dir() and not folder.is_symlink()]

    def _ended(self, folder: Path, done: Any) -> None:
        """Release the place and record failures; called at the end of a task, or at its
        cancellation.
        """
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
            change_state(folder, state=state, stage=None, progress=None, error=sentence,
                         ended=time.time())
        shutil.rmtree(folder / UPLOADED, ignore_errors=True)
