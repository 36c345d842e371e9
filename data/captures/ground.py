"""What a camera over a mat sees behind the hem of a drape, and from where another picture would
show the hem over plain ground.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from common.types import Metres, Vector
from data.captures.description import OutlineSource
from data.captures.off_axis import MAX_LEAN, OUTWARDS
from data.captures.scale import mat_scale
from data.pictures.mat import QUIET, along_border, near_markers, on_paper
from data.pictures.planes import behind

_KINDS = ("a marker", "the edge of the mat's paper", "the table beside the mat", "the plain mat",
          "a thing that hides the mat's code")
_LEAN = 0.8 * MAX_LEAN  # of a place that is asked for, which nobody meets exactly
_HIGHER, _HIGHEST = 1.3, 1.5  # over the present height; m above the plate
_DIRECTIONS = 16
_APART = 0.5  # of the lean that is asked for, between the places of two pictures
_NEARLY = 0.05  # of what is unclear, that makes no difference between places


@dataclass(frozen=True)
class Ground:
    """A mat below the plate, as it is printed and stated."""

    mat: str
    scale: float
    plate_height: Metres
    coded: bool = False

    @classmethod
    def of(cls, source: OutlineSource, *, coded: bool = False) -> "Ground | None":
        """The mat that is stated, with the code if that is seen; None without a mat."""
        if source.mat is None or source.plate_height_mm is None:
            return None
        return cls(source.mat, mat_scale(source), 1e-3 * source.plate_height_mm, coded)

    def behind_hem(self, radii: np.ndarray, camera: Vector) -> np.ndarray:
        """Places (720, 2), m of the mat's layout, that a ``camera``, m from the plate's centre,
        sees behind a hem of ``radii`` (720,), m."""
        eye = camera + np.array([0, 0, self.plate_height])
        return behind(radii[:, None] * OUTWARDS, eye, self.plate_height) / self.scale

    def along_border(self, radii: np.ndarray, camera: Vector) -> np.ndarray:
        """Where (720,) the border of the paper is seen along a hem."""
        return along_border(self.mat, self.behind_hem(radii, camera))

    def kind(self, radii: np.ndarray, where: np.ndarray, camera: Vector) -> str:
        """What lies behind most of a part, ``where`` (720,), of a hem."""
        places = self.behind_hem(radii, camera)[where]
        number = np.select([near_markers(self.mat, places, QUIET), along_border(self.mat, places),
                            ~on_paper(self.mat, places)], [0, 1, 2], 3 + self.coded)
        return _KINDS[int(np.bincount(number).argmax())]

    def next_camera(
        self, radii: np.ndarray, unclear: np.ndarray, cameras: Sequence[Vector]
    ) -> np.ndarray:
        """Place (3,), m from the plate's centre, from which most of an ``unclear`` part (720,) of a
        hem is seen over plain ground, the nearest to the axis; ``cameras``: places of the pictures
        that there are, the latest last."""
        height = float(cameras[-1][2])
        angle = np.arange(_DIRECTIONS) * (2 * np.pi / _DIRECTIONS)
        feet = np.vstack([[0, 0], _LEAN * np.column_stack([np.cos(angle), np.sin(angle)])])
        heights = [height, *([_HIGHER * height] * (_HIGHER * height <= _HIGHEST))]
        places = [np.append(foot * above, above) for above in heights for foot in feet]
        taken = np.array([camera[:2] / camera[2] for camera in cameras])
        new = [place for place in places if np.linalg.norm(
            taken - place[:2] / place[2], axis=1).min() > _APART * _LEAN or place[2] > height]
        return min(new, key=lambda place: (
            round(self._hidden(radii, unclear, place) / _NEARLY), place[2],
            round(float(np.linalg.norm(place[:2])), 6), np.linalg.norm(place - cameras[-1])))

    def _hidden(self, radii: np.ndarray, unclear: np.ndarray, camera: Vector) -> float:
        """Share of an unclear part of a hem behind which markers or the paper's border are seen."""
        places = self.behind_hem(radii, camera)[unclear]
        hidden = near_markers(self.mat, places) | along_border(self.mat, places)
        return float(hidden.mean()) if len(places) else 0.0
