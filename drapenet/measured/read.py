"""Read: which folders are sources, of what kind, and what they say."""

import os
from collections.abc import Container, Mapping
from pathlib import Path
from typing import Any

from common.documents import misnamed, read_yaml
from common.errors import InputError
from common.files import by_number, path_named
from data.captures.description import Description
from data.readings.known import Known
from drapenet.measured import KINDS, VALUES
from drapenet.measured.base import Measured, kind_at, kind_named


def is_measured(names: Container[str]) -> bool:
    """Whether a folder with files of these ``names`` is a source."""
    return any(file in names for file in KINDS)


def kind_in(folder: Path) -> type[Measured]:
    """The kind of a source by its description, which may be misnamed; a capture if there is none,
    whose reader says what is missing."""
    names = os.listdir(folder) if folder.is_dir() else []
    described = [place for file, place in KINDS.items() if file in names]
    misspelt = [place for file, place in KINDS.items() if misnamed(names, file)]
    return kind_at([*described, *misspelt, *KINDS.values()][0])


def read_measured(place: Path, stated: Mapping[str, Any] = {}, kind: str = "") -> Measured:
    """The source in a folder or file; InputError for the first fault.

    Args:
        stated: ``known`` values of the fabric, beside those of the description; of a scan, all that
            a description would state.
        kind: name of its kind, if that is stated; '': by the description in the folder.
    """
    others = {key: value for key, value in stated.items() if key != "known"}
    found = (kind_named(kind) if kind else kind_in(place)).read(place, others)
    return found.with_known(stated["known"]) if stated.get("known") else found


def sources_in(path: Path, kind: str = "") -> list[Path]:
    """Folders of sources, or of those of one ``kind``, in ``path``, sorted: itself, or those in a
    folder of sources or samples.

    Those whose description is misnamed are among them, so that none is left out in silence.
    """
    path = path_named(Path(), str(path))
    files = [file for file, place in KINDS.items() if not kind or place == KINDS[f"{kind}.yaml"]]
    if not path.is_dir() or any((path / file).exists() for file in KINDS):
        return [path]
    for below in ("*", "*/*", "*/*/*"):
        folders = sorted({found.parent for found in path.glob(f"{below}/*") if any(
            found.name == file or misnamed([found.name], file) for file in files)}, key=by_number)
        if folders and below.count("/") == 2:
            raise InputError(f"{path} looks like FABRIC/SAMPLE/CAPTURE ({folders[0]}): give "
                             f"captures={path} for an estimate of each fabric")
        if folders:
            return folders
    return [path]


def known_values(folder: Path) -> dict[str, Any]:
    """What the description of a capture that is refused states of its fabric, as values.yaml
    would; empty if there is nothing that can be read."""
    file = folder / "capture.yaml"
    try:
        described = Description.of(read_yaml(file), file)
    except InputError:
        return {}
    if not (described.known and described.known.values()):
        return {}
    known = described.known.model_dump(include={*Known.model_fields}, exclude_unset=True)
    return {"density_g_m2": described.density_g_m2, "known": known, **described.labels.stated()}


def values_alone(path: Path, stated: Mapping[str, Any]) -> Measured:
    """The source that :func:`known_values` are, called ``path``."""
    kind: Any = kind_at(KINDS[VALUES])
    return kind.of(kind.schema.of(stated, ""), path)
