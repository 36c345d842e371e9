"""Queued, running and finished estimates: bounded queue, worker processes, folder of results."""

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
            initargs=(os.getpid(),), context=multiprocessing.get_context("spawn"))
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
            future = self._schedule(folder, {
                "refine": upload.refine, "scan": upload.scan, "name": upload.name,
                "density": density and 1e-3 * density})
        except BaseException as error:
            self.release()
            shutil.rmtree(folder, ignore_errors=True)
            if isinstance(error, (OSError, InputError)):
                raise RequestError(507, f"the upload cannot be stored ({one_line(error)}); say so "
                                   "to whoever runs this service") from None
            raise
        future.add_done_callback(lambda done: self._ended(folder, done))
        return identity

    def _schedule(self, folder: Path, options: dict[str, Any]) -> Any:
        for _ in range(2):
            try:
                return self._pool.schedule(estimate_upload, args=[folder], kwargs=options,
                                           timeout=self.settings.job_seconds)
            except RuntimeError:  # all workers have died, perhaps for lack of memory
                with self._lock:
                    self._pool.stop()
                    self._pool = self._workers()
        raise RequestError(503, "the worker processes cannot be started; the service's log says "
                           "why")

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
        """Release the place and record failures; called by pebble at the end of a task."""
        self.release()
        if done.cancelled():
            return
        if (error := done.exception()) is not None:
            if isinstance(error, futures.TimeoutError):
                sentence = (f"not finished in {self.settings.job_seconds:g} s, as long as an "
                            "estimate may take here")
            else:
                sentence = (f"the estimate failed ({type(error).__name__}: {one_line(error)}); "
                            "please report this capture")
            self._end(folder, FAILED, sentence)
        else:
            shutil.rmtree(folder / UPLOADED, ignore_errors=True)

    def _end(self, folder: Path, state: str, sentence: str) -> None:
        with suppress(Exception):  # a full disk must not end the thread that serves all others
            change_state(folder, state=state, stage=None, progress=None, error=sentence,
                         ended=time.time())
        shutil.rmtree(folder / UPLOADED, ignore_errors=True)
