"""A recording of a turntable with a drape: the frames, and bags that hold them.

``recordings/turntable.db3`` was made by the recorder of librealsense 2.59 (pyrealsense2) from a
device in software with one depth sensor (Z16, units of 1 mm, no distortion) that was given these
frames, ten a second.
"""

from pathlib import Path

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
              lens: float = 0.0) -> None:
    """A ROS 1 bag with the topics of older RealSense recordings."""
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
        header(0), height, width, "plumb_bob", np.full(5, lens), matrix, np.eye(3).ravel(),
        np.zeros(12), 0, 0, region)
    with Writer(file) as writer:
        def add(topic: str, kind: str, messages: list) -> None:
            connection = writer.add_connection(f"{head}/{topic}", kind, typestore=store)
            for k, message in enumerate(messages):
                writer.write(connection, int(k / RATE * 1e9), store.serialize_ros1(message, kind))

        add("option/Depth_Units/value", "std_msgs/msg/Float32",
            [types["std_msgs/msg/Float32"](unit)])
        add("Depth_0/info/camera_info", "sensor_msgs/msg/CameraInfo", [info])
        add("Depth_0/image/data", "sensor_msgs/msg/Image", [types["sensor_msgs/msg/Image"](
            header(k), height, width, "mono16", 0, 2 * width,
            frame.astype("<u2").view(np.uint8).ravel()) for k, frame in enumerate(frames)])
