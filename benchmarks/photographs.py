"""Drapes as a capture shows them, seen by a camera beside its nominal place with a sensor's noise;
and what the network makes of a capture."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from data.cameras import Camera, CameraRig, Intrinsics
from data.captures import Capture, whole_turns
from drapenet.checkpoint import Header
from sim.material import REFERENCE_DENSITY

if TYPE_CHECKING:
    from drapenet.estimate import Estimate


def place(rng: np.random.Generator) -> tuple[Camera, float]:
    """A camera, and the turn of the specimen in its first view, rad."""
    return CameraRig.load().sample(rng), float(rng.uniform(0, 2 * np.pi))


def estimated(
    views: np.ndarray, intrinsics: Intrinsics, header: Header, *, friction: float | None = None
) -> "Estimate":
    """What the network of ``header`` says of a capture, as ``infer.py`` does, of 300 g/m².

    Args:
        views: (K, H, W) z-depth, m, background 0; the table turned by whole K-ths of a turn.
        intrinsics: of these pictures.
        friction: N·m per metre, where the network is given it.
    """
    from drapenet.inference import infer_capture

    capture = Capture(views, intrinsics, whole_turns(len(views)), REFERENCE_DENSITY, None,
                      header.rig, Path(), ())
    return infer_capture(capture, header, friction=friction).estimate
