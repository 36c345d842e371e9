"""That pictures and noise stay on a GPU, on machines without one: see test_batched_devices.py."""

import pytest
import torch
from torch._subclasses.fake_tensor import FakeTensorMode
from torch.fx.experimental.symbolic_shapes import ShapeEnv

from data.render import rasterise, sensor_noise, structured_light, time_of_flight
from data.render.cameras import CameraRig
from data.render.sensor import load_sensor

HEIGHT, WIDTH = 60, 80
GPU = torch.device("cuda", 0)


@pytest.fixture
def fake(monkeypatch):
    """Tensors without data; what asks for data is replaced by as much of something."""

    def copies(counts):
        return (torch.zeros(7, dtype=torch.int64, device=counts.device),) * 2

    def deviates(shape, like, generator):
        return torch.empty(shape, dtype=like.dtype, device=like.device)

    monkeypatch.setattr(rasterise, "_copies", copies)
    monkeypatch.setattr(sensor_noise, "cloth_window",
                        lambda views, reach: (slice(0, HEIGHT), slice(0, WIDTH)))
    monkeypatch.setattr(structured_light, "_interpolation",
                        lambda length, spacing: torch.ones(length, 5))
    for module in (sensor_noise, structured_light, time_of_flight):
        for name in ("normal", "uniform"):
            if hasattr(module, name):
                monkeypatch.setattr(module, name, deviates)
    shapes = ShapeEnv(allow_scalar_outputs=True, allow_dynamic_output_shape_ops=True)
    with FakeTensorMode(allow_non_fake_inputs=True, shape_env=shapes):
        yield


@pytest.mark.usefixtures("fake")
@pytest.mark.parametrize("name", ["smooth", "tof", "paper"])
def test_views_with_noise_stay_on_the_gpu(name):
    camera = CameraRig.load().nominal()
    intrinsics, poses = rasterise.camera_tensors([camera, camera], device="cuda")
    points = rasterise.camera_points(torch.zeros(2, 50, 3, device="cuda"),
                                     torch.zeros(2, 4, device="cuda"), poses)
    views = rasterise.rasterise_tensors(
        points, torch.zeros(2, 30, 3, dtype=torch.int64, device="cuda"),
        intrinsics[:, None].to(points.dtype).expand(2, 4, 4), height=HEIGHT, width=WIDTH)
    noisy = load_sensor(name)(views, intrinsics, None)
    assert views.device == noisy.device == GPU and noisy.shape == (2, 4, HEIGHT, WIDTH)
