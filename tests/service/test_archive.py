"""The zip of all fabrics: whole, in parts, and without leftovers."""

import asyncio
import io
import os
import sqlite3
import zipfile
from collections.abc import Iterator
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
    results: Path, *, pause: float = 0.0, parts_until_gone: int = 99, seconds: float = 60.0
) -> bytes:
    """Fetch the zip as a client that takes a part in ``pause`` seconds and goes after some of them,
    from a service that waits ``seconds`` for it, and whose only place is free afterwards.
    """
    places, received = Places("exports", total=1, each=1), []

    async def run() -> None:
        gone = asyncio.Event()

        async def receive() -> dict:
            await gone.wait()
            return {"type": "http.disconnect"}

        async def send(message: dict) -> None:
            if len(received) == parts_until_gone:
                gone.set()
                await asyncio.Event().wait()
            await asyncio.sleep(pause)
            received.append(message.get("body", b""))

        await Archive(results, places.taken("x"), seconds)({"type": "http"}, receive, send)

    asyncio.run(run())
    places.take("x")
    return b"".join(received)


def test_a_client_that_goes_or_takes_nothing_leaves_nothing(results, whole):
    assert len(fetch(results, parts_until_gone=4)) < LARGE
    assert not fetch(results, pause=60.0, seconds=0.1)


def test_a_slow_client_gets_all(results, whole):
    data = fetch(results, pause=0.05, seconds=1.0)  # some 30 parts
    assert len(zipfile.ZipFile(io.BytesIO(data)).namelist()) == 5


def test_a_database_that_cannot_be_copied_is_a_sentence(results, whole, monkeypatch, caplog):
    def fail(*_: object) -> None:
        raise sqlite3.OperationalError(f"{results}: disk is full")

    monkeypatch.setattr(Database, "copy", fail)
    with pytest.raises(RequestError, match="cannot be copied") as refused:
        fetch(results)
    assert refused.value.status_code == 507 and str(results) not in refused.value.detail
    assert "disk is full" in caplog.text
