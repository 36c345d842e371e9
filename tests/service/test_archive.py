"""The zip of all fabrics: whole, in parts, and without leftovers."""

import asyncio
import io
import os
import sqlite3
import zipfile
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path

import pytest

from drapenet.service.archive import Archive, archive
from drapenet.service.database import Database
from drapenet.service.limits import Places, RequestError

LARGE = 1 << 20  # bytes, 16 parts


@pytest.fixture
def results(tmp_path) -> Path:
    """A folder of results with two captures, one of which has a large file."""
    database = Database(tmp_path)
    for name in ("a", "b"):
        (tmp_path / name / "uploaded").mkdir(parents=True)
        (tmp_path / name / "uploaded" / "view_0.png").write_text(name)
        database.add_estimate(name, name, "capture 1", about=(f"fabric {name}", ""))
    (tmp_path / "a" / "drape.glb").write_bytes(os.urandom(LARGE))
    (tmp_path / "private").mkdir()
    (tmp_path / "private" / "file").write_text("not of the service")
    return tmp_path


@pytest.fixture
def whole(results) -> Iterator[None]:
    """Requires that what is in the folder, besides SQLite's files, is as before."""
    def found() -> set[Path]:
        return {path for path in results.rglob("*") if not path.name.startswith("fabrics.sqlite-")}

    before = found()
    yield
    assert found() == before


def test_the_zip_comes_in_small_parts_and_has_all(results, whole):
    parts = list(archive(results))
    assert len(parts) > 16 and max(map(len, parts)) < 0.1 * LARGE
    with zipfile.ZipFile(io.BytesIO(b"".join(parts))) as packed:
        assert set(packed.namelist()) == {"fabrics.sqlite", "fabrics.csv", "a/drape.glb",
                                          "a/uploaded/view_0.png", "b/uploaded/view_0.png"}
        assert packed.testzip() is None
        assert packed.read("a/drape.glb") == (results / "a" / "drape.glb").read_bytes()
        packed.extractall(results.parent / "unpacked")
    assert Database(results.parent / "unpacked").estimates() == Database(results).estimates()


def test_what_is_removed_meanwhile_is_left_out(results, whole):
    parts = archive(results)
    first = [next(parts), next(parts)]
    file = results / "b" / "uploaded" / "view_0.png"
    file.unlink()
    packed = zipfile.ZipFile(io.BytesIO(b"".join([*first, *parts])))
    assert "a/drape.glb" in packed.namelist()
    assert "b/uploaded/view_0.png" not in packed.namelist()
    file.touch()


def fetch(
    results: Path, send: Callable[[dict], Awaitable[None]], *, parts_until_gone: int = 99,
    seconds: float = 60.0,
) -> Places:
    """Fetch the zip as a client that calls ``send`` for each part and goes after some of them, from
    a service that waits ``seconds`` for it; the places of the service.
    """
    places = Places("exports", total=1, each=1)

    async def run() -> None:
        gone, count = asyncio.Event(), 0

        async def receive() -> dict:
            await gone.wait()
            return {"type": "http.disconnect"}

        async def taken(message: dict) -> None:
            nonlocal count
            count += 1
            if count > parts_until_gone:
                gone.set()
                await asyncio.Event().wait()
            await send(message)

        await Archive(results, places.taken("x"), seconds)({"type": "http"}, receive, taken)

    asyncio.run(run())
    return places


def test_a_client_that_goes_leaves_nothing(results, whole):
    async def send(message: dict) -> None:
        """Take the part."""

    fetch(results, send, parts_until_gone=4).take("x")  # its place is free


def test_a_client_that_takes_nothing_is_given_up(results, whole):
    async def send(message: dict) -> None:
        await asyncio.Event().wait()

    fetch(results, send, seconds=0.1).take("x")


def test_a_slow_client_gets_all(results, whole):
    data = io.BytesIO()

    async def send(message: dict) -> None:
        await asyncio.sleep(0.05)
        data.write(message.get("body", b""))

    fetch(results, send, seconds=1.0).take("x")  # some 30 parts
    assert len(zipfile.ZipFile(data).namelist()) == 5


def test_a_database_that_cannot_be_copied_is_a_sentence(results, whole, monkeypatch, caplog):
    def fail(*_: object) -> None:
        raise sqlite3.OperationalError(f"{results}: disk is full")

    async def send(message: dict) -> None:
        raise AssertionError("the response has begun")

    monkeypatch.setattr(Database, "copy", fail)
    with pytest.raises(RequestError, match="cannot be copied") as refused:
        fetch(results, send)
    assert refused.value.status_code == 507 and str(results) not in refused.value.detail
    assert "disk is full" in caplog.text
