"""Real fabrics whose bending by KES is published, each with its source: ``laboratory.csv``."""

import csv
from functools import cache
from pathlib import Path

SOURCES = {
    "petrak": "Petrak et al., Sustainability 2025, 17, 1388",
    "matsudaira": "Matsudaira et al., Journal of Textile Engineering 61(6), 2015, 69-73"}
"""By the column ``source``; the figures are as others transcribed them."""


@cache
def laboratory_rows() -> list[dict[str, str]]:
    """Rows of the table by column, as text; its comments begin with #."""
    text = Path(__file__).with_name("laboratory.csv").read_text(encoding="utf-8")
    return list(csv.DictReader(line for line in text.splitlines() if line[0] != "#"))
