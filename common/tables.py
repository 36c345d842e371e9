"""Reading of tables in text files, as spreadsheets, R and measuring instruments write them.

Cells are separated by semicolons, tabs, commas or spaces, may be in quotes, and numbers may have
decimal commas. A first line ``sep=;`` names the separator. Blank rows and columns are left out.
"""

import csv
import io
import re
from pathlib import Path

from common.documents import read_text, reading

MAX_TABLE_BYTES = 8 << 20
Row = tuple[int, list[str]]
"""Line number, and cells without spaces around them."""
_STATED = re.compile(r'"?sep=(.)"?[ \t]*(?=\r|\n|$)', re.I)
_QUOTED = re.compile(r'(?m)(^|[;,\t ])"(?:[^"]|"")*"')
_SPACED = re.compile(r" *[^\s,;]+(,\d+°?)?( +[-+\u2212]?\d+([.,]\d*)?(e[-+]?\d+)?)+ *", re.I)


def read_rows(file: Path, kind: str, max_bytes: int = MAX_TABLE_BYTES) -> list[Row]:
    """The rows of a table that have some content; ``kind`` names it in errors."""
    text = read_text(file, max_bytes, kind)
    stated = _STATED.match(text)
    text = text[stated.end():] if stated else text  # its line stays, so that lines are counted
    reader = csv.reader(io.StringIO(text, newline=""), skipinitialspace=True, strict=True,
                        delimiter=stated[1] if stated else _separator(text))
    with reading(file, "give a CSV file"):
        rows = [(reader.line_num, [cell.strip() for cell in row]) for row in reader]
    columns = sorted({k for _, row in rows for k, cell in enumerate(row) if cell})
    return [(line, [row[k] for k in columns if k < len(row)]) for line, row in rows if any(row)]


def read_table(
    file: Path, kind: str, max_bytes: int = MAX_TABLE_BYTES
) -> tuple[list[str], list[Row]]:
    """The header of a table, its first row, and the further ones."""
    rows = read_rows(file, kind, max_bytes)
    return (named_columns(rows[0][1], rows[1:]), rows[1:]) if rows else ([], [])


def named_columns(header: list[str], rows: list[Row]) -> list[str]:
    """The names of the columns of ``rows``: R numbers rows in a first column without a name."""
    numbered = all(len(row) == len(header) + 1 and row[0] == str(k)
                   for k, (_, row) in enumerate(rows, start=1))
    return ["", *header] if numbered and rows else header


def number(text: str) -> float:
    """The number in a cell, also with a decimal comma, U+2212 or °; ValueError if there is none."""
    text = text.replace("\u2212", "-").removesuffix("°")
    return float(text if "." in text else text.replace(",", "."))


def _separator(text: str) -> str:
    """What separates cells in most lines, outside of quotes.

    Commas may be decimal beside all others, so they come last.
    """
    lines = [line for line in _QUOTED.sub(r"\1x", text).splitlines() if line.strip()]

    def usual(count: int) -> bool:
        return 2 * count > len(lines)

    spaced = [bool(_SPACED.fullmatch(line)) for line in lines]
    if usual(sum(spaced)) and (spaced[0] or not re.search("[;\t,]", lines[0])):
        return " "
    # A separator stands in the head, too; semicolons of names do not.
    found = [mark for mark in ";\t," if usual(sum(mark in line for line in lines))]
    return next((mark for mark in found if mark in lines[0]), (*found, " ")[0])
