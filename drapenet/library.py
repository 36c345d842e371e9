"""Your fabrics, and published ones, by how alike they are to one of your results.

    python -m drapenet.library like=RESULT [among=FOLDER,...] [count=10] [out=FILE.csv]

The probability is that a fabric and this one cannot be told apart: docs/use.md, Like this one.
"""

import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from common.command import command
from common.errors import InputError
from common.files import replace_file, require_file
from drapenet.alike import KNOWN, Candidate, Likeness, like, read, typical
from drapenet.config import FromOne
from drapenet.result.files import ESTIMATE
from drapenet.result.tables import csv_number, csv_table
from drapenet.service.database import DATABASE, database_in


@dataclass
class LibraryConfig:
    """``configs/library.yaml``. ``among`` is one path or a list of them."""

    like: str
    among: Any
    count: FromOne
    out: str


def fabrics_in(*folders: str | Path, faults: list[str] | None = None) -> list[Candidate]:
    """The fabrics whose results are in folders and below, of a service's folder by its database.
    What cannot be read is left out, and said in ``faults``; InputError if there is no such folder.
    """
    found = []
    for folder in map(Path, folders):
        if not folder.is_dir():
            raise InputError(f"among={folder}: there is no such folder; give one of results")
        for place, name in _results(folder):
            try:
                fabric = read(place)
                found.append(replace(fabric, name=name or fabric.name))
            except InputError as error:
                if faults is not None:
                    faults.append(f"left out: {error}")
    return found


def _results(root: Path) -> Iterator[tuple[Path, str]]:
    """Folders of results, and the names that a service has for their fabrics."""
    for name, folders, files in os.walk(root):
        folders.sort()
        if DATABASE in files:
            yield from ((Path(name) / row["result"], row["name"])
                        for row in database_in(Path(name)).fabrics(()) if row["result"])
        elif ESTIMATE in files:
            yield Path(name), ""
        if {DATABASE, ESTIMATE} & set(files):
            folders.clear()


@command("library", LibraryConfig)
def main(config: LibraryConfig) -> None:
    """Print the list, and write the table."""
    if not config.like:
        raise InputError("like= is missing; give the folder of a result: like=FOLDER")
    if config.out:
        require_file(Path(config.out))
    faults: list[str] = []
    path = Path(config.like)
    this = path.parent if path.is_file() else path
    fabric, stated = read(this), config.among or this.parent
    folders = stated if isinstance(stated, list) else [stated]
    others = [other for other in fabrics_in(*folders, faults=faults)
              if not this.resolve().is_relative_to(Path(other.place).resolve())]
    found = like(fabric, [*others, *typical()])
    print("\n".join(_lines(fabric, found[:config.count])))
    faults += [f"no other results in {stated}; name their folder: among=FOLDER"] * (not others)
    print("\n".join(f"warning: {fault}" for fault in faults), end="\n" * bool(faults))
    if config.out:
        rows = [{key: csv_number(value) if isinstance(value, float) else value
                 for key, value in one.content().items()} for one in found]
        replace_file(Path(config.out), csv_table(rows).encode("utf-8-sig"))
        print(f"table: {config.out}")


def _lines(fabric: Candidate, found: list[Likeness]) -> list[str]:
    """The list for a terminal, with the sources of published fabrics."""
    rows = [("alike", "g/m²", "stiffness in a drape [µN·m]", "differs by", "fabric")]
    for each, verdict, apart in [(fabric, "", ""), *(
            (one.fabric, one.verdict, one.content()["differences"]) for one in found)]:
        values = ", ".join(f"{name} {value:.3g}" for name, value in each.values.items())
        rows.append((verdict, f"{1e3 * each.density:.0f}", values + "; KES B" * bool(each.source),
                     apart, ", ".join(dict.fromkeys(filter(None, (each.name, each.place))))))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
    if any(one.verdict == "not known" for one in found):
        lines.append(f"not known: with these errors equal ones would not reach {KNOWN:.0%}")
    return lines + [f"KES B: {source}, as transcribed" for source in
                    dict.fromkeys(one.fabric.source for one in found) if source]


if __name__ == "__main__":
    main()
