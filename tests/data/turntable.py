"""A recording of a turntable with a drape: the frames, and bags that hold them.

``recordings/turntable.db3`` was made by the recorder of librealsense 2.59 (pyrealsense2) from a
device in software with one depth sensor (Z16, units of 1 mm, no distortion) that was given these
frames, ten a second.
"""

import struct
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from data.render.cameras import Intrinsics

RATE = 10.0  # frames a second
REST, MOVE = 9, 3  # frames of a stop, and between two
STOPS = np.radians([0.0, 90.0, 180.0, 270.0])
SIZE = (120, 90)
FILE = Path(__file__).parent / "recordings" / "turntable.db3"


def turntable() -> tuple[np.ndarray, np.ndarray, Intrinsics]:
    """Counts (N, H, W) uint16 in mm, of which the stops' are (4, H, W), and the intrinsics."""
    from cloths import skirt

    from data.render.scenes import raw_scene
    from sim.rig import Rig

    drape = skirt()
    between = [np.linspace(one, one + np.pi / 2, MOVE + 2)[1:-1] for one in STOPS[:-1]]
    turns = np.concatenate([STOPS, *between])
    scene = raw_scene(drape.positions, drape.faces, np.random.default_rng(2), rig=Rig(),
                      turns=turns, sensor="none", clutter="empty")
    frames = np.rint(1e3 * scene.frames[:, ::2, ::2]).astype(np.uint16)
    order = [k for stop in range(len(STOPS)) for k in [stop] * REST + list(range(
        len(STOPS) + MOVE * stop, len(STOPS) + MOVE * stop + MOVE * (stop < len(STOPS) - 1)))]
    shown = frames[order]
    rng = np.random.default_rng(0)  # a sensor's pixels come and go
    shown[rng.random(shown.shape) < 0.01] = 0
    camera = scene.camera
    width, height = SIZE
    return shown, frames[: len(STOPS)], Intrinsics(
        fx=camera.fx / 2, fy=camera.fy / 2, cx=camera.cx / 2, cy=camera.cy / 2, width=width,
        height=height)


def write_bag(file: Path, frames: np.ndarray, intrinsics: Intrinsics, *, unit: float = 1e-3,
              start: int = 0) -> None:
    """A ROS 1 bag with the topics of older RealSense recordings; ``start``: of its frames."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    types, head = store.types, "/device_0/sensor_0"
    time = types["builtin_interfaces/msg/Time"]
    region = types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    height, width = frames.shape[1:]

    def header(k: int) -> object:
        return types["std_msgs/msg/Header"](k, time(k // 10, k % 10 * 10**8), "depth")

    matrix = np.array([intrinsics.fx, 0, intrinsics.cx, 0, intrinsics.fy, intrinsics.cy, 0, 0, 1.0])
    info = types["sensor_msgs/msg/CameraInfo"](
        header(0), height, width, "plumb_bob", np.zeros(5), matrix, np.eye(3).ravel(),
        np.zeros(12), 0, 0, region)
    with Writer(file) as writer:
        def add(topic: str, kind: str, messages: list) -> None:
            connection = writer.add_connection(f"{head}/{topic}", kind, typestore=store)
            for k, message in enumerate(messages):
                writer.write(connection, int((start + k) / RATE * 1e9),
                             store.serialize_ros1(message, kind))

        add("option/Depth_Units/value", "std_msgs/msg/Float32",
            [types["std_msgs/msg/Float32"](unit)])
        add("Depth_0/info/camera_info", "sensor_msgs/msg/CameraInfo", [info])
        add("Depth_0/image/data", "sensor_msgs/msg/Image", [types["sensor_msgs/msg/Image"](
            header(k), height, width, "mono16", 0, 2 * width,
            frame.astype("<u2").view(np.uint8).ravel()) for k, frame in enumerate(frames)])


def counts16(frame: np.ndarray) -> dict:
    """The fields of a picture of 16-bit counts of millimetres."""
    return {"encoding": "16UC1", "data": frame.astype("<u2")}


def metres(frame: np.ndarray) -> dict:
    """The fields of a picture of metres, not a number where depth is missing."""
    return {"encoding": "32FC1", "data": np.where(frame > 0, 1e-3 * frame, np.nan).astype("<f4")}


def packed(kind: str, codec: str) -> Callable[[np.ndarray], dict]:
    """Fields of a compressed picture of ``kind``; floating-point depth as counts of its inverse."""
    def fields(frame: np.ndarray) -> dict:
        factor, shift = 101.0, 0.5
        counts = frame
        if kind == "32FC1":
            counts = np.rint(factor / np.maximum(1e-3 * frame, 1e-3) + shift) * (frame > 0)
        counts = counts.astype(np.uint16)
        data = rvl(counts) if codec == "rvl" else cv2.imencode(".png", counts)[1].tobytes()
        head = struct.pack("<iff", 0, factor, shift)
        return {"format": f"{kind}; compressedDepth {codec}",
                "data": np.frombuffer(head + data, np.uint8)}

    return fields


def rvl(counts: np.ndarray) -> bytes:
    """Counts (H, W) compressed as published by Wilson 2017, written from its description."""
    groups: list[int] = []

    def put(number: int) -> None:
        while number > 7:
            groups.append(8 | (number & 7))
            number >>= 3
        groups.append(number)

    flat, at, before = [int(count) for count in counts.ravel()], 0, 0
    while at < len(flat):
        zeros = next((k for k, count in enumerate(flat[at:]) if count), len(flat) - at)
        at += zeros
        run = next((k for k, count in enumerate(flat[at:]) if not count), len(flat) - at)
        put(zeros)
        put(run)
        for count in flat[at : at + run]:
            step, before = count - before, count
            put(2 * step if step >= 0 else -2 * step - 1)
        at += run
    groups += [0] * (-len(groups) % 8)
    words = [int("".join(f"{group:x}" for group in groups[k : k + 8]), 16)
             for k in range(0, len(groups), 8)]
    return struct.pack("<II", *counts.shape[::-1]) + np.array(words, "<u4").tobytes()


def write_bag2(
    folder: Path, streams: dict[str, tuple], *, storage: str = "sqlite3", compression: str = ""
) -> None:
    """A ROS 2 bag: pictures (N, H, W) in mm, the function that makes fields of them, and the fields
    of the camera_info beside them, or None, by topic.
    """
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    time = types["builtin_interfaces/msg/Time"]
    region = types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    writer = Writer(folder, version=9, storage_plugin=StoragePlugin[storage.upper()])
    if compression:
        writer.set_compression(CompressionMode[compression.upper()], CompressionFormat.ZSTD)
    with writer:
        def add(topic: str, kind: str, messages: list) -> None:
            connection = writer.add_connection(topic, f"sensor_msgs/msg/{kind}", typestore=store)
            for k, fields in enumerate(messages):
                stamp = int(k / RATE * 1e9)
                header = types["std_msgs/msg/Header"](time(0, stamp % 10**9), "depth")
                message = types[connection.msgtype](header=header, **fields)
                writer.write(connection, stamp, store.serialize_cdr(message, connection.msgtype))

        for topic, (frames, fields, info) in streams.items():
            height, width = frames.shape[1:]
            pictures = [fields(frame) for frame in frames]
            if "format" in pictures[0]:
                add(topic, "CompressedImage", pictures)
            else:
                add(topic, "Image", [
                    {"height": height, "width": width, "is_bigendian": 0,
                     "step": width * picture["data"].itemsize} | picture
                    | {"data": picture["data"].view(np.uint8).ravel()} for picture in pictures])
            if info is not None:
                place = topic.removesuffix("/compressedDepth").rsplit("/", 1)[0]
                add(f"{place}/camera_info", "CameraInfo", [
                    {"height": height, "width": width, "binning_x": 0, "binning_y": 0,
                     "roi": region, "r": np.eye(3).ravel()} | info])


def camera_info(camera: Intrinsics, *, lens: tuple[float, ...] = (), model: str = "plumb_bob",
                projected: float = 0.0) -> dict:
    """Fields of a camera_info; ``projected``: focal length of the rectified picture, or 0."""
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])
    projection = np.zeros((3, 4))
    projection[:, :3] = matrix if projected else 0
    projection[[0, 1], [0, 1]] = projected
    return {"distortion_model": model, "d": np.array(lens, float), "k": matrix.ravel(),
            "p": projection.ravel()}
