"""Captures in a tree of folders or a CSV list, and the folders of their results."""

import itertools
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from common.errors import InputError, one_line, shown
from common.files import by_number, composed, path_named
from common.tables import read_table
from drapenet.measured.read import is_measured

COLUMNS = ("fabric", "sample", "capture")
"""Columns of a list; ``sample`` is optional, ``capture`` a folder relative to that of the list."""
MAX_NAME_LENGTH = 80  # characters, of a folder of results


@dataclass(frozen=True)
class Entry:
    """A capture of a specimen of a fabric, with the names that the user gave.

    Attributes:
        sample: may be empty.
        place: folder of its results, relative to the output folder.
    """

    fabric: str
    sample: str
    capture: str
    path: Path
    place: Path


def entries_of(source: Path) -> list[Entry]:
    """The captures of a tree FABRIC/SAMPLE/CAPTURE or of a CSV list, in a fixed order.

    In a tree, every folder that contains a file and no folders, or the description of a kind of
    measurement, is a source; faults are reported when it is read.
    FABRIC/CAPTURE and CAPTURE alone are trees, too.
    """
    if source.is_dir() and is_measured(os.listdir(source)):
        raise InputError(f"{source} is one capture: give capture={source}, or the folder of the "
                         "fabrics")
    if not source.exists():
        raise InputError(f"captures={source} does not exist; give the folder of the fabrics, or a "
                         "CSV list")
    found = _tree(source) if source.is_dir() else _list(source)
    captures = [((composed(fabric), composed(sample), composed(capture)), path)
                for (fabric, sample, capture), path in found]
    if not captures:
        raise InputError(f"{source} holds no captures: folders FABRIC/SAMPLE/CAPTURE with "
                         "capture.yaml and pictures in them")
    taken: dict[tuple[str, ...], tuple[str, ...]] = {}
    return [Entry(*names, path, _place(names, taken)) for names, path in captures]


def _tree(root: Path) -> Iterator[tuple[tuple[str, str, str], Path]]:
    """Names and folders of the captures in a tree."""
    def stop(error: OSError) -> None:
        raise InputError(f"{root} cannot be read ({one_line(error)}); check the permissions")

    for name, folders, files in os.walk(root, onerror=stop, followlinks=True):
        folder = Path(name)
        # Links to a parent folder would recurse.
        folders[:] = sorted((inner for inner in folders if not inner.startswith(".") and
                             not folder.resolve().is_relative_to((folder / inner).resolve())),
                            key=by_number)
        if is_measured(files):
            folders.clear()
        elif folders or all(file.startswith(".") for file in files):
            continue
        if parts := folder.relative_to(root).parts:
            yield (parts[0], "/".join(parts[1:-1]), parts[-1]), folder


def _list(file: Path) -> Iterator[tuple[tuple[str, str, str], Path]]:
    """Names and folders of the captures in a list."""
    head, rows = read_table(file, "list")
    header = [name.lower() for name in head]
    if missing := {"fabric", "capture"} - set(header):
        raise InputError(f"{file}: no column '{min(missing)}'; its first line must be "
                         f"{','.join(COLUMNS)}")
    for line, row in rows:
        cells = dict(zip(header, row, strict=False))
        fabric, sample, capture = (cells.get(name, "").strip() for name in COLUMNS)
        if not fabric or not capture:
            raise InputError(f"{file}, line {line}: fabric={shown(fabric)} and "
                             f"capture={shown(capture)} must both be given")
        yield (fabric, sample, capture), path_named(file.parent, capture)


def _place(names: tuple[str, str, str], taken: dict[tuple[str, ...], tuple[str, ...]]) -> Path:
    """Unique folder of results of a capture with these names, inside the output folder."""
    place: tuple[str, ...] = ()
    for depth, name in enumerate(names, start=1):
        if not name:
            continue
        # Number names that differ only in characters or case that file systems do not distinguish.
        owner, plain = names[:depth], plain_name(name)
        for number in itertools.count(1):
            folder = (*place, plain if number == 1 else f"{plain}-{number}")
            key = tuple(part.casefold() for part in folder)
            # Folders of captures are never shared, those of fabrics and samples are.
            if key not in taken or (taken[key] == owner and depth < len(names)):
                break
        taken[key], place = owner, folder
    return Path(*place)


def plain_name(name: str) -> str:
    """``name`` as a folder name without characters special to file systems, URLs or shells."""
    plain = re.sub(r"[^\w.-]+", "_", composed(name)).strip("._-")[:MAX_NAME_LENGTH]
    return plain or "unnamed"
