"""Scans in any unit and orientation, as captures."""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from common.errors import InputError
from data.captures.capture import Capture
from data.captures.description import Specimen
from data.captures.scans import RAW, read_placed
from drapenet.refine.registration import read_scan_capture
from drapenet.refine.surface import CapturedShape
from sim.rig import DISC_RIG


def read_scan(path: Path, specimen: Specimen) -> tuple[Capture, CapturedShape]:
    """A scan of a drape on the disc rig as a capture, and its shape on a mesh of the specimen."""
    notes = specimen.questions
    with TemporaryDirectory() as folder:
        placed = path
        if path.suffix.lower() in RAW:
            placed = Path(folder) / f"{path.stem}.ply"
            mesh, measured = read_placed(path, DISC_RIG)
            mesh.export(placed)
            notes += measured
        try:
            capture, shape = read_scan_capture(placed, specimen)
        except InputError as error:
            raise InputError(str(error).replace(str(placed), str(path))) from None
    return replace(capture, path=path, warnings=notes), shape
