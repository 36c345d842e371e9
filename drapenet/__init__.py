"""Estimation of bending moduli from depth images of a drape."""

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from drapenet.result.estimate import Estimate


def load(path: str | Path) -> "Estimate":
    """The estimate of an ``estimate.json``, or of that in a folder, with its posterior samples."""
    from drapenet.result.files import read_estimate

    estimate, _ = read_estimate(Path(path))
    return estimate
