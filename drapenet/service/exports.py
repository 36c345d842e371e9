"""Tasks of the process for exports, so that the web process computes none."""

import io
import zipfile
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from common.workers import end_with_parent
from drapenet.service.database import DATABASE, database_in


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


def zipped(files: Mapping[str, bytes]) -> bytes:
    """A zip of files by name."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, data in files.items():
            archive.writestr(zipfile.ZipInfo(name), data, zipfile.ZIP_DEFLATED)
    return stream.getvalue()


def archive(results: Path, out: Path) -> None:
    """Write a zip of all fabrics to ``out``: it can be unpacked as the folder of another service.

    ``fabrics.csv`` has the moduli and readings of each estimate.
    """
    from drapenet.result.document import EstimateDocument, csv_table

    copy, source = out.with_suffix(".sqlite"), database_in(results)
    try:
        source.copy(copy)
        rows = [row for row in (source.estimate(one["id"]) for one in source.estimates()) if row]
        tables = [{"fabric": row["fabric_name"], "capture": row["name"], "folder": row["id"],
                   **EstimateDocument.of(row["estimate"], "").row()}
                  for row in rows if row["estimate"]]
        with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as target:
            target.write(copy, DATABASE)
            target.writestr("fabrics.csv", csv_table(tables))
            for file in sorted(path for row in rows for path in (results / row["id"]).rglob("*")):
                with suppress(FileNotFoundError):  # an upload that is now estimated
                    target.write(file, file.relative_to(results))
    finally:
        copy.unlink(missing_ok=True)
