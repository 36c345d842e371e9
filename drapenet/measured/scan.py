"""Scans of a draped specimen, of which depth views are rendered."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from data.captures.description import Description
from drapenet.measured.captures import Captured
from drapenet.surface.registration import read_scan_capture


class Scan(Captured):
    """The scan of a drape; what is stated of it is a description without camera and tester."""

    @classmethod
    def read(cls, place: Path, stated: Mapping[str, Any]) -> "Scan":
        """Read and register a scan."""
        specimen = Description.of(stated, "")
        capture = replace(read_scan_capture(place, specimen), known=specimen.known,
                          labels=specimen.labels)
        return cls.of(capture)
