"""What a network reads of a capture: map or pictures of depth views, or outline, with azimuth 0
along the warp, and numbers."""

from dataclasses import dataclass, replace

import numpy as np

from common.errors import InputError
from common.types import Radians
from data.captures.capture import OutlineCapture
from data.readings.known import Reported
from drapenet.views.directions import AZIMUTHS
from drapenet.views.located import LocatedViews
from drapenet.views.outline import DrapeOutline, outline_of_curve, outline_of_map
from drapenet.views.pictures import DepthPictures
from drapenet.views.radial_map import RadialMap, radial_map
from sim.rig import Rig


@dataclass(frozen=True)
class Observation:
    """One capture.

    Attributes:
        face: 1 if the marked face of the fabric is up, else -1.
        known: whether the direction of the warp is stated; else azimuth 0 is a side of a square,
            the first side of a rectangle, any direction of a disc.
        outline: of a depth capture, that of its visible cloth.
        pictures: of a depth capture, for networks that read views.
        coefficient, nodes: drape coefficient, from 0 to 1, and number of folds, of a capture that
            has nothing else; NaN: unknown.
    """

    rig: Rig
    face: int
    known: bool
    map: RadialMap | None = None
    outline: DrapeOutline | None = None
    coefficient: float = np.nan
    nodes: float = np.nan
    pictures: DepthPictures | None = None

    @classmethod
    def of_views(cls, located: LocatedViews, face: int, warp: Radians | None) -> "Observation":
        """Of located depth views; ``warp``: direction in the first view, None if it is not stated.
        """
        rig = located.rig
        drape = map_along(warp, located)
        return cls(rig, face, warp is not None, drape, outline_of_map(drape, rig),
                   pictures=DepthPictures.of(located, drape.zero))

    @classmethod
    def of_numbers(
        cls, rig: Rig, face: int, known: bool, reported: Reported | None
    ) -> "Observation":
        """Of a reported drape coefficient and number of nodes."""
        assert reported and reported.drape_coefficient_percent, "a reported drape coefficient"
        nodes = np.nan if reported.nodes is None else reported.nodes
        return cls(rig, face, known, coefficient=reported.drape_coefficient_percent / 100,
                   nodes=nodes)

    @classmethod
    def of_outline(cls, capture: OutlineCapture) -> "Observation":
        """Of the outline of a photograph; InputError without direction of the warp, but of a disc.
        """
        seen = capture.outline
        warp = capture.warp_direction
        specimen = capture.rig.specimen
        if warp is None and specimen != "disc":
            raise InputError(f"{capture.path}: warp_direction_deg is missing; the outline of a "
                             f"{specimen} does not show its sides: state the direction of the warp")
        outline = outline_of_curve(seen.curve, zero=warp or 0.0, height=seen.height,
                                   error=seen.error)
        return cls(capture.rig, capture.sign, warp is not None, outline=outline)


def map_along(warp: Radians | None, located: LocatedViews) -> RadialMap:
    """Map with azimuth 0 at the ``warp`` of a disc, at the nearest of the directions in which the
    first side of a rectangle may lie, or, if that is None, at any of these, or, of a disc, at
    azimuth 0 of the first view."""
    if located.rig.specimen == "disc":
        return radial_map(located, zero=warp or 0.0)
    drape = radial_map(located, near=warp)
    turn = located.rig.symmetry
    turns = 0 if warp is None else round((warp - drape.zero) / turn)
    cells = round(AZIMUTHS * turn / (2 * np.pi))
    distance, weight = (np.roll(part, -turns * cells, axis=0)
                        for part in (drape.distance, drape.weight))
    return replace(drape, distance=distance, weight=weight, zero=drape.zero + turns * turn)
