"""The service's database: fabrics and the estimates of their captures (``tables.sql``).

One SQLite file in the folder of results, which the service and its worker processes write.
"""

import json
import secrets
import sqlite3
import threading
import time
from collections.abc import Iterable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

DATABASE = "fabrics.sqlite"
QUEUED, RUNNING, DONE, FAILED, LOST = "queued", "running", "done", "failed", "interrupted"
ENDED = (DONE, FAILED, LOST)
_JSON = ("progress", "warnings", "contradictions", "estimate", "curves", "members", "task")
_WAIT = 60.0  # s, for another process's transaction


def new_identity() -> str:
    """An identity that cannot be guessed."""
    return secrets.token_hex(16)


class Database:
    """A connection, for all threads of a process, to the database in a folder. Every change is one
    transaction, on the disk when its method returns.
    """

    def __init__(self, folder: Path):
        self._lock = threading.Lock()
        self._connection = sqlite3.connect(folder / DATABASE, timeout=_WAIT, isolation_level=None,
                                           check_same_thread=False)
        self._connection.row_factory = sqlite3.Row
        self._connection.create_function("folded", 1, str.casefold, deterministic=True)
        self._connection.executescript(Path(__file__).with_name("tables.sql").read_text("utf-8"))

    def copy(self, file: Path) -> None:
        """Write the present content to a new file."""
        self._read("VACUUM INTO ?", str(file))

    def close(self) -> None:
        """Close the connection."""
        self._connection.close()

    def _read(self, query: str, *values: object) -> list[dict[str, Any]]:
        with self._lock:
            rows = self._connection.execute(query, values).fetchall()
        return [{key: json.loads(row[key]) if key in _JSON and row[key] else row[key]
                 for key in row.keys()} for row in rows]

    def _write(self, *statements: tuple[str, Sequence[object]]) -> None:
        with self._lock, self._connection:
            self._connection.execute("BEGIN IMMEDIATE")
            for query, values in statements:
                self._connection.execute(query, values)

    def fabric(self, identity: str) -> dict[str, Any] | None:
        """A fabric with its ``estimates``, the oldest first; of their content the contradictions,
        and the tester, which is empty if no drape was seen.
        """
        rows = self._read("SELECT * FROM fabric WHERE id = ?", identity)
        return rows[0] | {"estimates": self._read(
            "SELECT id, name, state, error, members, created, ended, "
            "json_extract(estimate, '$.contradictions') AS contradictions, "
            "json_extract(estimate, '$.capture.rig') AS rig, "
            "json_extract(task, '$.directions') AS directions, "
            "json_extract(task, '$.density_g_m2') AS density_g_m2 FROM estimate "
            "WHERE fabric = ? ORDER BY created, rowid", identity)} if rows else None

    def fabrics(
        self, words: Iterable[str], first: int = 0, count: int = -1
    ) -> list[dict[str, Any]]:
        """Fabrics, the newest first, that have all ``words`` in their name, notes, testers or names
        of captures; with a summary of their result, and ``apart``, why their captures are not
        joined. A negative ``count`` is all.
        """
        words = [word.casefold() for word in words]
        where = " AND ".join(["instr(folded(words), ?)"] * len(words) or ["1"])
        return self._read(
            "SELECT id, name, notes, created, captures, result, estimate, apart FROM overview "
            f"WHERE {where} ORDER BY created DESC LIMIT ? OFFSET ?", *words, count, first)

    def estimate(self, identity: str) -> dict[str, Any] | None:
        """An estimate with its content."""
        rows = self._read(
            "SELECT e.*, f.name AS fabric_name, f.notes FROM estimate e JOIN fabric f "
            "ON f.id = e.fabric WHERE e.id = ?", identity)
        return rows[0] if rows else None

    def estimates(self) -> list[dict[str, Any]]:
        """All estimates with their states, the oldest first."""
        return self._read("SELECT id, state, tries, members, error FROM estimate ORDER BY created")

    def same_pictures(self, identity: str) -> list[dict[str, Any]]:
        """``id``, ``name`` and ``fabric_name`` of other fabrics' captures with a picture of an
        estimate, the oldest first."""
        return self._read(
            "WITH digest AS (SELECT e.id, e.fabric, value FROM estimate e, json_each(json_insert("
            "coalesce(json_extract(e.estimate, '$.capture.files_sha256'), '[]'), '$[#]', "
            "json_extract(e.estimate, '$.capture.views_sha256'))) WHERE e.members IS NULL) "
            "SELECT DISTINCT e.id, e.name, f.name AS fabric_name FROM digest own JOIN digest other "
            "USING (value) JOIN estimate e ON e.id = other.id JOIN fabric f ON f.id = e.fabric "
            "WHERE own.id = ? AND other.fabric <> own.fabric ORDER BY e.created", identity)

    def garment(self, identity: str) -> dict[str, Any] | None:
        """State, progress and error of the garment of an estimate, if it was asked for."""
        rows = self._read("SELECT state, progress, error FROM garment WHERE id = ?", identity)
        return rows[0] if rows else None

    def add_garment(self, identity: str) -> None:
        """Add or replace the garment of an estimate."""
        self._write(("REPLACE INTO garment (id, state) VALUES (?, ?)", (identity, QUEUED)))

    def lose_garments(self, sentence: str) -> None:
        """End the garments that a previous service did not finish."""
        self._write(("UPDATE garment SET state = ?, error = ? WHERE state IN (?, ?)",
                     (LOST, sentence, QUEUED, RUNNING)))

    def settled(self) -> list[dict[str, Any]]:
        """``id`` and time of the ``latest`` event of fabrics without unfinished estimates."""
        return self._read("SELECT * FROM settled ORDER BY latest")

    def add_estimate(
        self, identity: str, fabric: str, name: str, *, about: tuple[str, str] | None = None,
        **values: object,
    ) -> None:
        """Add or replace an estimate, and first its fabric if ``about`` has its name and notes."""
        row = {"id": identity, "fabric": fabric, "name": name, "state": QUEUED,
               "created": time.time()} | values
        new = [("INSERT INTO fabric VALUES (?, ?, ?, ?)", (fabric, *about, row["created"]))
               ] if about else []
        self._write(*new, (f"REPLACE INTO estimate ({', '.join(row)}) VALUES "
                           f"({', '.join('?' * len(row))})", _stored(row)))

    def change(self, table: str, identity: str, **values: object) -> None:
        """Change columns; an estimate has no stage after its end."""
        if table == "estimate" and values.get("state") in ENDED:
            values = {"stage": None, "ended": time.time()} | values
        self._write((f"UPDATE {table} SET {', '.join(f'{key} = ?' for key in values)} "
                     "WHERE id = ?", (*_stored(values), identity)))

    def remove(self, table: str, identity: str) -> None:
        """Remove an estimate, or a fabric and its estimates."""
        self._write((f"DELETE FROM {table} WHERE id = ?", (identity,)))


def _stored(values: dict[str, object]) -> list[object]:
    return [json.dumps(value) if key in _JSON and value is not None else value
            for key, value in values.items()]


database_in = lru_cache(maxsize=2)(Database)
"""A process's connection."""
