"""The zip of all fabrics, made while it is sent: it may be large, and its client slow."""

import asyncio
import logging
import os
from collections.abc import Generator, Iterator
from contextlib import AbstractContextManager, closing, suppress
from itertools import chain
from pathlib import Path
from sqlite3 import Error as SQLError
from tempfile import TemporaryDirectory

from starlette.concurrency import run_in_threadpool
from starlette.responses import Response, StreamingResponse
from starlette.types import Message, Receive, Scope, Send
from zipstream import ZipStream

from common.errors import one_line
from drapenet.service.database import DATABASE, Database, database_in
from drapenet.service.limits import RequestError

COPY = ".fabrics.zip-"  # beginning of the name of a folder with a copy of the database
_LOG = logging.getLogger(__name__)


class Archive(Response):
    """A zip of the folder ``results``, without a limit of size or duration.

    Args:
        place: held until the zip is sent or its client has gone.
        seconds: for which a client may take nothing before it counts as gone.
    """

    def __init__(self, results: Path, place: AbstractContextManager, seconds: float) -> None:
        super().__init__()
        self._parts, self._place, self._seconds = archive(results), place, seconds

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def sent(message: Message) -> None:
            await asyncio.wait_for(send(message), self._seconds)

        with self._place, closing(self._parts):  # its temporary files go with it
            try:  # the first part comes after the copy of the database, which may fail
                first = await run_in_threadpool(next, self._parts)
            except (OSError, SQLError) as error:
                _LOG.error("the database cannot be copied: %s", one_line(error))
                raise RequestError(507, "the database cannot be copied; say so to whoever runs "
                                   "this service, whose log states the reason") from None
            response = StreamingResponse(
                chain([first], self._parts), media_type="application/zip",
                headers={"Content-Disposition": 'attachment; filename="fabrics.zip"',
                         "Cache-Control": "no-store"})
            with suppress(asyncio.TimeoutError):
                await response(scope, receive, sent)


def archive(results: Path) -> Generator[bytes]:
    """Parts of a zip of all fabrics, with the database as it is now: it can be unpacked as the
    folder of another service. OSError or sqlite3.Error, before the first part, if the database
    cannot be copied.

    ``fabrics.csv`` has the moduli and readings of each estimate.
    """
    from drapenet.result.document import EstimateDocument
    from drapenet.result.tables import csv_table, row_of

    stream = ZipStream()  # most files are compressed already
    with TemporaryDirectory(prefix=COPY, dir=results) as name:
        folder = Path(name)
        database_in(results).copy(folder / DATABASE)
        yield from _packed(stream, folder / DATABASE, folder)
        lines = []
        with closing(Database(folder)) as copy:
            for row in filter(None, (copy.estimate(one["id"]) for one in copy.estimates())):
                if row["estimate"]:
                    lines.append({
                        "fabric": row["fabric_name"], "capture": row["name"], "folder": row["id"],
                        **row_of(EstimateDocument.of(row["estimate"], ""))})
                for place, _, files in os.walk(results / row["id"]):
                    for file in sorted(files):
                        yield from _packed(stream, Path(place, file), results)
        stream.add(csv_table(lines) if lines else "", "fabrics.csv")
        yield from stream.finalize()


def _packed(stream: ZipStream, file: Path, root: Path) -> Iterator[bytes]:
    """Add a file by its name in the folder ``root``, part by part, unless it is now removed."""
    with suppress(FileNotFoundError):
        stream.add_path(file, str(file.relative_to(root)))
        yield from stream.file()
