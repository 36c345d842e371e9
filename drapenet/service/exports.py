"""Tasks of the process for exports, so that the web process computes none."""

import io
import zipfile
from collections.abc import Mapping
from pathlib import Path

from common.workers import end_with_parent


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
