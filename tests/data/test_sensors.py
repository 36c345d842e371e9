"""Noise models of sensors: what they change, how much, and what they leave alone."""

import math

import numpy as np
import pytest
import torch

from data.render.cameras import Intrinsics
from data.render.sensors import (
    EDGE_STEP,
    EIGHTHS_OF_DISPARITY,
    Sensor,
    StructuredLight,
    TimeOfFlight,
    cloth_window,
    correlated_normal,
    load_sensor,
    remap_depth,
)

STILL = StructuredLight(
    shift_px=0, affine_scale_percent=0, affine_turn_deg=0, affine_shift_px=0,
    eight_bit_probability=0,
)  # fmt: skip
INTRINSICS = Intrinsics(305.0, 305.0, 59.5, 44.5, 120, 90)


def slanted(height: int = 90, width: int = 120, slope: float = 0.001) -> np.ndarray:
    """A plane that gets deeper downwards, metres per pixel, amid background."""
    view = np.zeros((height, width), dtype=np.float32)
    rows = np.arange(20, height - 20)
    view[20:-20, 20:-20] = (0.5 + slope * (rows - 20))[:, None]
    return view


def noisy(noise: Sensor, views: np.ndarray, seed: int = 7) -> np.ndarray:
    """Pictures (..., K, H, W), or one (H, W), with noise."""
    return noise(np.atleast_3d(views.T).T, INTRINSICS, seed).reshape(views.shape)


def test_no_strength_changes_nothing():
    views = np.stack([slanted()] * 4)
    for noise in (StructuredLight(strength=0, eight_bit_probability=1), load_sensor("none"),
                  TimeOfFlight(strength=0)):
        result = noise(views, INTRINSICS, 0)
        assert np.array_equal(result, views) and result is not views
    view = plane(tilt_deg=50)
    view[:, :, :40] = 0
    torch.testing.assert_close(measured(NOTHING, view)[0], view, rtol=0, atol=1e-7)


@pytest.mark.parametrize("name", ["smooth", "paper", "tof"])
def test_seed_decides(name):
    views = np.stack([slanted()] * 4)
    noise = load_sensor(name)
    assert (noisy(noise, views) == noisy(noise, views)).all()
    assert (noisy(noise, views) != noisy(noise, views, seed=8)).any()


def test_depth_comes_in_steps_of_an_eighth_of_a_pixel():
    result = noisy(STILL, slanted())
    steps = EIGHTHS_OF_DISPARITY / result[result > 0].astype(float)
    assert np.abs(steps - np.rint(steps)).max() < 1e-3
    assert ((result > 0) == (slanted() > 0)).all()


@pytest.mark.parametrize("depth", [0.4, 0.53, 0.8])
def test_disparity_noise_has_its_spread_and_no_bias(depth):
    # So the variance of depth grows as its fourth power.
    view = np.full((300, 300), depth, dtype=np.float32)
    result = noisy(STILL, view).astype(float)
    steps = EIGHTHS_OF_DISPARITY / result - EIGHTHS_OF_DISPARITY / depth
    spread = noisy(STILL.model_copy(update={"disparity_px": 0.25}), view).astype(float)
    wide = EIGHTHS_OF_DISPARITY / spread - EIGHTHS_OF_DISPARITY / depth
    assert abs(steps).max() < 1.5
    assert wide.std() == pytest.approx(np.hypot(2.0, np.sqrt(1 / 12)), rel=0.02)
    assert abs(wide.mean()) < 0.03


@pytest.mark.parametrize("correlation", [1.0, 6.0])
def test_shift_shows_as_slope_times_its_spread(correlation):
    view = slanted(height=200, width=300, slope=0.002)
    noise = STILL.model_copy(update={"shift_px": 0.5, "shift_correlation_px": correlation,
                                     "disparity_px": 0})
    error = (noisy(noise, view) - view)[25:-25, 25:-25].astype(float)
    # 1 mm from the shift, 0.8 mm / sqrt(12) or more (deeper) from the steps.
    step = (view[25:-25, 25:-25].astype(float) ** 2 / EIGHTHS_OF_DISPARITY).mean()
    assert error.std() == pytest.approx(np.hypot(0.001, step / np.sqrt(12)), rel=0.12)
    along = (error[:, 1:] * error[:, :-1]).mean() / error.var()
    assert along > 0.6 if correlation > 1 else abs(along) < 0.1


def test_cloth_never_mixes_with_background_or_a_farther_fold():
    view = slanted(slope=0)
    view[20:-20, 60:100] = 0.6
    noise = StructuredLight(strength=2.0, eight_bit_probability=0)
    result = noisy(noise, np.stack([view] * 8))
    depth = result[result > 0]
    assert (np.minimum(abs(depth - 0.5), abs(depth - 0.6)) < 0.004).all()
    # Background stays background but within a few pixels of the cloth.
    far = np.ones_like(view, dtype=bool)
    far[8:-8, 8:-8] = False
    assert not result[:, far].any()


def test_affine_change_moves_each_picture_by_about_its_shift():
    view = slanted(slope=0)
    noise = STILL.model_copy(update={"affine_shift_px": 1.5, "disparity_px": 0})
    result = noisy(noise, np.stack([view] * 400))
    columns = np.arange(120)
    centres = np.array([(v > 0).sum(axis=0) @ columns / (v > 0).sum() for v in result])
    # Silhouettes follow in whole pixels.
    assert centres.std() == pytest.approx(np.hypot(1.5, np.sqrt(1 / 12)), rel=0.1)
    assert abs(centres.mean() - 59.5) < 0.3


def test_part_of_the_captures_have_eight_bit_steps_in_all_their_views():
    noise = StructuredLight(eight_bit_probability=0.25)
    result = noisy(noise, np.broadcast_to(slanted(50, 50), (200, 2, 50, 50)).copy())
    counts = result.astype(float) * 255
    coarse = np.abs(counts - np.rint(counts)).max(axis=(2, 3)) < 1e-4
    assert (coarse[:, 0] == coarse[:, 1]).all()
    assert 30 < coarse[:, 0].sum() < 70  # 50, give or take three standard deviations


def test_default_is_as_calm_as_the_published_captures():
    # A plane as steep in the picture as the plate: 2.2 mm a row. Theirs is 0.29 counts, where
    # pure quantisation is 0.289.
    view = slanted(height=80, width=80, slope=0.0022)
    assert load_sensor("smooth") == StructuredLight()
    noise = load_sensor("smooth").model_copy(
        update={"eight_bit_probability": 1.0, "affine_shift_px": 0})
    error = (noisy(noise, np.stack([view] * 20)) - view)[:, 25:-25, 25:-25] * 255
    error -= error.mean(axis=(1, 2), keepdims=True)
    assert 0.28 < error.std() < 0.36


@pytest.mark.parametrize("name", ["smooth", "tof"])
def test_cloth_at_the_border_and_empty_pictures(name):
    full = np.full((40, 50), 0.5, dtype=np.float32)
    noise = load_sensor(name).model_copy(update={"hole_percent": 0} if name == "tof" else {})
    result = noisy(noise, full)
    assert result.shape == full.shape and (result[5:-5, 5:-5] > 0).all()
    assert not noisy(noise, np.zeros((4, 40, 50), dtype=np.float32)).any()


def test_the_window_holds_all_cloth_and_its_reach():
    views = torch.zeros(2, 3, 40, 50)
    views[0, 1, 10:12, 30] = 0.5
    views[1, 2, 20, 4] = 0.5
    assert cloth_window(views, 0) == (slice(10, 21), slice(4, 31))
    assert cloth_window(views, 5.5) == (slice(4, 27), slice(0, 37))
    assert cloth_window(views[:, :1], 5.5)[0] == slice(0, 0)


def test_linear_surfaces_are_reproduced_between_pixels_and_silhouettes_mix_nothing():
    v, u = np.mgrid[:20, :30].astype(float)
    places = u[2:-2, 2:-2] + 0.37, v[2:-2, 2:-2] - 0.81
    slopes = np.array([0.002, -0.003])
    depth = (0.5 + np.tensordot(slopes, [u, v], 1)).astype(np.float32)
    shifted = remap_depth(*map(torch.from_numpy, (depth, *places))).numpy()
    assert np.abs(shifted - (0.5 + np.tensordot(slopes, places, 1))).max() < 1e-6
    depth[:] = 0
    depth[:, 3:6], depth[:, 6:9] = 0.5, 0.5 + 3 * EDGE_STEP
    near, next_one = (remap_depth(*map(torch.from_numpy, (depth, u + step, v))).numpy()
                      for step in (0.4, 0.6))
    assert (near == depth).all() and (next_one[:, :-1] == depth[:, 1:]).all()


NOTHING = TimeOfFlight(
    axial_mm=0, bias_mm=0, scale_percent=0, edge_invalid_least=0, edge_invalid_most=0,
    edge_blend=0, grazing_invalid=0, hole_percent=0, step_mm=0,
)  # fmt: skip
F, SIZE = 300.0, 120
MIDDLE = Intrinsics(F, F, (SIZE - 1) / 2, (SIZE - 1) / 2, SIZE, SIZE)


def plane(depth: float = 0.5, tilt_deg: float = 0.0) -> torch.Tensor:
    """A plane across the whole picture (1, H, W), turned about the picture's vertical axis."""
    x = (torch.arange(SIZE) - (SIZE - 1) / 2) / F
    view = depth / (1 - x * math.tan(math.radians(tilt_deg)))
    return view.expand(1, SIZE, SIZE).clone()


def measured(noise: Sensor, views: torch.Tensor, *, captures: int = 1) -> torch.Tensor:
    """Noisy copies (captures, K, H, W)."""
    return torch.from_numpy(noise(views.expand(captures, *views.shape).numpy(), MIDDLE, 3))


@pytest.mark.parametrize(("exponent", "power"), [(0.5, 1.0), (1.0, 2.0)])
def test_random_error_grows_with_distance(exponent, power):
    noise = NOTHING.model_copy(update={"axial_mm": 0.6, "signal_exponent": exponent})
    for depth in (0.5, 0.8, 1.5):
        # Near the picture's middle incidence is normal.
        error = (measured(noise, plane(depth), captures=20) - depth)[..., 40:80, 40:80]
        assert error.std().item() == pytest.approx(0.6e-3 * (depth / 0.5) ** power, rel=0.04)
        assert abs(error.mean().item()) < 0.1 * error.std().item()


@pytest.mark.parametrize(("tilt", "middle", "place"), [
    (0.0, 59.5, 59.5), (60.0, 59.5, 59.5), (75.0, 59.5, 59.5),
    (0.0, 15.0, 115.5)])  # at right angles to the axis, seen 19 degrees aside
def test_random_error_grows_with_incidence_from_the_ray(tilt, middle, place):
    view = plane(0.5, tilt)
    noise = NOTHING.model_copy(update={"axial_mm": 0.6})
    camera = Intrinsics(F, F, middle, (SIZE - 1) / 2, SIZE, SIZE)
    strip = slice(int(place - 2.5), int(place + 3.5))
    errors = (noise(view.expand(200, 1, SIZE, SIZE).numpy(), camera, 3) - view.numpy())[..., strip]
    cosine = math.cos(math.radians(tilt) + math.atan((place - middle) / F))
    expected = 0.6e-3 * view[0, 0, strip].mean().item() / 0.5 / math.sqrt(cosine)
    assert errors[..., 50:70, :].std() == pytest.approx(expected, rel=0.04)


@pytest.mark.parametrize("length", [1.0, 1.25, 3.0])
def test_neighbours_are_correlated_over_the_length_asked_for(length):
    generator = torch.Generator().manual_seed(5)
    field = correlated_normal((4, 300, 300), length, generator)
    assert field.std().item() == pytest.approx(1, rel=0.02)
    for distance in (1, 2, 3):
        expected = math.exp(-((distance / length) ** 2))
        along = (field[..., distance:] * field[..., :-distance]).mean().item()
        down = (field[:, distance:] * field[:, :-distance]).mean().item()
        assert along == pytest.approx(expected, abs=0.03)
        assert down == pytest.approx(expected, abs=0.03)


def test_a_capture_has_one_offset_and_one_scale():
    noise = NOTHING.model_copy(update={"bias_mm": 3.0, "scale_percent": 0.3})
    views = torch.cat([plane(0.4), plane(0.8)])[:, :16, :16]
    means = (measured(noise, views, captures=3000)).mean((2, 3)).double()
    near, far = means.T - torch.tensor([[0.4], [0.8]], dtype=torch.float64)
    scale = (far - near) / 0.4
    bias = near - 0.4 * scale
    assert scale.std().item() == pytest.approx(0.003, rel=0.05)
    assert bias.std().item() == pytest.approx(0.003, rel=0.05)
    assert abs(torch.corrcoef(torch.stack([scale, bias]))[0, 1].item()) < 0.06
    flat = measured(noise, plane(0.5), captures=4)
    assert (flat.std((2, 3)) < 1e-6).all()  # and nothing else within a picture


def test_edge_pixels_are_lost_or_between_the_two_surfaces():
    view = plane(0.5)
    view[..., 60:] = 0.6
    view[..., :20] = 0
    noise = NOTHING.model_copy(update={"edge_invalid_least": 0.3, "edge_invalid_most": 0.6,
                                       "edge_blend": 0.5})
    result = measured(noise, view, captures=400)[:, 0]
    edges = [20, 59, 60]
    others = [k for k in range(SIZE) if k not in edges]
    torch.testing.assert_close(result[..., others], view[0, :, others].expand(400, -1, -1))
    lost = (result[..., edges] == 0).float().mean(1)  # (400, 3) of each capture
    assert lost.mean().item() == pytest.approx(0.45, abs=0.02)
    # Spread over captures: uniform from 0.3 to 0.6, and of 120 pixels each.
    spread = math.sqrt(0.3**2 / 12 + 0.45 * 0.55 / SIZE)
    assert lost.std(0).mean().item() == pytest.approx(spread, rel=0.1)
    before, behind = result[..., 59], result[..., 60]
    before, behind = before[before > 0], behind[behind > 0]
    for share in ((before - 0.5) / 0.1, (0.6 - behind) / 0.1):
        assert share.min() >= -1e-5 and share.max() <= 0.5 + 1e-5
        assert share.mean().item() == pytest.approx(0.25, abs=0.01)
    at_background = result[..., 20]
    assert (at_background[at_background > 0] - 0.5).abs().max() < 1e-6


def test_grazing_pixels_are_partly_lost():
    noise = NOTHING.model_copy(update={"grazing_deg": 80, "grazing_invalid": 0.5})
    middle = slice(59, 61)
    steep = measured(noise, plane(0.5, 82), captures=300)[..., 1:-1, middle]
    assert (steep == 0).float().mean().item() == pytest.approx(0.5, abs=0.02)
    assert (measured(noise, plane(0.5, 78), captures=20)[..., 1:-1, middle] > 0).all()


def test_depth_comes_in_whole_millimetres_and_strength_scales_errors_and_losses():
    result = measured(NOTHING.model_copy(update={"axial_mm": 0.6, "step_mm": 1.0}), plane(0.5004))
    counts = result.double() * 1e3
    assert (counts - counts.round()).abs().max() < 1e-4
    assert len(counts.round().unique()) > 3
    noise = NOTHING.model_copy(update={"axial_mm": 0.6, "hole_percent": 1.0, "strength": 3.0})
    result = measured(noise, plane(), captures=20)
    assert (result == 0).float().mean().item() == pytest.approx(0.03, rel=0.1)
    assert (result[result > 0] - 0.5).std().item() == pytest.approx(1.8e-3, rel=0.05)


def test_the_shipped_sensor_stays_within_the_makers_bounds():
    noise = load_sensor("tof")
    assert noise == TimeOfFlight()
    view = plane(0.53, 40)
    result = measured(noise, view, captures=200)[..., 2:-2, 2:-2]
    error = (result - view[..., 2:-2, 2:-2]).where(result > 0, torch.nan)
    offset = error.nanmean((1, 2, 3))
    assert (offset.abs() < 0.011 + 0.001 * 0.53).float().mean() > 0.98
    assert (error - offset[:, None, None, None]).nan_to_num().std() < 0.002
