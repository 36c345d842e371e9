"""Estimates and exports of the service: worker processes, and the folders of results."""

import logging
import shutil
import threading
import time
from collections.abc import Iterable, Iterator, Mapping
from concurrent import futures
from contextlib import contextmanager, suppress
from functools import partial
from itertools import count
from pathlib import Path
from sqlite3 import Error as SQLError
from tempfile import TemporaryDirectory
from typing import Any

from common.errors import InputError, one_line
from data.captures.description import NEED_WARP
from drapenet.config import ServeConfig
from drapenet.fabric.estimate import require_one_density
from drapenet.fabric.part import kept_values
from drapenet.service import exports, seen
from drapenet.service.access import public_address
from drapenet.service.archive import COPY
from drapenet.service.database import (
    DONE,
    ENDED,
    FAILED,
    LOST,
    QUEUED,
    RUNNING,
    Database,
    new_identity,
)
from drapenet.service.limits import Places, RequestError
from drapenet.service.pools import Pool, Process
from drapenet.service.uploads import UNMARKED, YARNS, Upload
from drapenet.service.work import UPLOADED, preview, warm_up, work

_LOG = logging.getLogger(__name__)
_MAX_TRIES = 3  # of an estimate that a service was ended during
_MAX_CAPTURES = 16  # of a fabric
JOINT = "all captures"
_FAULT = ("the {} failed by a fault of the program, which the service's log states; please report "
          "this capture")


@contextmanager
def logged(what: str, *values: object) -> Iterator[None]:
    """Log an exception of the block as the failure of ``what``, with ``values`` for its %, and go
    on: whoever runs it serves all others, too."""
    try:
        yield
    except Exception:
        _LOG.exception(what, *values)


class Jobs:
    """The estimates of a service; it goes on with those that a previous one did not finish."""

    def __init__(self, settings: ServeConfig):
        self.settings = settings
        self.places = Places("estimates", total=settings.queue, each=settings.queue_each)
        self._changing = threading.Lock()  # the captures of a fabric
        settings.folder.mkdir(parents=True, exist_ok=True)
        self.database = Database(settings.folder)
        for begun in (COPY, seen.LOOK):  # of a service that was killed
            for left in settings.folder.glob(f"{begun}*"):
                shutil.rmtree(left, ignore_errors=True)
        for row in self.database.estimates():
            if row["state"] not in ENDED and row["tries"] >= _MAX_TRIES:
                self._end("estimate", row["id"], LOST, f"the service ended {_MAX_TRIES} times "
                          "during this estimate; please report this capture")
        for upload in settings.folder.glob(f"*/{UPLOADED}"):
            row = self.database.estimate(upload.parent.name)
            if row is None or row["state"] in ENDED:  # never complete, or no longer needed
                shutil.rmtree(upload if row else upload.parent, ignore_errors=True)
        self._closed = False
        self.workers = Pool(settings.processes, warm_up, settings.checkpoint,
                            seconds=settings.job_seconds)
        self.exports = Process("exports", "exported", exports.prepare, root=settings.folder,
                               seconds=settings.export_seconds)
        self.looks = Process("photographs", "read", seen.prepare, root=settings.folder,
                             seconds=settings.look_seconds)
        for row in self.database.estimates():
            if row["state"] not in ENDED:
                self.database.change("estimate", row["id"], state=QUEUED, stage=None)
                self._schedule(row["id"])
        self.database.lose_garments("the service ended during this preview; start it again")
        for row in self.database.settled():
            self._join(row["id"])

    def close(self) -> None:
        """End all worker processes; the next service goes on with their estimates."""
        self._closed = True
        for pool in (self.workers, self.exports, self.looks):
            pool.end()

    def submit(self, upload: Upload, client: str) -> dict[str, str]:
        """Start the estimate of an upload in the client's place; its ``id`` and its ``fabric``."""
        identity = new_identity()
        folder = self.settings.folder / identity
        fabric = upload.fabric or new_identity()
        about = upload.specimen
        task = {"scan": upload.scan, "directions": upload.directions,
                "density_g_m2": upload.density_g_m2,
                "specimen": about and about.model_dump(exclude_unset=True)}
        try:
            (folder / UPLOADED).mkdir(parents=True)
            for name, data in upload.files.items():
                (folder / UPLOADED / name).write_bytes(data)
            with self._changing:
                self.database.add_estimate(
                    identity, fabric, self._label(upload), task=task,
                    about=None if upload.fabric else (upload.name, upload.about.notes))
            try:
                self._schedule(identity, client)
            except BaseException:  # it must not wait without its files
                with suppress(SQLError):  # of a full disk
                    self.database.remove(*(("estimate", identity) if upload.fabric else
                                           ("fabric", fabric)))
                raise
        except BaseException as error:
            self.places.give(client)
            shutil.rmtree(folder, ignore_errors=True)
            if isinstance(error, (OSError, SQLError)):
                raise _not_stored(error) from None
            raise
        return {"id": identity, "fabric": fabric}

    def look(self, files: Mapping[str, bytes]) -> dict[str, Any]:
        """What is found in the photograph of a capture's ``files``, which are not kept."""
        try:
            with TemporaryDirectory(prefix=seen.LOOK, dir=self.settings.folder) as name:
                for file, data in files.items():
                    Path(name, file).write_bytes(data)
                return self.looks.outcome(seen.photograph_as_read, Path(name))
        except OSError as error:
            raise _not_stored(error) from None

    def _label(self, upload: Upload) -> str:
        """The label of a capture, which no other of its fabric has."""
        rows = self.row("fabric", upload.fabric)["estimates"] if upload.fabric else []
        labels, label = {row["name"] for row in rows}, upload.about.label
        if label in labels:
            raise RequestError(422, f"label={label} is that of another capture of this fabric; "
                               "give another")
        if {YARNS, UNMARKED} <= {upload.directions, *(row["directions"] for row in rows)}:
            raise RequestError(422, f"strips, and values along the yarns, of a fabric {NEED_WARP}")
        sound = [row for row in rows if row["members"] is None
                 and row["state"] not in (FAILED, LOST)]
        try:
            require_one_density([(name, 1e-3 * density) for name, density in (
                (label or "this one", upload.density_g_m2),
                *((row["name"], row["density_g_m2"]) for row in sound)) if density])
        except InputError as error:  # rather than when they are joined
            raise RequestError(422, f"{error}, or remove the wrong capture") from None
        if len(sound) >= _MAX_CAPTURES:
            raise RequestError(422, f"the fabric has {len(sound)} captures, the most that are "
                               "joined; remove one, or send this capture as another fabric")
        return label or next(free for k in count(1) if (free := f"{upload.kind} {k}")
                             not in labels)

    def preview(self, identity: str, client: str) -> None:
        """Start the garment of a finished estimate in the client's place, unless it is under way.
        """
        with self._changing:
            row = self.database.garment(identity)
            if row and row["state"] not in ENDED:
                return
            self.places.take(client)
            try:
                self.database.add_garment(identity)
                self.workers.begun(preview, self.settings.folder / identity,
                                   ended=partial(self._previewed, identity, client))
            except BaseException as error:
                self.places.give(client)
                if isinstance(error, SQLError):
                    raise _not_stored(error) from None
                raise

    def _schedule(self, identity: str, client: str | None = None) -> None:
        """Start an estimate; the place of a client, if any, is given back at the end."""
        self.workers.begun(
            work, self.settings.folder / identity, self.settings.checkpoint,
            f"{public_address(self.settings)}/#{identity}",
            ended=partial(self._ended, identity, client))

    def _join(self, fabric: str) -> None:
        """Start the joint estimate of a fabric if its captures are no longer those of the last; the
        fabric states, as the log does, what hinders it."""
        with logged("the captures of the fabric %s are not joined", fabric):
            try:
                with self._changing:
                    joint, members, busy = self._captures(fabric)
                    if busy or members == (joint["members"] if joint else []):
                        return
                    identity = joint["id"] if joint else new_identity()
                    if not members:
                        self._forget("estimate", identity, [identity])
                        return
                    self.database.add_estimate(identity, fabric, JOINT, members=members)
                self._schedule(identity)
            except Exception:
                self._not_joined(fabric)
                raise

    def _not_joined(self, fabric: str) -> None:
        """Make the joint estimate of a fabric one that has failed, unless it is under way."""
        with self._changing, logged("nor does the fabric %s state it", fabric):
            joint, members, _ = self._captures(fabric)
            if members and (joint is None or joint["state"] != RUNNING):
                self.database.add_estimate(
                    joint["id"] if joint else new_identity(), fabric, JOINT, members=members,
                    state=FAILED, ended=time.time(), error=_FAULT.format("estimate"))

    def _captures(self, fabric: str) -> tuple[dict[str, Any] | None, list[str], bool]:
        """A fabric's joint estimate, if any, the captures to be joined, if there are several that
        say something of it, and whether an estimate is under way."""
        rows = (self.database.fabric(fabric) or {"estimates": []})["estimates"]
        joint = next((row for row in rows if row["members"] is not None), None)
        captures = [row["id"] for row in rows if row["members"] is None]
        done = {row["id"] for row in rows if row["state"] == DONE}.intersection(captures)
        refused = {row["id"]: kept_values(self.settings.folder / row["id"]) for row in rows
                   if row["members"] is None and row["state"] == FAILED}
        several = len(done) > 1 or (done and any(refused.values()))
        members = [each for each in captures if several and (
            each in done or refused.get(each) is not None)]
        return joint, members, any(row["state"] not in ENDED for row in rows)

    def row(self, table: str, identity: str) -> dict[str, Any]:
        """An estimate, or a fabric with its estimates."""
        row = getattr(self.database, table)(identity)
        if row is None:
            raise RequestError(404, f"no such {table}; it may have been removed, or is too old")
        return row

    def remove(self, table: str, identity: str) -> None:
        """Remove a fabric with its estimates, or an estimate: the others are joined again."""
        with self._changing:  # until then no capture is added, and no joint estimate begun
            fabric = identity if table == "fabric" else self.row(table, identity)["fabric"]
            rows = self.row("fabric", fabric)["estimates"]
            removed = [row["id"] for row in rows if identity in (fabric, row["id"])]
            if any(row["state"] not in ENDED and (
                    row["id"] in removed or not set(removed).isdisjoint(row["members"] or ()))
                    for row in rows):
                raise RequestError(409, "an estimate is under way; wait for its end")
            self._forget(table, identity, removed)
        if table == "estimate":
            self._join(fabric)

    def _forget(self, table: str, identity: str, estimates: Iterable[str]) -> None:
        """Remove a fabric or an estimate from the database, and the files of ``estimates``."""
        self.database.remove(table, identity)
        for each in estimates:
            shutil.rmtree(self.settings.folder / each, ignore_errors=True)

    def tidy(self) -> None:
        """Remove fabrics that are too old or too many."""
        settled = self.database.settled()
        for k, row in enumerate(settled):
            old = time.time() - row["latest"] > self.settings.keep_seconds
            if old or len(settled) - k > self.settings.keep:
                with suppress(RequestError):  # a capture has been added, or it was removed
                    self.remove("fabric", row["id"])

    def _ended(self, identity: str, client: str | None, done: futures.Future) -> None:
        """Release the place and record failures, at the end of a task or at its cancellation."""
        if client is not None:
            self.places.give(client)
        if self._closed:
            return
        if failure := self._failure("estimate", identity, done):
            self._end("estimate", identity, FAILED, failure)
        shutil.rmtree(self.settings.folder / identity / UPLOADED, ignore_errors=True)
        with logged("the end of the estimate %s is not known to its fabric", identity):
            if row := self.database.estimate(identity):  # it may have been removed
                self._join(row["fabric"])

    def _previewed(self, identity: str, client: str, done: futures.Future) -> None:
        """The same of a garment."""
        self.places.give(client)
        if not self._closed and (failure := self._failure("garment", identity, done)):
            self._end("garment", identity, FAILED, failure)

    def _failure(self, what: str, identity: str, done: futures.Future) -> str | None:
        """Why a task failed, as clients read it; None if it did not."""
        error = futures.CancelledError() if done.cancelled() else done.exception()
        if error is None:
            return None
        if isinstance(error, futures.TimeoutError):
            return (f"not finished in {self.settings.job_seconds:g} s, as long as an estimate may "
                    "take here")
        # The text of an error may contain paths: it is for the log only.
        _LOG.error("the %s %s failed", what, identity, exc_info=error)
        return _FAULT.format(what)

    def _end(self, table: str, identity: str, state: str, sentence: str) -> None:
        with logged("the end of the %s %s is not stored", table, identity):
            self.database.change(table, identity, state=state, error=sentence)


def _not_stored(error: Exception) -> RequestError:
    _LOG.error("an upload cannot be stored: %s", one_line(error))
    return RequestError(507, "the upload cannot be stored; say so to whoever runs this service, "
                        "whose log states the reason")
