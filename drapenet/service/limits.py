"""Limits of requests: for all clients together, for each client, and for an upload."""

import asyncio
import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from fastapi import Request
from starlette.datastructures import UploadFile
from starlette.exceptions import HTTPException

from drapenet.config import ServeConfig

MAX_FORM = 1 << 20  # bytes of a request beside its files
_MAX_FIELDS = 200  # of a form
_DRAIN_TIMEOUT = 2.0  # s, for which a refused upload is read, so that the client reads the answer


class RequestError(HTTPException):
    """A refused request: HTTP status and a sentence as its detail."""


class Places:
    """Places for ``what``: at most ``total``, and ``each`` for one client."""

    def __init__(self, what: str, *, total: int, each: int):
        self._what, self._total, self._each = what, total, each
        self._taken: Counter[str] = Counter()
        self._lock = threading.Lock()

    def take(self, client: str) -> None:
        """Take a place for a client until :meth:`give`; RequestError if there is none."""
        with self._lock:
            for taken, most, whose in ((self._taken.total(), self._total, ""),
                                       (self._taken[client], self._each, " of your address")):
                if taken >= most:
                    raise RequestError(429, f"{most} {self._what}{whose} are waiting or under way, "
                                       "as many as this service takes; try again in a minute")
            self._taken[client] += 1

    @contextmanager
    def taken(self, client: str) -> Iterator[None]:
        """A place for a client until the end of the block; RequestError if there is none."""
        self.take(client)
        try:
            yield
        finally:
            self.give(client)

    def give(self, client: str) -> None:
        """Give a place of a client back."""
        with self._lock:
            self._taken[client] -= 1
            self._taken += Counter()  # drops clients without a place


async def read_form(
    request: Request, settings: ServeConfig
) -> tuple[list[tuple[str, bytes]], dict[str, str]]:
    """Files and text fields of a multipart request, of limited size and duration."""
    if fault := length_fault(request, settings.bytes + MAX_FORM):
        raise RequestError(*fault)
    if not request.headers.get("content-type", "").startswith("multipart/form-data"):
        raise RequestError(415, "send the files as multipart/form-data, in the field files")
    try:
        form = await asyncio.wait_for(
            request.form(max_files=settings.files, max_fields=_MAX_FIELDS, max_part_size=1 << 16),
            settings.upload_seconds)
    except asyncio.TimeoutError:
        raise RequestError(408, f"the upload took more than {settings.upload_seconds:g} s; send "
                           "less, or over a faster network") from None
    files, texts = [], {}
    try:
        for key, value in form.multi_items():
            if isinstance(value, UploadFile) and key == "files":
                files.append((value.filename or "unnamed", await value.read()))
            elif isinstance(value, UploadFile):
                raise RequestError(422, f"unknown field {key[:60]!r} with a file; give files")
            elif key in texts:
                raise RequestError(422, f"the field {key[:60]!r} is given twice; give it once")
            else:
                texts[key] = value
    finally:
        await form.close()
    return files, texts


def length_fault(request: Request, most: int) -> tuple[int, str] | None:
    """Status and sentence if a body is too long or does not state its length."""
    length = request.headers.get("content-length")
    if length is None or "transfer-encoding" in request.headers:
        return 411, "state the length of the body, Content-Length; none in chunks is taken"
    sizes = f"{int(length) / 1e6:.3g} MB; at most {most / 1e6:.3g} MB"
    return (413, f"the request has {sizes}") if int(length) > most else None


async def drain(request: Request) -> None:
    """Read some of the body of a refused request, so that the client reads the response."""
    async def read() -> None:
        total = 0
        async for part in request.stream():
            if (total := total + len(part)) > MAX_FORM:
                return

    with suppress(Exception):  # the request is refused in any case
        await asyncio.wait_for(read(), _DRAIN_TIMEOUT)
