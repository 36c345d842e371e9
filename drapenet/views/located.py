"""Views of a drape with camera pose, from its flat top, and turns, from the overlap of the views.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from common.types import Points, Turns, Views
from data.captures.capture import DepthCapture
from data.captures.plate import plate_of_cloth
from data.render.cameras import Camera, Intrinsics
from drapenet.views.turns import register
from sim.rig import Rig


@dataclass(frozen=True)
class LocatedViews:
    """Views of a drape on the plate of ``rig``."""

    views: Views
    camera: Camera  # posed relative to the plate; world x is parallel to the picture's rows
    rig: Rig
    turns: Turns  # estimated
    stated_turns: Turns
    centre: np.ndarray  # (2,) m, of the plate in the camera's world axes

    @classmethod
    def of(cls, capture: DepthCapture) -> "LocatedViews":
        """The views of a capture."""
        views = capture.views
        intrinsics = capture.intrinsics
        rig = capture.rig
        plate = capture.cut.plate if capture.cut else plate_of_cloth(views, intrinsics, rig)
        return cls.registered(views, intrinsics.posed(plate.pose), rig, capture.turns)

    @classmethod
    def cut_out(
        cls, views: Views, intrinsics: Intrinsics, rig: Rig, turns: Turns
    ) -> "LocatedViews":
        """Views that show only cloth, with the stated turns of the table."""
        camera = intrinsics.posed(plate_of_cloth(views, intrinsics, rig).pose)
        return cls.registered(views, camera, rig, turns)

    @classmethod
    def registered(cls, views: Views, camera: Camera, rig: Rig, turns: Turns) -> "LocatedViews":
        """Views of a posed camera; their turns are estimated, starting from the stated ones."""
        stated = cls.exact(views, camera, rig, turns)
        refined, centre = register(stated.clouds, turns, rig)
        located = replace(stated, turns=refined, stated_turns=turns, centre=centre)
        located.__dict__["clouds"] = stated.clouds  # where cached properties are
        return located

    @classmethod
    def exact(cls, views: Views, camera: Camera, rig: Rig, turns: Turns) -> "LocatedViews":
        """Views whose pose and turns are known, such as rendered ones."""
        turns = np.asarray(turns, dtype=float)
        return cls(views, camera, rig, turns, turns, np.zeros(2))

    @cached_property
    def clouds(self) -> list[Points]:
        """Points of the cloth in each view, in the camera's world axes."""
        return [self.camera.cloth_points(view) for view in self.views]
