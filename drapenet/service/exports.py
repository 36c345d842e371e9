"""Tasks of the process for exports, so that the web process computes none."""

import io
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from common.errors import InputError
from common.findings import Finding
from common.workers import end_with_parent
from drapenet.service.database import DONE, FAILED, LOST, database_in

if TYPE_CHECKING:
    from drapenet.report.overview import FabricEstimate

_COMPARED = 200  # fabrics, the nearest in weight: to read them takes a second
_PUBLISHED = 2
REFUSED = "refused.txt"
"""In the zip of all files of an estimate: the exports that are not in it, and why."""


def prepare() -> None:
    """Import what the first export needs."""
    end_with_parent()
    import drapenet.export.formats  # noqa: F401


def export_file(
    folder: Path, target: str, title: str, settings: Mapping[str, object]
) -> tuple[str, bytes]:
    """Title and content of a target's file, or of a zip of several; ``settings``:
    :class:`drapenet.export.material.ExportSettings`.
    """
    from drapenet.export.formats import TARGETS
    from drapenet.export.material import read_material

    files = TARGETS[target].write(read_material(folder, **settings), title)
    if len(files) == 1:
        return title, files[title]
    return f"{Path(title).stem}.zip", zipped(files)


def all_files(folder: Path, names: Iterable[str], settings: Mapping[str, object]) -> bytes:
    """A zip of those files ``names`` of an estimate that exist, and of its exports to all tools,
    under their usual names; :data:`REFUSED` states the sentence of each tool that refuses.

    InputError if the ``settings`` of :func:`export_file` are no settings of any tool.
    """
    from drapenet.export.formats import TARGETS, files_of
    from drapenet.export.material import read_material

    files = {name: (folder / name).read_bytes() for name in names if (folder / name).is_file()}
    made, refusals = files_of(read_material(folder, **settings), TARGETS)
    return zipped(files | made | ({REFUSED: "\n".join(refusals).encode()} if refusals else {}))


def results_table(results: Path, words: Sequence[str]) -> tuple[str, bytes]:
    """Title and content of a workbook of the fabrics in the folder ``results`` that have all
    ``words`` of a search, the newest first, and of what failed of them.
    """
    from drapenet.report.overview import RESULTS, Joined, fabrics_workbook

    database, found, failures = database_in(results), [], []
    for row in database.fabrics(words):
        estimates = (database.fabric(row["id"]) or {"estimates": []})["estimates"]
        failed = [each for each in estimates if each["state"] in (FAILED, LOST)]
        # A joint estimate that failed is not of a capture.
        failures += [{"fabric": row["name"], "sample": "", "reason": each["error"] or "",
                      "capture": "" if each["members"] else each["name"]} for each in failed]
        done = {each["id"]: content for each in estimates
                if (content := database.estimate(each["id"])) and content["state"] == DONE}
        if row["result"] in done:  # not removed meanwhile
            found.append(_estimated(row, done, sum(not each["members"] for each in failed)))
    return RESULTS, fabrics_workbook(Joined(found, [], failures))


def alike(results: Path, identity: str, count: int) -> list[dict[str, Any]]:
    """The fabrics that are most alike to that of an estimate, then published ones; ``place`` is the
    identity of their result."""
    from drapenet.alike import like, read, typical

    database, others = database_in(results), []
    this: Any = database.estimate(identity)
    weight = this["estimate"]["capture"]["density_g_m2"]
    rows = [row for row in database.fabrics(()) if row["result"] and row["id"] != this["fabric"]]
    rows.sort(key=lambda row: abs(row["estimate"]["capture"]["density_g_m2"] - weight))
    for row in rows[:_COMPARED]:
        with suppress(InputError):  # removed meanwhile
            others.append(replace(read(results / row["result"]), name=row["name"],
                                  place=row["result"]))
    fabric = read(results / identity)
    found = [*like(fabric, others)[:count], *like(fabric, typical())[:_PUBLISHED]]
    return [one.content() for one in found]


def _estimated(
    fabric: Mapping[str, Any], rows: Mapping[str, Mapping[str, Any]], failed: int
) -> "FabricEstimate":
    """A fabric with its finished estimates, the ``rows`` by identity, and a warning if its result
    is not of all its captures."""
    from drapenet.fabric.entries import Entry
    from drapenet.report.overview import FabricEstimate
    from drapenet.result.document import EstimateDocument

    documents = {identity: EstimateDocument.of(row["estimate"], "")
                 for identity, row in rows.items()}
    captures = [row for row in rows.values() if row["members"] is None]
    result = fabric["result"]
    document, joined = documents[result], rows[result]["members"] or [result]
    if apart := [documents[row["id"]].label for row in captures if row["id"] not in joined]:
        document = document.warned(Finding("captures_apart", {"captures": ", ".join(apart)}))
    shown = [(Entry(fabric["name"], "", row["name"], Path(), Path(row["id"])), documents[row["id"]])
             for row in captures]
    return FabricEstimate(fabric["name"], Path(fabric["id"]), shown, document, None, failed)


def zipped(files: Mapping[str, bytes]) -> bytes:
    """A zip of files by name."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, data in files.items():
            archive.writestr(zipfile.ZipInfo(name), data, zipfile.ZIP_DEFLATED)
    return stream.getvalue()
