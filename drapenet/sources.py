"""What a user names to be estimated: captures and scans, and the checkpoint for them."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from common.ctrl_c import deferred
from data.captures import Capture, require_alike
from drapenet.checkpoint import Header, bundled, read_header


def read_scan_capture(
    path: Path, *, density: float, held: float = 1.0
) -> tuple[Capture, Any]:
    """A scan of a drape on the disc rig as a capture, and as what the refinement compares with.

    Args:
        density: kg/m². held: share of the support's radius that holds the specimen
            (:class:`drapenet.refine.surface.CapturedShape`).

    Raises:
        InputError: no such scan, or none of a drape.
    """
    with deferred():
        from drapenet.refine.scans import read_shape, scan_capture
        from drapenet.refine.search import CapturedScan
        from sim.scene import DISC_RIG

    shape = read_shape(path, DISC_RIG, held=held).shape
    return scan_capture(path, shape, density), CapturedScan(shape)


def header_for(captures: Sequence[Capture], checkpoint: str = "") -> Header:
    """The checkpoint for captures of one rig, and of one naming; the bundled one if none is named.

    Raises:
        InputError: several rigs or densities, some captures with a marked warp and some without, or
            a checkpoint of another rig.
    """
    require_alike([one.rig for one in captures],
                  [one.warp_direction is not None for one in captures],
                  [one.density for one in captures])
    header = read_header(checkpoint or bundled(captures[0].rig))
    header.require_rig(captures[0].rig)
    return header
