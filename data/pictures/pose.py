"""Where a camera was, from the markers of a mat in one or several of its pictures."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.optimize import least_squares

from common.errors import InputError
from common.types import Metres, Pixels, Points, Vector
from data.pictures.mat import MIN_MARKERS

STATED_FOCAL = 0.015  # relative error of a focal length that a file states, in whole millimetres
CONTRADICTED = 3.0  # times this error, by which markers seen askew may differ from it
MAX_FOCAL_ERROR = 0.06
DISTORTION = 0.03  # standard deviation of k1 (Brown), of phones that correct their pictures
SEEN, PRINT = 0.15, 1.5e-4  # pixels and m, errors of a marker as seen and as printed
MAX_ERROR = 3.0  # times the expected error of the markers, root mean square
_GUESS = 0.65  # focal length over the picture's diagonal, of most phones


@dataclass(frozen=True)
class Pose:
    """A camera's place and lens; its picture has (width, height) pixels.

    Attributes:
        focal: length, pixels.
        distortion: coefficient k1 of Brown's lens.
        turn, shift: (3,) rotation and translation from the mat to the camera, as OpenCV has them.
        focal_error, height_error: standard deviations, relative, and m.
    """

    size: tuple[int, int]
    focal: float
    distortion: float
    turn: np.ndarray
    shift: np.ndarray
    focal_error: float
    height_error: Metres

    @property
    def place(self) -> Vector:
        """The camera over the mat."""
        return -cv2.Rodrigues(self.turn)[0].T @ self.shift

    @property
    def tilt(self) -> float:
        """Angle, rad, between the camera's axis and the vertical."""
        return float(np.arccos(min(-cv2.Rodrigues(self.turn)[0][2, 2], 1.0)))

    def pixels_of(self, points: Points) -> Pixels:
        """Where (N, 2) the camera sees points (N, 3) over the mat, m."""
        return _projected(points, self.turn, self.shift, self.focal, self.distortion, self.size)

    def pixels_of_plane(self, height: Metres, steps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Columns and rows (N, N), float32, at which the camera sees the places of a plane at a
        ``height`` over the mat whose x are equal ``steps`` (N,), m, and whose y are minus these."""
        turn, (pixel, first) = cv2.Rodrigues(self.turn)[0], (steps[1] - steps[0], steps[0])
        middle = turn @ [first, -first, height] + self.shift
        plane = np.column_stack([turn[:, 0] * pixel, -turn[:, 1] * pixel, middle])
        return cv2.initUndistortRectifyMap(
            camera_matrix(self.focal, self.size), np.array([self.distortion, 0, 0, 0]),
            np.linalg.inv(plane), np.eye(3), (len(steps),) * 2, cv2.CV_32FC1)


def camera_matrix(focal: float, size: tuple[int, int]) -> np.ndarray:
    """Intrinsics (3, 3), pixels, of a camera whose principal point is its picture's middle."""
    return np.array([[focal, 0, (size[0] - 1) / 2], [0, focal, (size[1] - 1) / 2], [0, 0, 1.0]])


def _projected(
    points: Points, turn: np.ndarray, shift: np.ndarray, focal: float, distortion: float,
    size: tuple[int, int]
) -> np.ndarray:
    matrix = camera_matrix(focal, size)
    lens = np.array([distortion, 0, 0, 0])
    return cv2.projectPoints(np.ascontiguousarray(points), turn, shift, matrix, lens)[0][:, 0]


def camera_poses(
    sizes: Sequence[tuple[int, int]], seen: Sequence[tuple[Points, Pixels]], focal: float | None,
    no_focal: str = "", *, bent: bool = False
) -> list[Pose]:
    """Poses of pictures by one camera, upright or sideways, from centres of markers and their
    pixels; ``focal``: length as the files state it, pixels, or ``no_focal``, why it is not known.
    InputError where the markers do not lie in a plane, or leave the focal length open.

    Focal length and distortion are unknowns that all pictures share, with what is known of phones
    as prior; the picture's middle is the principal point. Where the markers contradict each other,
    the worst is left out, as of one that a hem half covers, unless the mat is ``bent`` without it.
    """
    start = focal or _GUESS * float(np.hypot(*sizes[0]))
    first_poses = [_first_pose(*one, start, size) for one, size in zip(seen, sizes, strict=True)]
    spread = STATED_FOCAL if focal else 1.0
    scales = [np.hypot(SEEN, PRINT * _pixels_per_metre(points, pixels)) for points, pixels in seen]

    def residuals(unknowns: np.ndarray) -> np.ndarray:
        parts = [unknowns[:1] / spread, unknowns[1:2] / DISTORTION]
        for k, (points, pixels) in enumerate(seen):
            turn, shift = unknowns[2 + 6 * k : 8 + 6 * k].reshape(2, 3)
            found = _projected(points, turn, shift, start * np.exp(unknowns[0]), unknowns[1],
                               sizes[k])
            parts.append((found - pixels).ravel() / scales[k])
        return np.concatenate(parts)

    first = np.concatenate([[0.0, 0.0], *(np.concatenate(pose) for pose in first_poses)])
    steps = np.concatenate([[1e-2, 1e-2], np.tile([1e-2] * 3 + [1e-2] * 3, len(seen))])
    solved = least_squares(residuals, first, x_scale=steps, loss="soft_l1", f_scale=3.0)
    count = sum(2 * len(points) for points, _ in seen)
    error = float(np.sqrt(2 * solved.cost / count))
    if error > MAX_ERROR and not bent and (kept := _without_worst(seen, solved.fun[2:])):
        return camera_poses(sizes, kept, focal, no_focal, bent=True)
    if focal and (error > MAX_ERROR or abs(solved.x[0]) > CONTRADICTED * STATED_FOCAL):
        return camera_poses(sizes, seen, None, (
            "the markers contradict the length that the file states: the picture is cut or zoomed, "
            "or an app has written another lens's"), bent=bent)
    if error > MAX_ERROR:
        raise InputError(f"the mat's markers lie {error:.1f} times as far from those of a flat mat "
                         f"as they should, at most {MAX_ERROR:g} is allowed: lay it flat, print it "
                         "at 100 %, join its parts at their lines, hold the phone still, and take "
                         "all pictures with one camera and one zoom")
    covariance = np.linalg.inv(solved.jac.T @ solved.jac) * max(1.0, error) ** 2
    focal_error = float(np.sqrt(covariance[0, 0]))
    if focal_error > MAX_FOCAL_ERROR:
        few = ("pictures from above do not show it" if len(sizes) == 1 else
               f"the {len(sizes)} pictures are too alike, or too straight from above, to show it "
               f"(to {focal_error:.0%}, at most {MAX_FOCAL_ERROR:.0%} is allowed)")
        raise InputError(
            f"the focal length is not known: {no_focal}, and {few}; give the file as the camera "
            "wrote it, whole and without zoom, or take two more pictures, from opposite sides and "
            "tilted by 30°, in the same way: of the drape, outline_2.jpg and outline_3.jpg, or of "
            "the mat, mat_1.jpg and mat_2.jpg")
    poses = []
    for k, size in enumerate(sizes):
        mine = slice(2 + 6 * k, 8 + 6 * k)
        heights = _height_gradient(solved.x[mine])
        turn, shift = solved.x[mine].reshape(2, 3)
        poses.append(Pose(
            size, start * float(np.exp(solved.x[0])), float(solved.x[1]), turn, shift, focal_error,
            float(np.sqrt(heights @ covariance[mine, mine] @ heights))))
    return poses


def _without_worst(
    seen: Sequence[tuple[Points, Pixels]], residuals: np.ndarray
) -> list[tuple[Points, Pixels]] | None:
    """All but the marker with the largest residual; None if its picture has too few."""
    counts = [len(points) for points, _ in seen]
    worst = int(np.linalg.norm(residuals.reshape(-1, 2), axis=1).argmax())
    picture = int(np.searchsorted(np.cumsum(counts), worst, side="right"))
    if counts[picture] <= MIN_MARKERS:
        return None
    kept = np.arange(counts[picture]) != worst - sum(counts[:picture])
    return [(points[kept], pixels[kept]) if k == picture else (points, pixels)
            for k, (points, pixels) in enumerate(seen)]


def _first_pose(
    points: Points, pixels: Pixels, focal: float, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    matrix = camera_matrix(focal, size)
    # Of seven markers along two sides, the solution for planes (IPPE) may find no pose.
    _, turn, shift = cv2.solvePnP(points, pixels, matrix, None, flags=cv2.SOLVEPNP_SQPNP)
    return turn.ravel(), shift.ravel()


def _pixels_per_metre(points: Points, pixels: Pixels) -> float:
    spans = (np.linalg.norm(np.ptp(one, axis=0)) for one in (pixels, points))
    return float(next(spans) / next(spans))


def _height_gradient(pose: np.ndarray) -> np.ndarray:
    """Derivative (6,) of the camera's height by turn and shift."""
    def height(values: np.ndarray) -> float:
        return float((-cv2.Rodrigues(values[:3])[0].T @ values[3:])[2])
    return np.array([(height(pose + step) - height(pose - step)) / 2e-5 for step in
                     1e-5 * np.eye(6)])
