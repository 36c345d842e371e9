"""Sheets of xlsx files as tables."""

import re
import zipfile
from pathlib import Path
from typing import IO
from xml.etree import ElementTree


def cells(file: Path | IO[bytes], sheet: int) -> list[dict[str, str | float]]:
    """Rows of a sheet of an xlsx file, numbers as such, by the names in its head."""
    space = "{http://schemas.openxmlformats.org/spreadsheetml/2006/main}"
    with zipfile.ZipFile(file) as archive:
        texts = ["".join(item.itertext()) for item in
                 ElementTree.fromstring(archive.read("xl/sharedStrings.xml"))]
        found = ElementTree.fromstring(archive.read(f"xl/worksheets/sheet{sheet}.xml"))
    assert found.find(f".//{space}f") is None  # a formula
    table = [{re.sub(r"\d", "", cell.get("r")): (
        texts[int(cell[0].text)] if cell.get("t") == "s" else float(cell[0].text))
        for cell in row if len(cell)} for row in found.iter(f"{space}row")]
    return [{table[0][column]: value for column, value in row.items()} for row in table[1:]]
