"""Depth frames from a recording of a table that turns in steps: one frame for each stop.

ROS 1 bags (``.bag``), ROS 2 bags (``.db3``, ``.mcap``, also split, compressed, or a folder with
``metadata.yaml``) and those of RealSense cameras are read with the library rosbags. The table is at
rest if nothing moves for :data:`MIN_REST`; the frame of a stop is the median of the frames in its
middle.
"""

import re
from collections.abc import Iterator, Sequence
from itertools import islice
from operator import itemgetter
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy import ndimage

from common.documents import reading, require_regular
from common.errors import InputError, shown
from common.types import DepthImage, Views
from data.captures.depth import Lens, measured, median_depth, unsaturated
from data.captures.description import MAX_VIEWS, MILLIMETRE, require_size
from data.render.cameras import Intrinsics

MAX_RECORDING_BYTES = 16 << 30  # bytes
MAX_FRAMES = 30_000
MIN_REST = 0.45  # s
MAX_USED_FRAMES = 15  # of a stop, for the median
_NAME = re.compile(r"(.+?)(_\d+)?(\.bag|\.db3|\.mcap)(\.zstd)?")
_METADATA = "metadata.yaml"  # beside the files of a ROS 2 bag
_COMPARED_INTERVAL = 0.25  # s between two frames that are compared
_STRIDE = 2  # of the pixels that are compared
_MAX_DEPTH = 1.5  # m, of compared pixels; noise grows with distance
_MIN_MOTION = 0.012, 0.02  # m and share of the depth: a pixel has moved if both are exceeded
_REST_THRESHOLD = 0.004, 3.0, 0.02
"""Share of moved pixels below which the table rests: lower limit; multiple of the first quartile,
for noisy sensors; upper limit, for a table that never rests."""
_MAX_STOP_CHANGE = 0.01  # share of moved pixels between two rests of the same stop
_PNG = b"\x89PNG"
_DEPTH = ("16uc1", "z16", "32fc1", "mono16")  # encodings of depth
_ALIGNED = ("aligned", "registered", "_to_rgb", "_to_color")
_TRANSPORT = re.compile(r"/(compressed\w*|data)$")  # last part of a topic, of the same pictures
_HEADER = 12  # bytes before ROS's compressed depth: its kind, and A and B of depth = A/(count - B)
_MAX_GROUPS = 10  # groups of three bits of a number in compressed depth


def recordings(folder: Path) -> list[Path]:
    """Files of the recording in the folder of a capture, or in a ROS 2 bag in it; InputError for
    several recordings.
    """
    bags = [inner for inner in sorted(folder.iterdir()) if (inner / _METADATA).exists()]
    named = {file: match for place in (folder, *bags) for file in sorted(place.iterdir())
             if (match := _NAME.fullmatch(file.name))}
    first = {(file.parent, match[1], match.groups()[2:]): file for file, match in named.items()}
    if len(first) > 1:
        one, other = sorted(file.relative_to(folder) for file in list(first.values())[:2])
        raise InputError(f"holds {one} and {other}: give one recording", source=folder, joint=" ")
    return list(named)


def read_recording(
    files: Sequence[Path], unit: float | None = None, *, calibrated: bool = True
) -> tuple[Views, Intrinsics | None, Lens | None]:
    """Read one frame per stop of the table from the files of a recording, and its camera.

    ``unit``: m per count; None: as stored in the recording, or millimetres. ``calibrated``: whether
    the recording must state its camera; otherwise it is ignored.
    """
    file, folder = files[0], files[0].parent
    for part in files:
        require_regular(part, MAX_RECORDING_BYTES, "recording")
    whole = file.suffix != ".bag" and (folder / _METADATA).exists()
    if file.suffix == ".zstd" and not whole:
        raise InputError(f"is compressed; put the {_METADATA} that was recorded with it "
                         "beside it, or unpack it with unzstd", source=file, joint=" ")
    # Imported late: few captures are recordings.
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    remedy = "record depth again, or save its frames as 16-bit PNG"
    with reading(file, remedy), AnyReader([folder] if whole else list(files),
                                          default_typestore=store) as reader:
        topic, camera, lens = _depth_stream(reader, file, calibrated)
        scale = unit or _unit(reader, topic) or MILLIMETRE
        times, moved = _motion(_frames(reader, topic, scale), file)
        stops = _median_frames(_frames(reader, topic, scale), find_rests(times, moved))
    if not 1 <= len(stops) <= MAX_VIEWS:
        raise InputError(f"{len(stops)} stops of the table found; let it rest for a "
                         f"second at each of 1 to {MAX_VIEWS} stops, hands out of the picture",
                         source=file)
    return stops, camera, lens


def find_rests(times: np.ndarray, moved: np.ndarray) -> list[tuple[int, int]]:
    """First and last frame of each rest, from ``times`` (N,), s, and shares ``moved`` (N,)."""
    if len(times) < 2:
        return [(0, 0)] if len(times) else []
    low, factor, high = _REST_THRESHOLD
    limit = float(np.clip(factor * np.quantile(moved, 0.25), low, high))
    spans = ndimage.find_objects(ndimage.label(moved < limit)[0])
    return [(span.start, span.stop - 1) for (span,) in spans
            if times[span.stop - 1] - times[span.start] >= MIN_REST]


def _depth_stream(
    reader: Any, file: Path, calibrated: bool
) -> tuple[str, Intrinsics | None, Lens | None]:
    """Topic, and camera if asked for, of the depth that is nearest to what the sensor measured."""
    infos = _first(reader, "/CameraInfo")
    streams, others = [], []
    for topic, message in _first(reader, "/Image", "/CompressedImage").items():
        kind = (getattr(message, "encoding", None) or message.format).lower()
        # 16-bit grey may be infrared.
        if not kind.startswith(_DEPTH[: 3 + ("depth" in topic.lower())]):
            others.append(f"{topic} {kind}")
            continue
        height, width = _depth(message, MILLIMETRE).shape
        place, name = _TRANSPORT.sub("", topic).rsplit("/", 1)
        beside = [info for at, info in infos.items() if at.startswith(f"{place}/")
                  and (info.height, info.width) == (height, width)]
        matrix, lens = _calibration(beside[0], "rect" in name) if beside else (
            np.zeros(9), np.zeros(0))
        streams.append((("depth" not in topic.lower(), matrix[0] <= 0, np.any(lens),
                         any(word in topic for word in _ALIGNED), ";" in kind, topic),
                        matrix, lens, (width, height), beside))
    if not streams:
        there = f" (it holds {shown(', '.join(others))})" if others else ""
        raise InputError(f"holds no depth pictures{there}; record the depth stream",
                         source=file, joint=" ")
    (*_, topic), (fx, _, cx, _, fy, cy, *_), lens, size, beside = min(streams, key=itemgetter(0))
    if not calibrated:
        return topic, None, None
    if fx <= 0:
        raise InputError(f"no calibrated camera_info of the size of its pictures lies "
                         f"beside {topic}; state intrinsics in capture.yaml", source=file)
    return topic, Intrinsics(float(fx), float(fy), float(cx), float(cy), *size), Lens.of(
        beside[0].distortion_model, lens)


def _calibration(info: Any, rectified: bool) -> tuple[np.ndarray, np.ndarray]:
    """Matrix (9,) and coefficients of distortion that a camera_info states of its pictures."""
    # Field names are upper case in ROS 1.
    matrix, projection, lens = (np.asarray(getattr(info, name, getattr(info, name.upper(), None)))
                                for name in "kpd")
    if rectified and projection[0] > 0:
        return projection.reshape(3, 4)[:, :3].ravel(), np.zeros(0)
    return matrix, lens


def _first(reader: Any, *kinds: str) -> dict[str, Any]:
    """The first message of each topic of types that end in ``kinds``."""
    topics = sorted({item.topic for item in reader.connections if item.msgtype.endswith(kinds)})
    return {topic: message for topic in topics
            for _, message in islice(_messages(reader, topic), 1)}


def _frames(reader: Any, topic: str, unit: float) -> Iterator[tuple[float, DepthImage]]:
    """Time, s, and depth of each picture; ``unit``: m per count."""
    for number, (stamp, message) in enumerate(_messages(reader, topic)):
        if number >= MAX_FRAMES:
            raise InputError(f"the recording has more than {MAX_FRAMES} frames; record the stops "
                             "alone")
        yield 1e-9 * stamp, _depth(message, unit)


def _depth(message: Any, unit: float) -> DepthImage:
    """Depth of a message, whose counts are of ``unit``, m, numbers of metres."""
    if hasattr(message, "encoding"):
        require_size(None, message.width, message.height)
        kind = np.dtype("f4" if message.encoding.lower() == "32fc1" else "u2")
        rows = np.frombuffer(bytes(message.data), np.uint8).reshape(message.height, message.step)
        values = np.ascontiguousarray(rows[:, : kind.itemsize * message.width]).view(
            kind.newbyteorder(">" if message.is_bigendian else "<"))
        return measured(values if kind.kind == "f" else unsaturated(values) * unit)
    data, form = bytes(message.data), message.format.lower()
    counts = _rvl(data[_HEADER:]) if "rvl" in form else _png(data)
    if form.startswith("32fc1"):
        factor, shift = np.frombuffer(data, "<f4", 2, offset=4)
        return measured(np.where(counts > 0, factor / np.maximum(counts - shift, 1e-6), 0))
    return measured(unsaturated(counts) * unit)


def _png(data: bytes) -> np.ndarray:
    """Counts (H, W) uint16 of a PNG with or without a header before it."""
    if (start := data.find(_PNG, 0, 64)) < 0:
        raise ValueError("its compressed depth is neither PNG nor RVL")
    require_size(None, *(int.from_bytes(data[start + at : start + at + 4], "big")
                                     for at in (16, 20)))
    picture = cv2.imdecode(np.frombuffer(data[start:], np.uint8), cv2.IMREAD_UNCHANGED)
    if picture is None or picture.dtype != np.uint16 or picture.ndim != 2:
        raise ValueError("a depth picture is damaged")
    return picture


def _rvl(data: bytes) -> np.ndarray:
    """Counts (H, W) of RVL data (Wilson 2017): lengths of a run of zeros and a run of counts, then
    the differences of these, in groups of three bits and one that states whether more follow.
    """
    width, height = np.frombuffer(data, "<u4", 2).astype(int)
    require_size(None, width, height)
    words = np.frombuffer(data, "<u4", len(data) // 4 - 2, offset=8)
    groups = ((words[:, None] >> np.arange(28, -1, -4, dtype=np.uint32)) & 15).ravel()
    ends = np.flatnonzero(groups < 8)
    starts = np.append(0, ends[:-1] + 1)
    lengths = ends + 1 - starts
    place = np.minimum(np.arange(lengths.sum()) - np.repeat(starts, lengths), _MAX_GROUPS)
    numbers = np.add.reduceat((groups[: len(place)] & 7).astype(np.int64) << (3 * place), starts)
    steps = (numbers >> 1) ^ -(numbers & 1)
    counts, filled = np.zeros(width * height, np.int64), np.zeros(width * height, bool)
    start = at = 0
    while start < len(counts):
        start, length = start + int(numbers[at]), int(numbers[at + 1])
        run, at = slice(start, start + length), at + 2 + length
        counts[run], filled[run], start = steps[at - length : at], True, start + length
    counts[filled] = np.cumsum(counts[filled])
    return counts.reshape(height, width)


def _motion(
    frames: Iterator[tuple[float, DepthImage]], file: Path
) -> tuple[np.ndarray, np.ndarray]:
    """Times (N,), s, and shares (N,) of pixels that moved in the interval before."""
    times: list[float] = []
    moved: list[float] = []
    recent: list[tuple[float, np.ndarray]] = []
    for time, depth in frames:
        small = depth[::_STRIDE, ::_STRIDE]
        if recent and small.shape != recent[0][1].shape:
            raise InputError("the size of its depth pictures changes; record again with "
                             "one resolution", source=file)
        while len(recent) > 1 and time - recent[1][0] >= _COMPARED_INTERVAL:
            recent.pop(0)
        times.append(time)
        moved.append(_moved_share(small, recent[0][1]) if recent else 0.0)
        recent.append((time, small))
    return np.array(times), np.array(moved)


def _moved_share(later: DepthImage, earlier: DepthImage) -> float:
    near = (later > 0) & (earlier > 0) & (np.minimum(later, earlier) < _MAX_DEPTH)
    gap = np.abs(later - earlier) > np.maximum(_MIN_MOTION[0], _MIN_MOTION[1] * later)
    return float((near & gap).sum() / max(near.sum(), 1))


def _median_frames(
    frames: Iterator[tuple[float, DepthImage]], stops: list[tuple[int, int]]
) -> Views:
    """The median of each stop's middle frames, without zeros."""
    wanted: dict[int, int] = {}
    for stop, (first, last) in enumerate(stops):
        # Motion continues at the edges of a rest.
        inner = np.linspace(first + 0.3 * (last - first), last - 0.1 * (last - first),
                            MAX_USED_FRAMES)
        wanted |= {int(number): stop for number in np.unique(inner.round())}
    kept: list[list[np.ndarray]] = [[] for _ in stops]
    for number, (_, depth) in enumerate(frames):
        if number in wanted:
            kept[wanted[number]].append(depth)
    medians: list[np.ndarray] = []
    for pictures in kept:
        median = median_depth(np.stack(pictures))
        if not medians or _moved_share(median, medians[-1]) > _MAX_STOP_CHANGE:
            medians.append(median)
    return np.stack(medians) if medians else np.zeros((0, 1, 1), np.float32)


def _messages(reader: Any, topic: str) -> Iterator[tuple[int, Any]]:
    """Time, ns, and content of each message of a topic."""
    chosen = [item for item in reader.connections if item.topic == topic]
    for connection, stamp, raw in reader.messages(connections=chosen) if chosen else ():
        yield stamp, reader.deserialize(raw, connection.msgtype)


def _unit(reader: Any, topic: str) -> float | None:
    """m per count in RealSense recordings; newer ones store it as text."""
    head = "/".join(topic.split("/")[:3])
    for _, message in _messages(reader, f"{head}/option/Depth_Units/value"):
        unit = float(message.data)
        return unit if 1e-6 < unit < 1e-1 else None
    return None
