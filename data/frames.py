"""Depth frames of a capture in the kinds of files that people have: m, 0 where nothing is known.

``view_K.png`` (16-bit), ``view_K_0.png``, ``view_K_1.png`` and so on (several frames of one view),
``view_K.npy`` and ``view_K.exr`` (metres), ``view_K.ply`` (points in camera axes, metres), or one
recording (:mod:`data.recordings`). A capture has one kind.
"""

import io
import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from common.documents import read_bytes, require_regular, shown
from common.errors import InputError, one_line
from data.cameras import Intrinsics
from data.reading import (
    LARGEST_FILE,
    LARGEST_PICTURE,
    MILLIMETRE,
    MOST_VIEWS,
    dimensions,
    join_views,
    median_depth,
    numbered,
    read_picture,
    require_size,
)
from data.recordings import ENDINGS, read_recording

BACKGROUND = "background.png"
RECORDED = "recording"
SATURATED = 65535  # counts, which cameras write where they measure nothing
MOST_PIXELS = 64_000_000  # of all frames of one view
MOST_POINTS = LARGEST_PICTURE[0] * LARGEST_PICTURE[1] // 4
FARTHEST = 100.0  # m, beyond which depth is in another unit, or of nothing
KINDS = ("view_{}.png", "view_{}_{}.png", "view_{}.npy", "view_{}.exr", "view_{}.ply")
"""Names of a view's files by kind, with numbers from 0 on in place of the braces."""
OTHER = {
    ".tif": "save its depth as 16-bit PNG in millimetres",
    ".tiff": "save its depth as 16-bit PNG in millimetres",
    ".mkv": "take the depth frames out with: ffmpeg -i FILE -map 0:1 -vsync 0 frame_%d.png, and "
            "keep one of each stop, view_0.png and so on",
    ".r3d": "export its depth frames as npy in metres",
}
"""What to do with files of other kinds."""


@dataclass(frozen=True)
class Frames:
    """What a folder of depth frames holds.

    Attributes:
        frames: (K, H, W) float32, m, one a view.
        background: (H, W) float32, m, the empty scene; None without one.
        intrinsics: that the files themselves state; None where they do not.
        color: (K, H, W) uint8 grey, pictures of a board; None without them.
    """

    frames: np.ndarray
    background: np.ndarray | None
    intrinsics: Intrinsics | None = None
    color: np.ndarray | None = None


def read_frames(
    folder: Path, unit: float | None, intrinsics_of: Callable[[int, int], Intrinsics],
    size: tuple[int, int] | None,
) -> Frames:
    """The frames of a folder, of whichever kind of files.

    Args:
        unit: m per count; None: as the files say, or millimetres.
        intrinsics_of: those of pictures of a width and a height.
        size: width and height that point clouds are projected to.

    Raises:
        InputError: no frames, two kinds of them, one that cannot be read or is too large.
    """
    names = sorted(file.name for file in folder.iterdir())
    kind = _kind(folder, names)
    counted, intrinsics = unit or MILLIMETRE, None
    if kind == RECORDED:
        frames, intrinsics = read_recording(folder / next(filter(_recorded, names)), unit)
    elif kind == "view_{}_{}.png":
        frames = join_views({files[0]: _median(files) * counted
                             for files in _bursts(folder, names)})
    else:
        if kind.endswith("ply") and size is None:
            raise InputError(f"{folder}: point clouds need size_px: [WIDTH, HEIGHT] in "
                             "capture.yaml, of the picture that the intrinsics are of")
        reader = {
            ".png": lambda file: read_counts(file) * counted,
            ".npy": read_array, ".exr": read_exr,
            ".ply": lambda file: read_points(file, intrinsics_of(*size))}[Path(kind).suffix]
        frames = join_views({file: reader(file) for file in numbered(folder, kind)})
    background = None
    if BACKGROUND in names:
        background = np.minimum(read_counts(folder / BACKGROUND) * counted,
                                FARTHEST).astype(np.float32)
        if background.shape != frames.shape[1:]:
            raise InputError(f"{folder / BACKGROUND} has {dimensions(background)} pixels, the "
                             f"views have {dimensions(frames[0])}; take it with the same camera")
    color = None
    if any(re.fullmatch(r"color_\d+\.png", name) for name in names):
        color = join_views({
            file: _grey(read_picture(file, modes={"L", "RGB", "RGBA"}, kind="8-bit"))
            for file in numbered(folder, "color_{}.png")})
        if color.shape != frames.shape:
            raise InputError(f"{folder}: there are {len(color)} color pictures of "
                             f"{dimensions(color[0])} pixels but {len(frames)} views of "
                             f"{dimensions(frames[0])}; give one color picture for each view, of "
                             "the same size (the SDK's color aligned to depth)")
    return Frames(np.minimum(frames, FARTHEST).astype(np.float32), background, intrinsics, color)


def read_counts(file: Path) -> np.ndarray:
    """(H, W) counts of a 16-bit PNG, 0 where saturated."""
    counts = read_picture(file, modes={"I;16", "I"}, kind="16-bit grey")
    return np.where(counts >= SATURATED, 0, counts)


def _grey(picture: np.ndarray) -> np.ndarray:
    """(H, W) uint8 of a picture in grey or colour."""
    return picture if picture.ndim == 2 else picture[..., :3].mean(axis=2).astype(np.uint8)


def _recorded(name: str) -> bool:
    return Path(name).suffix.lower() in ENDINGS


def _kind(folder: Path, names: list[str]) -> str:
    """One of :data:`KINDS`, or :data:`RECORDED`."""
    found = [kind for kind in KINDS if any(_named(kind, name) for name in names)]
    recordings = [name for name in names if _recorded(name)]
    examples = [*(kind.format(0, 0) for kind in found), *recordings]
    if len(examples) > 1:
        raise InputError(f"{folder} holds {examples[0]} and {examples[1]}: give the views in one "
                         "kind of file, or one recording")
    if examples:
        return found[0] if found else RECORDED
    for name in names:
        if (ending := Path(name).suffix.lower()) in OTHER:
            raise InputError(f"{folder / name}: files of this kind are not read; {OTHER[ending]}")
    return KINDS[0]  # the message that they are missing is the reader's


def _named(kind: str, name: str) -> re.Match | None:
    return re.fullmatch(re.escape(kind).replace(r"\{\}", r"(\d+)"), name)


def _bursts(folder: Path, names: list[str]) -> list[list[Path]]:
    """The files of each view; names view_K_J.png must count both from 0."""
    views = 1 + max(int(match[1]) for name in names if (match := _named(KINDS[1], name)))
    if views > MOST_VIEWS:
        raise InputError(f"{folder} has {views} views; a capture has at most {MOST_VIEWS}")
    return [numbered(folder, f"view_{k}_{{}}.png", most=MOST_PIXELS) for k in range(views)]


def _median(files: list[Path]) -> np.ndarray:
    """Median (H, W) counts of a view's frames."""
    frames: list[np.ndarray] = []
    for file in files:
        frames.append(read_counts(file))
        if frames[-1].shape != frames[0].shape:
            raise InputError(f"{file} has {dimensions(frames[-1])} pixels but {files[0].name} has "
                             f"{dimensions(frames[0])}; all must have one size")
        if len(files) * frames[0].size > MOST_PIXELS:
            raise InputError(f"{file.parent}: a view has {len(files)} frames of "
                             f"{dimensions(frames[0])} pixels; give at most "
                             f"{MOST_PIXELS // frames[0].size}, leave the others out")
    return median_depth(np.stack(frames))


def _metres(depth: np.ndarray, file: Path) -> np.ndarray:
    """``depth``, m, with 0 for all that is no depth."""
    depth = np.where(np.isfinite(depth) & (depth > 0), depth, 0).astype(np.float32)
    _require_metres(depth[depth > 0], file)
    return depth


def _require_metres(depths: np.ndarray, file: Path) -> None:
    if depths.size and (middle := float(np.median(depths))) > FARTHEST:
        raise InputError(f"{file}: its median depth is {middle:.4g}, which cannot be metres; give "
                         "depth in metres")


def read_array(file: Path) -> np.ndarray:
    """Depth (H, W), m, of a NumPy file of floating-point numbers."""
    data = read_bytes(file, LARGEST_FILE, "view")
    wrong = f"{file} must hold one array (height, width) of floating-point numbers, depth in metres"
    try:
        depth = np.lib.format.read_array(io.BytesIO(data))
    except Exception as error:  # tokenize's errors among others, of a damaged header
        raise InputError(f"{file} cannot be read ({one_line(error)}); {wrong}: save it with "
                         "numpy.save") from None
    if depth.ndim != 2 or depth.dtype.kind != "f" or depth.itemsize > 8:
        raise InputError(f"{wrong}; it holds {shown(depth.shape)} of {shown(str(depth.dtype))}")
    require_size(file, *depth.shape[::-1])
    return _metres(depth, file)


def read_exr(file: Path) -> np.ndarray:
    """Depth (H, W), m, of an OpenEXR file: its channel Z, or its only one."""
    import OpenEXR

    require_regular(file, LARGEST_FILE, "view")
    try:
        # The header first: pixels of a size that no view has are never decoded.
        with OpenEXR.File(str(file), header_only=True) as header:
            window = header.header()["dataWindow"]
            width, height = (int(n) for n in np.asarray(window[1]) - np.asarray(window[0]) + 1)
        require_size(file, width, height)
        with OpenEXR.File(str(file), separate_channels=True) as picture:
            channels = {name: np.array(one.pixels) for name, one in picture.channels().items()}
    except InputError:
        raise
    except Exception as error:  # the library has no error class
        raise InputError(f"{file} is damaged or not an OpenEXR picture ({type(error).__name__}); "
                         "export the view again") from None
    name = next((one for one in channels if one.split(".")[-1] in ("Z", "V")), None)
    if name is None and len(channels) != 1:
        raise InputError(f"{file} has channels {shown(sorted(channels))}; give depth as channel Z")
    return _metres(channels[name] if name else next(iter(channels.values())), file)


def read_points(file: Path, intrinsics: Intrinsics) -> np.ndarray:
    """Depth (H, W), m, of a PLY of points in camera axes: in each pixel that of the nearest.

    The points may stand in any order; colours and triangles are not used.
    """
    import trimesh

    data = read_bytes(file, 64 * MOST_POINTS, "view")
    count = re.search(rb"^element vertex (\d{1,12})\s*$", data[:65536], re.MULTILINE)
    if not data.startswith(b"ply") or not count:
        raise InputError(f"{file} is not a PLY file; export the view again")
    if int(count[1]) > MOST_POINTS:
        raise InputError(f"{file}: {int(count[1])} points are too many; a view has at most "
                         f"{MOST_POINTS}: reduce the cloud")
    try:
        # From memory: a PLY may name other files, such as pictures, which are not read.
        loaded = trimesh.load(io.BytesIO(data), file_type="ply", process=False,
                              skip_materials=True)
        points = np.asarray(loaded.vertices, dtype=np.float64).reshape(-1, 3)
    except Exception:  # what trimesh says of a file that it cannot read is of no use to its owner
        raise InputError(f"{file} is damaged or holds no points; export the view again") from None
    points = points[np.isfinite(points).all(axis=1)]
    points = points[(points[:, 2] > 0) & (points[:, 2] < math.inf)]
    if not len(points):
        raise InputError(f"{file} has no point in front of the camera; give camera axes: x right, "
                         "y down, z forward")
    _require_metres(points[:, 2], file)
    u = np.rint(intrinsics.fx * points[:, 0] / points[:, 2] + intrinsics.cx)
    v = np.rint(intrinsics.fy * points[:, 1] / points[:, 2] + intrinsics.cy)
    inside = (u >= 0) & (u < intrinsics.width) & (v >= 0) & (v < intrinsics.height)
    if inside.mean() < 0.5:
        raise InputError(f"{file}: {1 - inside.mean():.0%} of its points fall outside the picture "
                         "of the intrinsics; give camera axes (x right, y down, z forward), metres")
    depth = np.full((intrinsics.height, intrinsics.width), np.inf, np.float32)
    np.minimum.at(depth, (v[inside].astype(int), u[inside].astype(int)), points[inside, 2])
    return np.where(np.isfinite(depth), depth, np.float32(0.0))
