"""Photographs of cantilever strips from the side, as a laboratory takes them: practice pictures.

The strip is extruded across its width from its deflection curve, with a thickness, and clamped
between two plates. A camera with perspective looks along the width. The axes of the world are x
outwards from the clamp's edge, y away from the camera, from the middle of the strip's width, z up.
"""

import io
import math
from dataclasses import dataclass, replace
from itertools import pairwise

import cv2
import numpy as np
from PIL import Image

from common.types import DeflectionCurve, Metres, Pixels, Points, Radians
from data.captures.board import PAPER, board_picture
from data.render.cameras import Camera, Intrinsics, camera_pose

TILT, ROLL = math.radians(1.5), math.radians(3.0)  # of a camera on its stand, standard deviations
FINE = 3  # samples per pixel and axis
FOCAL = 3.2  # of the picture's width: a telephoto lens
CLAMP = ((-0.05, 0.0), (-0.02, 0.02), (-0.012, 0.012))  # m: x, y, z of the clamp


@dataclass(frozen=True)
class StripScene:
    """What stands before the camera, and how it is photographed. Brightness is 0 to 255.

    Attributes:
        slope: of the clamp below the horizontal.
        edge: of the clamp, as seen, beyond the place where the strip starts to bend.
        distance: from the lens to the middle of the strip's width.
        yaw, pitch, roll: of the camera, from a view straight along the width.
        aim: (2,) m, x and z of the point in the middle of the picture.
        field: width of the picture in the plane of the middle of the strip.
        gradient: of the ground's brightness over the picture, relative.
        blur: standard deviation, pixels; ``noise``: standard deviation, brightness.
        board: (2,) m, x and z of the middle of the printed board in the middle plane, or None.
    """

    curve: DeflectionCurve
    width: Metres = 0.03
    thickness: Metres = 4e-4
    slope: Radians = 0.0
    edge: Metres = 0.0
    distance: Metres = 1.0
    yaw: Radians = 0.0
    pitch: Radians = 0.0
    roll: Radians = 0.0
    aim: tuple[float, float] = (0.02, -0.02)
    field: Metres = 0.12
    size: tuple[int, int] = (1600, 1200)
    cloth: float = 70.0
    clamp: float | None = 40.0
    ground: float = 205.0
    gradient: float = 0.1
    blur: float = 1.0
    noise: float = 3.0
    board: tuple[float, float] | None = None
    to_the_left: bool = False

    @property
    def camera(self) -> Camera:
        """The camera, in the axes of the world."""
        columns, rows = self.size
        focal = self.distance * columns / self.field
        pose = camera_pose(distance=self.distance, pitch=self.pitch, roll=self.roll)
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        turned = np.eye(4)
        turned[:3, :3] = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
        moved = np.eye(4)
        moved[:3, 3] = -self.aim[0], 0, -self.aim[1]
        return Intrinsics(focal, focal, (columns - 1) / 2, (rows - 1) / 2, columns, rows).posed(
            pose @ turned @ moved)

    def pixels(self, points: np.ndarray) -> Pixels:
        """Where points (N, 2), m, of the middle plane, reach and drop, are in the picture."""
        return self._project(np.column_stack([points[:, 0], 0 * points[:, 0], -points[:, 1]]))

    def _project(self, points: Points) -> Pixels:
        pixels, _ = self.camera.project(points)
        if self.to_the_left:
            pixels = pixels * [-1, 1] + [self.size[0] - 1, 0]
        return pixels

    def photograph(self, rng: np.random.Generator) -> np.ndarray:
        """The picture (H, W) uint8."""
        columns, rows = self.size
        picture = np.full((FINE * rows, FINE * columns), self.ground, np.float32)
        down = np.linspace(-0.5, 0.5, len(picture), dtype=np.float32)[:, None]
        across = np.linspace(-0.5, 0.5, picture.shape[1], dtype=np.float32)
        picture *= 1 + self.gradient * (down + 0.7 * across)
        if self.board:
            self._lay_board(picture)
        for corners, shade in self._faces():
            pixels = FINE * (self._project(corners) + 0.5) - 0.5
            cv2.fillPoly(picture, [np.rint(16 * pixels).astype(np.int32)], shade, shift=4)
        small = cv2.resize(picture, (columns, rows), interpolation=cv2.INTER_AREA)
        noisy = cv2.GaussianBlur(small, (0, 0), self.blur) + rng.normal(0, self.noise, small.shape)
        return noisy.clip(0, 255).astype(np.uint8)

    def _faces(self) -> list[tuple[Points, float]]:
        """Corners (N, 3) and brightness of what is visible, the farthest first."""
        faces = []
        if self.clamp is not None:
            faces += [(corners, shade * self.clamp) for corners, shade in self._clamp()[:-1]]
        side = np.gradient(self.curve, axis=0)
        side = np.column_stack([side[:, 1], -side[:, 0]])  # up and out of the upper face
        side *= 0.5 * self.thickness / np.linalg.norm(side, axis=1)[:, None]
        for face in (self.curve - side, self.curve + side):
            for start, end in pairwise(face):
                lit = 0.85 + 0.3 * abs(end[0] - start[0]) / np.linalg.norm(end - start)
                faces.append((self._across(np.stack([start, end])), lit * self.cloth))
        edge = np.vstack([self.curve - side, (self.curve + side)[::-1]])
        faces.append((np.column_stack([edge[:, 0], np.full(len(edge), -self.width / 2),
                                       -edge[:, 1]]), 0.95 * self.cloth))
        if self.clamp is not None:
            faces.append((self._clamp()[-1][0], self.clamp))
        return faces

    def _across(self, line: np.ndarray) -> Points:
        """The strip of a line (2, 2) in the middle plane: four corners."""
        near, far = (np.column_stack([line[:, 0], np.full(2, y), -line[:, 1]])
                     for y in (-self.width / 2, self.width / 2))
        return np.vstack([near, far[::-1]])

    def _clamp(self) -> list[tuple[Points, float]]:
        """Faces of the clamp: below, above, outwards, and towards the camera."""
        (back, edge), (near, far), (low, high) = CLAMP
        edge += self.edge
        cos, sin = math.cos(self.slope), math.sin(self.slope)
        corners = [
            ([(back, near, low), (edge, near, low), (edge, far, low), (back, far, low)], 0.7),
            ([(back, near, high), (edge, near, high), (edge, far, high), (back, far, high)], 1.3),
            ([(edge, near, low), (edge, far, low), (edge, far, high), (edge, near, high)], 1.1),
            ([(back, near, low), (edge, near, low), (edge, near, high), (back, near, high)], 1.0)]
        turn = np.array([[cos, 0, -sin], [0, 1, 0], [sin, 0, cos]])
        return [(np.array(face) @ turn, shade) for face, shade in corners]

    def _lay_board(self, picture: np.ndarray) -> None:
        """Draw the printed board in the middle plane."""
        page = np.array(Image.open(io.BytesIO(board_picture())), np.float32)
        high, wide = page.shape
        middle = np.array(self.board)
        half = np.array(PAPER) / 2
        corners = middle + half * [[-1, 1], [1, 1], [1, -1], [-1, -1]]
        place = FINE * (self.pixels(corners * [1, -1]) + 0.5) - 0.5
        if self.to_the_left:  # the board is not mirrored
            place = place[[1, 0, 3, 2]]
        start = np.array([[0, 0], [wide, 0], [wide, high], [0, high]], np.float32) - 0.5
        turn = cv2.getPerspectiveTransform(start, place.astype(np.float32))
        shown = cv2.warpPerspective(page, turn, picture.shape[::-1], flags=cv2.INTER_AREA)
        inside = cv2.fillConvexPoly(np.zeros(picture.shape, np.uint8),
                                    np.rint(place).astype(np.int32), 1)
        np.copyto(picture, shown, where=inside > 0)


def posed(scene: StripScene, rng: np.random.Generator, *, tilt: Radians = TILT) -> StripScene:
    """The scene from another pose of the camera, 0.6 to 1.5 m away; ``tilt``, rad, is the standard
    deviation of yaw and pitch. Strip and clamp fill the picture's middle."""
    low, high = scene.curve.min(axis=0), scene.curve.max(axis=0)
    left, top = min(low[0], -0.02), min(low[1], CLAMP[2][0])
    middle = np.array([(left + high[0]) / 2, -(top + high[1]) / 2])
    columns, rows = scene.size
    need = max(high[0] - left, (high[1] - top) * columns / rows)
    field = rng.uniform(1.3, 1.8) * need
    aim = middle + rng.uniform(-0.06, 0.06, 2) * field
    return replace(scene, distance=rng.uniform(0.6, 1.5), yaw=rng.normal(0, tilt),
                   pitch=rng.normal(0, tilt), roll=rng.normal(0, ROLL), field=float(field),
                   aim=(float(aim[0]), float(aim[1])))
