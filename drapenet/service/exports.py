"""Tasks of the process for exports, so that the web process computes none."""

import io
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from common.errors import InputError
from common.findings import Finding
from common.workers import end_with_parent
from drapenet.service.database import DONE, FAILED, LOST, Database, database_in

if TYPE_CHECKING:
    from drapenet.report.overview import FabricEstimate

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
    from drapenet.export.formats import TARGETS
    from drapenet.export.material import read_material

    files = {name: (folder / name).read_bytes() for name in names if (folder / name).is_file()}
    material, refusals = read_material(folder, **settings), []
    for target in TARGETS.values():
        try:
            files |= target.write(material, target.file)
        except InputError as error:
            refusals.append(f"{target.file} ({target.tool}): {error}\n")
    return zipped(files | ({REFUSED: "".join(refusals).encode()} if refusals else {}))


def results_table(results: Path, words: Sequence[str]) -> tuple[str, bytes]:
    """Title and content of a workbook of the fabrics in the folder ``results`` that have all
    ``words`` of a search, the newest first, and of what failed of them.
    """
    from drapenet.report.overview import RESULTS, Joined, fabrics_workbook

    database = database_in(results)
    rows = database.fabrics(words)
    found = [_estimated(database, row) for row in rows if row["result"]]
    return RESULTS, fabrics_workbook(Joined(
        [*filter(None, found)], [], [one for row in rows for one in _failures(database, row)]))


def _failures(database: Database, fabric: Mapping[str, Any]) -> list[dict[str, str]]:
    """Rows of a fabric's captures that failed, and of its joint estimate, without a capture."""
    return [{"fabric": fabric["name"], "sample": "",
             "capture": "" if each["members"] else each["name"], "reason": each["error"] or ""}
            for each in (database.fabric(fabric["id"]) or {"estimates": []})["estimates"]
            if each["state"] in (FAILED, LOST)]


def _estimated(database: Database, fabric: Mapping[str, Any]) -> "FabricEstimate | None":
    """A fabric with its finished captures, and a warning if its result is not of all of them; None
    if its result has been removed meanwhile.
    """
    from drapenet.fabric.entries import Entry
    from drapenet.report.overview import FabricEstimate
    from drapenet.result.document import EstimateDocument

    estimates = (database.fabric(fabric["id"]) or {"estimates": []})["estimates"]
    rows = {row["id"]: row for each in estimates
            if (row := database.estimate(each["id"])) and row["state"] == DONE}
    if not (result := rows.get(fabric["result"])):
        return None
    documents = {identity: EstimateDocument.of(row["estimate"], "")
                 for identity, row in rows.items()}
    captures = [row for row in rows.values() if row["members"] is None]
    document, joined = documents[result["id"]], result["members"] or [result["id"]]
    if apart := [documents[row["id"]].label for row in captures if row["id"] not in joined]:
        document = document.warned(Finding("captures_apart", {"captures": ", ".join(apart)}))
    shown = [(Entry(fabric["name"], "", row["name"], Path(), Path(row["id"])), documents[row["id"]])
             for row in captures]
    return FabricEstimate(
        fabric["name"], Path(fabric["id"]), shown, document, None,
        failed=sum(each["state"] in (FAILED, LOST) for each in estimates if not each["members"]))


def zipped(files: Mapping[str, bytes]) -> bytes:
    """A zip of files by name."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, data in files.items():
            archive.writestr(zipfile.ZipInfo(name), data, zipfile.ZIP_DEFLATED)
    return stream.getvalue()
