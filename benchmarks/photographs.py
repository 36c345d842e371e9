"""Drapes seen by a camera beside its nominal place, with a sensor's noise, as a capture is."""

from typing import TYPE_CHECKING

import numpy as np

from data.cameras import Camera, CameraRig

if TYPE_CHECKING:
    from sim.drape import DrapeResult


def place(rng: np.random.Generator) -> tuple[Camera, float]:
    """A camera, and the turn of the specimen in its first view, rad."""
    return CameraRig.load().sample(rng), float(rng.uniform(0, 2 * np.pi))


def photographed(
    shape: "DrapeResult", camera: Camera, turn: float, *, sensor: str, seed: int
) -> np.ndarray:
    """Views (4, H, W), z-depth, m, with the noise of ``sensor``, a file of configs/sensor."""
    import torch

    from data.rasterise import camera_tensors
    from data.render import render_views
    from data.sensor import load_sensor

    views = torch.from_numpy(render_views(shape.positions, shape.faces, camera, turn))
    intrinsics, _ = camera_tensors([camera])
    generator = torch.Generator().manual_seed(seed)
    return load_sensor(sensor)(views, intrinsics[0], generator).numpy()
