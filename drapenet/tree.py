"""Which captures a laboratory's tree of folders, or its list, holds, and where results go."""

import itertools
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from common.documents import read_table, shown
from common.errors import InputError, one_line
from data.captures import MARKS

COLUMNS = ("fabric", "sample", "capture")
"""Of a list; ``sample`` may be left out, ``capture`` is a folder, relative to the list's."""
MAX_NAME_LENGTH = 80  # characters, of a folder of results


@dataclass(frozen=True)
class Entry:
    """A capture of a specimen of a fabric.

    Attributes:
        fabric, sample, capture: names as the user has them; ``sample`` may be empty.
        path: of its folder.
        place: of its results, relative to the folder of all.
    """

    fabric: str
    sample: str
    capture: str
    path: Path
    place: Path


def entries_of(source: Path) -> list[Entry]:
    """The captures of a tree FABRIC/SAMPLE/CAPTURE or of a CSV list, in a fixed order.

    Of a tree, every folder without folders in it that holds a file counts, sound or not: what is
    wrong with it shows when it is read. FABRIC/CAPTURE and CAPTURE alone are trees, too.

    Raises:
        InputError: no tree and no list, one that cannot be read, or one without captures.
    """
    if source.is_dir():
        if any((source / mark).exists() for mark in MARKS):
            raise InputError(f"{source} is one capture: give capture={source}, or the folder of "
                             "the fabrics")
        named = list(_of_tree(source))
    elif source.exists():
        named = list(_of_list(source))
    else:
        raise InputError(f"captures={source} does not exist; give the folder of the fabrics, or a "
                         "CSV list")
    if not named:
        raise InputError(f"{source} holds no captures: folders FABRIC/SAMPLE/CAPTURE with "
                         "capture.yaml and view_0.png in them")
    taken: dict[tuple[str, ...], tuple[str, ...]] = {}
    return [Entry(*names, path, _place(names, taken)) for names, path in named]


def _of_tree(root: Path) -> Iterator[tuple[tuple[str, str, str], Path]]:
    try:
        for folder, inside, files in os.walk(root, onerror=_stop, followlinks=True):
            here = Path(folder).resolve()  # a link to a folder above would have no end
            inside[:] = sorted(name for name in inside if not name.startswith(".")
                               and not here.is_relative_to(Path(folder, name).resolve()))
            parts = Path(folder).relative_to(root).parts
            marked = any(mark in files for mark in MARKS)
            if marked:
                inside.clear()
            elif inside or not any(not name.startswith(".") for name in files):
                continue
            if parts:
                yield (parts[0], "/".join(parts[1:-1]), parts[-1]), Path(folder)
    except OSError as error:
        raise InputError(f"{root} cannot be read ({one_line(error)}); check the "
                         "permissions") from None


def _stop(error: OSError) -> None:
    raise error


def _of_list(file: Path) -> Iterator[tuple[tuple[str, str, str], Path]]:
    header, rows = read_table(file, "list")
    if missing := {"fabric", "capture"} - set(header):
        raise InputError(f"{file}: no column '{min(missing)}'; its first line must be "
                         f"{','.join(COLUMNS)}")
    for line, row in rows:
        cells = dict(zip(header, row, strict=False))
        fabric, sample, capture = (cells.get(name, "").strip() for name in COLUMNS)
        if not fabric or not capture:
            raise InputError(f"{file}, line {line}: fabric={shown(fabric)} and "
                             f"capture={shown(capture)} must both be given")
        yield (fabric, sample, capture), file.parent / capture


def _place(names: Sequence[str], taken: dict[tuple[str, ...], tuple[str, ...]]) -> Path:
    """The folder of results of a capture of these names: no other's, and inside the whole's."""
    place: tuple[str, ...] = ()
    for depth, name in enumerate(names, start=1):
        if not name:
            continue
        # Names that are alike but for what a file system cannot hold, or does not distinguish.
        owner, plain = tuple(names[:depth]), plain_name(name)
        for number in itertools.count(1):
            here = (*place, plain if number == 1 else f"{plain}-{number}")
            key = tuple(part.casefold() for part in here)
            # Of the last part every row has its own.
            if key not in taken or (taken[key] == owner and depth < len(names)):
                break
        taken[key], place = owner, here
    return Path(*place)


def plain_name(name: str) -> str:
    """``name`` as a folder's name that no file system, address or shell takes for another thing."""
    plain = re.sub(r"[^\w.-]+", "_", name).strip("._-")[:MAX_NAME_LENGTH]
    return plain or "unnamed"
