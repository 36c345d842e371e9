"""Depth frames from a recording of a table that turns in steps: one frame for each stop.

RealSense's ``.bag`` and ``.db3``, and other ROS 1 and 2 bags with a topic of 16-bit depth, are read
with the library rosbags. The table is at rest if nothing moves for :data:`MIN_REST`; the frame of a
stop is the median of the frames in its middle.
"""

from collections.abc import Iterator
from os.path import commonprefix
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy import ndimage

from common.documents import reading, require_regular
from common.errors import InputError
from common.types import DepthImage, Views
from data.captures.description import MAX_VIEWS, MILLIMETRE, require_size
from data.render.cameras import Intrinsics

SUFFIXES = (".bag", ".db3")
MAX_RECORDING_BYTES = 16 << 30  # bytes
MAX_FRAMES = 30_000
MIN_REST = 0.45  # s
MAX_USED_FRAMES = 15  # of a stop, for the median
_COMPARED_INTERVAL = 0.25  # s between two frames that are compared
_STRIDE = 2  # of the pixels that are compared
_MAX_DEPTH = 1.5  # m, of compared pixels; noise grows with distance
_MIN_MOTION = 0.012, 0.02  # m and share of the depth: a pixel has moved if both are exceeded
_REST_THRESHOLD = 0.004, 3.0, 0.02
"""Share of moved pixels below which the table rests: lower limit; multiple of the first quartile,
for noisy sensors; upper limit, for a table that never rests."""
_MAX_STOP_CHANGE = 0.01  # share of moved pixels between two rests of the same stop
_PNG = b"\x89PNG"
_DEPTH16 = ("mono16", "16uc1", "z16")
_MAX_DISTORTION = 1e-3  # coefficient of negligible lens distortion


def read_recording(file: Path, unit: float | None = None) -> tuple[Views, Intrinsics | None]:
    """Read one frame per stop of the table, and intrinsics if stored.

    ``unit``: m per count; None: as stored in the recording, or millimetres.
    """
    require_regular(file, MAX_RECORDING_BYTES, "recording")
    # Imported late: few captures are recordings.
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    remedy = "record depth again, or save its frames as 16-bit PNG"
    with reading(file, remedy), AnyReader([file], default_typestore=store) as reader:
        topic = _depth_topic(reader, file)
        scale = unit or _unit(reader, topic) or MILLIMETRE
        times, moved = _motion(_frames(reader, topic), scale, file)
        stops = _median_frames(_frames(reader, topic), find_rests(times, moved), scale)
        intrinsics = _camera(reader, topic, stops.shape[1:], file)
    if not 1 <= len(stops) <= MAX_VIEWS:
        raise InputError(f"{file}: {len(stops)} stops of the table found; let it rest for a "
                         f"second at each of 1 to {MAX_VIEWS} stops, hands out of the picture")
    return stops * np.float32(scale), intrinsics


def find_rests(times: np.ndarray, moved: np.ndarray) -> list[tuple[int, int]]:
    """First and last frame of each rest, from ``times`` (N,), s, and shares ``moved`` (N,)."""
    if len(times) < 2:
        return [(0, 0)] if len(times) else []
    low, factor, high = _REST_THRESHOLD
    limit = float(np.clip(factor * np.quantile(moved, 0.25), low, high))
    spans = ndimage.find_objects(ndimage.label(moved < limit)[0])
    return [(span.start, span.stop - 1) for (span,) in spans
            if times[span.stop - 1] - times[span.start] >= MIN_REST]


def _depth_topic(reader: Any, file: Path) -> Any:
    """Connection of the depth topic."""
    pictures = [connection for connection in reader.connections if "epth" in connection.topic
                and connection.msgtype.endswith(("/Image", "/CompressedImage"))]
    if not pictures:
        raise InputError(f"{file} holds no depth pictures; record the depth stream")
    return min(pictures, key=lambda connection: connection.topic)


def _frames(reader: Any, topic: Any) -> Iterator[tuple[float, np.ndarray]]:
    """Time, s, and counts (H, W) uint16 of each depth picture."""
    for number, (_, stamp, raw) in enumerate(reader.messages(connections=[topic])):
        if number >= MAX_FRAMES:
            raise InputError(f"the recording has more than {MAX_FRAMES} frames; record the stops "
                             "alone")
        yield 1e-9 * stamp, _counts(reader.deserialize(raw, topic.msgtype))


def _counts(message: Any) -> np.ndarray:
    if hasattr(message, "encoding"):
        if message.encoding.lower() not in _DEPTH16:
            raise InputError(f"depth of kind {message.encoding[:20]} is not read; record 16-bit "
                             "depth")
        require_size("depth pictures", message.width, message.height)
        order = ">u2" if message.is_bigendian else "<u2"
        rows = np.frombuffer(bytes(message.data), np.uint8).reshape(message.height, message.step)
        return np.ascontiguousarray(rows[:, : 2 * message.width]).view(order).astype(np.uint16)
    data = bytes(message.data)
    start = data.find(_PNG, 0, 64)  # after the header of ROS's compressed depth
    if start < 0 or "16uc1" not in message.format.lower():
        raise InputError(f"depth of kind {message.format[:40]} is not read; record 16-bit depth")
    require_size("depth pictures", *(int.from_bytes(data[start + at : start + at + 4], "big")
                                     for at in (16, 20)))
    picture = cv2.imdecode(np.frombuffer(data[start:], np.uint8), cv2.IMREAD_UNCHANGED)
    if picture is None or picture.dtype != np.uint16 or picture.ndim != 2:
        raise ValueError("a depth picture is damaged")
    return picture


def _motion(
    frames: Iterator[tuple[float, np.ndarray]], scale: float, file: Path
) -> tuple[np.ndarray, np.ndarray]:
    """Times (N,), s, and shares (N,) of pixels that moved in the interval before."""
    times: list[float] = []
    moved: list[float] = []
    recent: list[tuple[float, np.ndarray]] = []
    for time, counts in frames:
        small = counts[::_STRIDE, ::_STRIDE].astype(np.float32) * np.float32(scale)
        if recent and small.shape != recent[0][1].shape:
            raise InputError(f"{file}: the size of its depth pictures changes; record again with "
                             "one resolution")
        while len(recent) > 1 and time - recent[1][0] >= _COMPARED_INTERVAL:
            recent.pop(0)
        times.append(time)
        moved.append(_moved_share(small, recent[0][1]) if recent else 0.0)
        recent.append((time, small))
    if not times:
        raise InputError(f"{file} holds no depth pictures; record the depth stream")
    return np.array(times), np.array(moved)


def _moved_share(later: DepthImage, earlier: DepthImage) -> float:
    near = (later > 0) & (earlier > 0) & (np.minimum(later, earlier) < _MAX_DEPTH)
    gap = np.abs(later - earlier) > np.maximum(_MIN_MOTION[0], _MIN_MOTION[1] * later)
    return float((near & gap).sum() / max(near.sum(), 1))


def _median_frames(
    frames: Iterator[tuple[float, np.ndarray]], stops: list[tuple[int, int]], scale: float
) -> np.ndarray:
    """(K, H, W) float32 counts: the median of each stop's middle frames, without zeros."""
    wanted = {}
    for stop, (first, last) in enumerate(stops):
        # Motion continues at the edges of a rest.
        inner = np.linspace(first + 0.3 * (last - first), last - 0.1 * (last - first),
                            MAX_USED_FRAMES)
        wanted |= {int(number): stop for number in np.unique(inner.round())}
    kept: list[list[np.ndarray]] = [[] for _ in stops]
    for number, (_, counts) in enumerate(frames):
        if number in wanted:
            kept[wanted[number]].append(counts)
    medians: list[np.ndarray] = []
    for pictures in kept:
        median = median_depth(np.stack(pictures))
        if not medians or _moved_share(scale * median, scale * medians[-1]) > _MAX_STOP_CHANGE:
            medians.append(median)
    return np.stack(medians) if medians else np.zeros((0, 1, 1), np.float32)


def median_depth(frames: np.ndarray) -> np.ndarray:
    """Median (H, W) float32 of frames (N, H, W) per pixel, without zeros (missing depth)."""
    measured = np.ma.masked_equal(frames.astype(np.float32), 0.0)
    return np.ma.filled(np.ma.median(measured, axis=0), 0.0)


def _messages(reader: Any, topic: str) -> Iterator[Any]:
    connections = [item for item in reader.connections if item.topic == topic]
    for connection, _, raw in reader.messages(connections=connections) if connections else ():
        yield reader.deserialize(raw, connection.msgtype)


def _unit(reader: Any, topic: Any) -> float | None:
    """m per count in RealSense recordings; newer ones store it as text."""
    head = "/".join(topic.topic.split("/")[:3])
    for message in _messages(reader, f"{head}/option/Depth_Units/value"):
        unit = float(message.data)
        return unit if 1e-6 < unit < 1e-1 else None
    return None


def _camera(reader: Any, topic: Any, shape: tuple[int, ...], file: Path) -> Intrinsics | None:
    """Intrinsics of the camera_info whose topic has the longest common prefix with the pictures'.
    """
    def common(name: str) -> int:
        return len(commonprefix([name, topic.topic]))  # noqa: RUF071 (topics are no paths)

    infos = [item.topic for item in reader.connections if item.msgtype.endswith("/CameraInfo")]
    for message in _messages(reader, max(infos, key=common)) if infos else ():
        # Field names are upper case in ROS 1.
        matrix, lens = (np.asarray(getattr(message, name, getattr(message, name.upper(), None)))
                        for name in ("k", "d"))
        if (message.height, message.width) != tuple(shape):
            return None
        if lens.size and np.abs(lens).max() > _MAX_DISTORTION:
            raise InputError(f"{file}: the lens distortion {np.abs(lens).max():.3g} exceeds "
                             f"{_MAX_DISTORTION:g}; record undistorted depth")
        fx, _, cx, _, fy, cy = (float(value) for value in matrix.ravel()[:6])
        return Intrinsics(fx=fx, fy=fy, cx=cx, cy=cy, width=int(message.width),
                          height=int(message.height))
    return None
