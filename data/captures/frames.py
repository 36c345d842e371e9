"""Depth frames of a capture in files of several formats: m, 0 where depth is missing.

``view_K.png`` (16-bit), ``view_K_0.png``, ``view_K_1.png`` and so on (several frames of one view),
``view_K.npy`` and ``view_K.exr`` (metres), ``view_K.ply`` (points in camera axes, metres), or one
recording (:mod:`data.captures.rosbag`). All views of a capture have the same format. Distortion by
a lens that capture.yaml or the recording states is removed.
"""

import io
import itertools
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from common.documents import read_bytes, reading, require_regular
from common.errors import InputError, shown
from common.types import DepthImage, GreyViews, Views
from data.captures.depth import MAX_DEPTH, between_points, measured, median_depth, unsaturated
from data.captures.description import MAX_PICTURE, MAX_VIEWS, MILLIMETRE, Description, require_size
from data.captures.rosbag import read_recording, recordings
from data.render.cameras import Intrinsics

BACKGROUND = "background.png"
RECORDING = "recording"
MAX_FILE_BYTES = 160 << 20  # of a picture
MAX_PIXELS = 64_000_000  # of all frames of one view
MAX_POINTS = MAX_PICTURE[0] * MAX_PICTURE[1] // 4
KINDS = ("view_{}.png", "view_{}_{}.png", "view_{}.npy", "view_{}.exr", "view_{}.ply")
"""File names of views by format; braces are replaced by numbers from 0."""
_NEARLY = re.compile(r"view[\W_]*\d+[\W_]*\.(png|npy|exr|ply)", re.IGNORECASE)
"""Meant for names of views."""
_UNREAD = {
    ".raw": "bare pixels without their size", ".pcd": "a point cloud of PCL",
    ".npz": "an archive of arrays", ".jpg": "an 8-bit picture, whose compression changes depth",
    ".jpeg": "an 8-bit picture, whose compression changes depth", ".tif": "TIFF", ".tiff": "TIFF",
    ".mkv": "a recording of Azure Kinect or Orbbec", ".r3d": "a recording of Record3D"}
"""What files are that hold depth, but are not read, by suffix."""


@dataclass(frozen=True)
class Frames:
    """Content of a folder of depth frames: of each view, of the empty scene, of a board; intrinsics
    that capture.yaml or a recording states.
    """

    depth: Views
    background: DepthImage | None
    intrinsics: Intrinsics | None
    color: GreyViews | None
    spacing: float = 1.0  # pixels between measured points


def read_frames(folder: Path, description: Description) -> Frames:
    """Read the frames of a capture, in any of the supported formats."""
    names = sorted(file.name for file in folder.iterdir())
    kind = _kind(folder)
    unit, stated = description.depth_unit_m or MILLIMETRE, description.intrinsics is not None
    has_color = any(_match("color_{}.png", name) for name in names)
    intrinsics, lens = None, description.lens
    if kind == RECORDING:
        depth, intrinsics, lens = read_recording(
            recordings(folder), description.depth_unit_m, calibrated=not stated)
    elif kind == "view_{}_{}.png":
        depth = join_views({files[0]: unit * _median(files) for files in _bursts(folder, names)})
    else:
        read = _reader(folder, kind, unit, description)
        depth = join_views({file: read(file) for file in numbered(folder, kind)})
    scene = [_background(folder / BACKGROUND, unit, depth)] if BACKGROUND in names else []
    color: Sequence[np.ndarray] = list(_color(folder, depth)) if has_color else ()
    if stated:
        intrinsics, lens = description.stated_camera(*depth.shape[:0:-1]), description.lens
    depth = np.minimum(depth, MAX_DEPTH).astype(np.float32)
    filled, spacings = zip(*map(between_points, [*depth, *scene]), strict=True)
    if lens and intrinsics and not kind.endswith("ply"):  # points have no lens
        filled, color = ([lens.undistorted(picture, intrinsics) for picture in pictures]
                         for pictures in (filled, color))
    return Frames(np.stack(filled[: len(depth)]), filled[-1] if scene else None, intrinsics,
                  np.stack(color) if has_color else None, float(np.median(spacings)))


def _reader(
    folder: Path, kind: str, unit: float, description: Description
) -> Callable[[Path], DepthImage]:
    """Reads one view of a ``kind`` of :data:`KINDS`; ``unit``: m per count."""
    if kind.endswith("npy"):
        return read_array
    if kind.endswith("exr"):
        return read_exr
    if kind.endswith("ply"):
        if description.size_px is None:
            raise InputError("point clouds need size_px: [WIDTH, HEIGHT] in "
                             "capture.yaml, of the picture that the intrinsics are of",
                             source=folder)
        camera = description.stated_camera(*description.size_px)
        return lambda file: read_points(file, camera)
    return lambda file: read_counts(file) * unit


def _background(file: Path, unit: float, depth: Views) -> DepthImage:
    background = np.minimum(read_counts(file) * unit, MAX_DEPTH).astype(np.float32)
    if background.shape != depth.shape[1:]:
        raise InputError(f"has {_size(background)} pixels, the views have "
                         f"{_size(depth[0])}; take it with the same camera", source=file, joint=" ")
    return background


def _color(folder: Path, depth: Views) -> GreyViews:
    """The colour or infrared pictures."""
    pictures = {file: read_picture(file, modes={"L", "RGB", "RGBA"}, kind="8-bit")
                for file in numbered(folder, "color_{}.png")}
    color = join_views({
        file: picture if picture.ndim == 2 else picture[..., :3].mean(axis=2).astype(np.uint8)
        for file, picture in pictures.items()})
    if color.shape != depth.shape:
        raise InputError(f"there are {len(color)} color pictures of {_size(color[0])} "
                         f"pixels but {len(depth)} views of {_size(depth[0])}; give one color "
                         "picture for each view, of the same size (the SDK's color aligned to "
                         "depth)", source=folder)
    return color


def read_counts(file: Path) -> np.ndarray:
    """(H, W) counts of a 16-bit PNG, 0 where saturated."""
    return unsaturated(read_picture(file, modes={"I;16", "I"}, kind=(
        "16-bit grey, or be called outline.png if it is a photograph from above")))


def views_in(folder: Path) -> dict[str, str]:
    """The kinds of depth views in a folder, of :data:`KINDS` or :data:`RECORDING`, and the first
    file of each; InputError for several recordings.
    """
    names = sorted(file.name for file in folder.iterdir())
    found = {kind: next((name for name in names if _match(kind, name)), "") for kind in KINDS}
    found[RECORDING] = next((file.name for file in recordings(folder)), "")
    return {kind: name for kind, name in found.items() if name}


def _kind(folder: Path) -> str:
    """The one kind of views in a folder."""
    examples = list((found := views_in(folder)).values())
    if len(examples) > 1:
        raise InputError(f"holds {examples[0]} and {examples[1]}: give the views in one "
                         "kind of file, or one recording", source=folder, joint=" ")
    for file in sorted(folder.iterdir()):
        if _NEARLY.fullmatch(file.name) and not any(_match(kind, file.name) for kind in KINDS):
            raise InputError(f"holds {shown(file.name)}; views are called {KINDS[0].format(0)}, "
                             f"{KINDS[0].format(1)} and so on: rename it, or take it away",
                             source=folder, joint=" ")
    return next(iter(found), KINDS[0])  # numbered() reports that they are missing


def _match(kind: str, name: str) -> re.Match | None:
    return re.fullmatch(re.escape(kind).replace(r"\{\}", r"(\d+)"), name)


def _bursts(folder: Path, names: list[str]) -> list[list[Path]]:
    """Files of each view, view_K_J.png; K and J are numbered from 0."""
    views = 1 + max(int(match[1]) for name in names if (match := _match(KINDS[1], name)))
    if views > MAX_VIEWS:
        raise InputError(f"has {views} views; a capture has at most {MAX_VIEWS}",
                         source=folder, joint=" ")
    return [numbered(folder, f"view_{k}_{{}}.png", most=MAX_PIXELS) for k in range(views)]


def _median(files: list[Path]) -> np.ndarray:
    """Median (H, W) counts of a view's frames."""
    frames: list[np.ndarray] = []
    for file in files:
        frames.append(read_counts(file))
        if frames[-1].shape != frames[0].shape:
            raise InputError(f"has {_size(frames[-1])} pixels but {files[0].name} has "
                             f"{_size(frames[0])}; all must have one size", source=file, joint=" ")
        if len(files) * frames[0].size > MAX_PIXELS:
            raise InputError(f"a view has {len(files)} frames of "
                             f"{_size(frames[0])} pixels; give at most "
                             f"{MAX_PIXELS // frames[0].size}, leave the others out",
                             source=file.parent)
    return median_depth(np.stack(frames))


def read_picture(file: Path, *, modes: set[str], kind: str) -> np.ndarray:
    """Read a PNG (H, W, ...) whose Pillow mode is one of ``modes``, named ``kind`` in messages."""
    require_regular(file, MAX_FILE_BYTES, "picture")
    with reading(file, "export the view again as PNG"):
        with Image.open(file, formats=["PNG"]) as picture:
            require_size(file, *picture.size)
            if picture.mode not in modes:
                raise InputError(f"is a picture of the mode {picture.mode}; it must be "
                                 f"{kind}: export it as such", source=file, joint=" ")
            picture.verify()  # checksums, which are not checked when pixels are read
        with Image.open(file, formats=["PNG"]) as picture:
            return np.array(picture)


def numbered(folder: Path, pattern: str, *, most: int = MAX_VIEWS) -> list[Path]:
    """Files named ``pattern`` with 0 to K - 1 in place of ``{}``, K from 1 to ``most``."""
    names = {file.name for file in folder.iterdir() if _match(pattern, file.name)}
    if not names:
        others = sorted(file.name for file in folder.iterdir() if file.name != "capture.yaml")
        there = f" (the folder holds {shown(others[0])})" if others else ""
        for name in others:
            if what := _UNREAD.get(Path(name).suffix.lower()):
                raise InputError(f"{shown(name)} is {what}; save depth as 16-bit PNG in "
                                 ".png, metres in .npy or points in .ply; or call a photograph "
                                 "from above outline.jpg", source=folder)
        photograph = ", or a photograph from above outline.jpg" * (pattern == KINDS[0])
        raise InputError(f"{pattern.format(0)} is missing{there}; name the one to "
                         f"{MAX_VIEWS} views {pattern.format(0)}, {pattern.format(1)} and so on"
                         f"{photograph}", source=folder)
    if len(names) > most:
        raise InputError(f"has {len(names)} files {pattern.format('*')}; at most {most} "
                         "are read: leave the others out", source=folder, joint=" ")
    expected = [pattern.format(k) for k in range(len(names))]
    for name in expected:
        if name not in names:
            raise InputError(f"{name} is missing, but {max(names)} exists; number them "
                             "from 0 on", source=folder)
    return [folder / name for name in expected]


def join_views(pictures: Mapping[Path, np.ndarray]) -> np.ndarray:
    """Stack pictures by file (K, H, W); InputError if their sizes differ or two are identical."""
    (start, first), *_ = pictures.items()
    for file, picture in pictures.items():
        if picture.shape != first.shape:
            raise InputError(f"{file.name} has {_size(picture)} pixels but "
                             f"{start.name} has {_size(first)}; all views must have one size",
                             source=file.parent)
    for (file, picture), (copy, same) in itertools.combinations(pictures.items(), 2):
        # Blank pictures are reported by data.captures.capture.
        if np.array_equal(picture, same) and picture.min() < picture.max():
            raise InputError(f"{file.name} and {copy.name} are the same picture; "
                             "each view must be taken after the table has turned on",
                             source=file.parent)
    return np.stack(list(pictures.values()))


def _metres(depth: np.ndarray, file: Path) -> np.ndarray:
    """``depth``, m, with 0 for invalid values."""
    depth = measured(depth)
    valid = depth[depth > 0]
    if valid.size and (middle := float(np.median(valid))) > MAX_DEPTH:
        raise InputError(f"its median depth is {middle:.4g}, which cannot be metres; give "
                         "depth in metres", source=file)
    return depth


def read_array(file: Path) -> DepthImage:
    """Read depth from a NumPy file of floating-point numbers."""
    data = read_bytes(file, MAX_FILE_BYTES, "view")
    content = "one array (height, width) of floating-point numbers, depth in metres"
    with reading(file, f"it must hold {content}: save it with numpy.save"):
        depth = np.lib.format.read_array(io.BytesIO(data))
    if depth.ndim != 2 or depth.dtype.kind != "f" or depth.itemsize > 8:
        raise InputError(f"must hold {content}; it holds {shown(depth.shape)} of "
                         f"{shown(str(depth.dtype))}", source=file, joint=" ")
    require_size(file, *depth.shape[::-1])
    return _metres(depth, file)


def read_exr(file: Path) -> DepthImage:
    """Read depth from an OpenEXR file: channel Z, or the only channel."""
    import OpenEXR

    require_regular(file, MAX_FILE_BYTES, "view")
    with reading(file, "export the view again as an OpenEXR picture"):
        # The size is checked before the pixels are decoded.
        with OpenEXR.File(str(file), header_only=True) as header:
            window = header.header()["dataWindow"]
            width, height = (int(n) for n in np.asarray(window[1]) - np.asarray(window[0]) + 1)
        require_size(file, width, height)
        with OpenEXR.File(str(file), separate_channels=True) as picture:
            channels = {name: np.array(channel.pixels)
                        for name, channel in picture.channels().items()}
    name = next((name for name in channels if name.split(".")[-1] in ("Z", "V")), None)
    if name is None and len(channels) != 1:
        raise InputError(f"has channels {shown(sorted(channels))}; give depth as channel Z",
                         source=file, joint=" ")
    return _metres(channels[name] if name else next(iter(channels.values())), file)


def read_points(file: Path, camera: Intrinsics) -> DepthImage:
    """Project a PLY of points in camera axes to the depth of the nearest point per pixel."""
    import trimesh

    data = read_bytes(file, 64 * MAX_POINTS, "view")
    with reading(file, "export the view again as a PLY of points"):
        (count, *_) = map(int, re.findall(
            rb"^element vertex (\d{1,12})\s*$", data[:65536], re.MULTILINE))
        if count > MAX_POINTS:
            raise InputError(f"{count} points are too many; a view has at most "
                             f"{MAX_POINTS}: reduce the cloud", source=file)
        # From memory, so that files named in the PLY, such as textures, are not read.
        cloud: Any = trimesh.load(io.BytesIO(data), file_type="ply", process=False,
                                  skip_materials=True)
        points = np.asarray(cloud.vertices, dtype=np.float64).reshape(-1, 3)
    depths = _metres(points[:, 2], file)
    visible = np.isfinite(points).all(axis=1) & (depths > 0)
    points, depths = points[visible], depths[visible]
    if not len(points):
        raise InputError("has no point in front of the camera; give camera axes: x right, "
                         "y down, z forward", source=file, joint=" ")
    u = np.rint(camera.fx * points[:, 0] / points[:, 2] + camera.cx)
    v = np.rint(camera.fy * points[:, 1] / points[:, 2] + camera.cy)
    inside = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    if inside.mean() < 0.5:
        raise InputError(f"{1 - inside.mean():.0%} of its points fall outside the picture "
                         "of the intrinsics; give camera axes (x right, y down, z forward), metres",
                         source=file)
    depth = np.full((camera.height, camera.width), np.inf, np.float32)
    np.minimum.at(depth, (v[inside].astype(int), u[inside].astype(int)), depths[inside])
    return np.where(np.isfinite(depth), depth, np.float32(0.0))


def header_of(data: bytes) -> tuple[tuple[int, ...], np.dtype]:
    """Shape and type in the header of an npy file's bytes; any error if it is damaged."""
    version = np.lib.format.read_magic(stream := io.BytesIO(data))
    shape, _, kind = {(1, 0): np.lib.format.read_array_header_1_0,
                      (2, 0): np.lib.format.read_array_header_2_0}[version](stream)
    return shape, kind


def _size(picture: np.ndarray) -> str:
    return f"{picture.shape[1]}x{picture.shape[0]}"
