"""From a capture to the network's estimate, the way that ``infer.py`` goes."""

from dataclasses import dataclass

from data.cameras import Camera
from data.captures import Capture
from drapenet.canonical import DrapeMap, drape_map
from drapenet.checkpoint import Header, load_model
from drapenet.estimate import Estimate, make_estimate
from drapenet.maps import located_camera
from drapenet.predict import predict
from sim.scene import Rig


@dataclass(frozen=True)
class Inferred:
    """What the network makes of one capture.

    Attributes:
        estimate: with its own warnings.
        camera: as located from the plate.
        found: the map that the network has seen, with the table's turns.
    """

    estimate: Estimate
    camera: Camera
    found: DrapeMap


def infer_capture(
    capture: Capture, header: Header, *, membrane: float | None = None,
    friction: float | None = None,
) -> Inferred:
    """Estimate a capture.

    Args:
        header: of a checkpoint for the capture's rig.
        membrane: N/m along the yarns, friction: N·m per metre; where they are known.
    """
    rig = Rig.from_name(header.rig)
    camera = located_camera(capture.views, capture.intrinsics, rig)
    found = drape_map(capture.views, camera, rig, turns=capture.turns)
    draws, = predict(load_model(header), header, [found], membrane=membrane, friction=friction)
    return Inferred(make_estimate(draws, capture=capture, header=header), camera, found)
