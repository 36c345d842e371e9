"""The time-of-flight model: its figures, measured on pictures whose noise can be measured."""

import math

import pytest
import torch

from common.errors import InputError
from data.render.sensor import load_sensor
from data.render.sensor_noise import SensorNoise
from data.render.time_of_flight import TimeOfFlight, correlated_normal

NOTHING = TimeOfFlight(
    axial_mm=0, bias_mm=0, scale_percent=0, edge_invalid_least=0, edge_invalid_most=0,
    edge_blend=0, grazing_invalid=0, hole_percent=0, step_mm=0,
)  # fmt: skip
F, SIZE = 300.0, 120
INTRINSICS = torch.tensor([F, F, (SIZE - 1) / 2, (SIZE - 1) / 2])


def plane(depth: float = 0.5, tilt_deg: float = 0.0) -> torch.Tensor:
    """A plane across the whole picture (1, H, W), turned about the picture's vertical axis."""
    x = (torch.arange(SIZE) - (SIZE - 1) / 2) / F
    view = depth / (1 - x * math.tan(math.radians(tilt_deg)))
    return view.expand(1, SIZE, SIZE).clone()


def noisy(noise: SensorNoise, views: torch.Tensor, *, captures: int = 1, seed: int = 3):
    """Noisy copies (captures, K, H, W)."""
    views = views.expand(captures, *views.shape)
    return noise(views, INTRINSICS, torch.Generator().manual_seed(seed))


def test_nothing_changes_where_every_figure_is_zero():
    view = plane(tilt_deg=50)
    view[:, :, :40] = 0
    torch.testing.assert_close(noisy(NOTHING, view)[0], view, rtol=0, atol=1e-7)


@pytest.mark.parametrize(("exponent", "power"), [(0.5, 1.0), (1.0, 2.0)])
def test_random_error_grows_with_distance(exponent, power):
    noise = NOTHING.model_copy(update={"axial_mm": 0.6, "signal_exponent": exponent})
    for depth in (0.5, 0.8, 1.5):
        # Near the picture's middle incidence is normal.
        error = (noisy(noise, plane(depth), captures=20) - depth)[..., 40:80, 40:80]
        assert error.std().item() == pytest.approx(0.6e-3 * (depth / 0.5) ** power, rel=0.04)
        assert abs(error.mean().item()) < 0.1 * error.std().item()


@pytest.mark.parametrize("tilt", [0.0, 60.0, 75.0])
def test_random_error_grows_with_incidence(tilt):
    view = plane(0.5, tilt)
    noise = NOTHING.model_copy(update={"axial_mm": 0.6})
    strip = slice(57, 63)  # the middle, where the angle of incidence is the tilt
    errors = (noisy(noise, view, captures=200) - view)[..., strip]
    cosine = math.cos(math.radians(tilt))
    expected = 0.6e-3 * view[0, 0, strip].mean().item() / 0.5 / math.sqrt(cosine)
    assert errors.std().item() == pytest.approx(expected, rel=0.04)


def test_incidence_counts_from_the_ray_not_from_the_axis():
    # A plane at right angles to the axis, seen 34 degrees aside.
    aside = torch.tensor([F, F, (SIZE - 1) / 2 - 200, (SIZE - 1) / 2])
    noise = NOTHING.model_copy(update={"axial_mm": 0.6})
    views = plane(0.5).expand(100, 1, SIZE, SIZE)
    error = noise(views, aside, torch.Generator().manual_seed(1))[..., 58:62, 58:62] - 0.5
    cosine = math.cos(math.atan(200 / F))
    assert error.std().item() == pytest.approx(0.6e-3 / math.sqrt(cosine), rel=0.06)


@pytest.mark.parametrize("length", [1.0, 1.25, 3.0])
def test_neighbours_are_correlated_over_the_length_asked_for(length):
    generator = torch.Generator().manual_seed(5)
    field = correlated_normal((4, 300, 300), length, torch.zeros(1), generator)
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
    means = (noisy(noise, views, captures=3000)).mean((2, 3)).double()
    near, far = means.T - torch.tensor([[0.4], [0.8]], dtype=torch.float64)
    scale = (far - near) / 0.4
    bias = near - 0.4 * scale
    assert scale.std().item() == pytest.approx(0.003, rel=0.05)
    assert bias.std().item() == pytest.approx(0.003, rel=0.05)
    assert abs(torch.corrcoef(torch.stack([scale, bias]))[0, 1].item()) < 0.06
    flat = noisy(noise, plane(0.5), captures=4)
    assert (flat.std((2, 3)) < 1e-6).all()  # and nothing else within a picture


def test_edge_pixels_are_lost_or_between_the_two_surfaces():
    view = plane(0.5)
    view[..., 60:] = 0.6
    view[..., :20] = 0
    noise = NOTHING.model_copy(update={"edge_invalid_least": 0.3, "edge_invalid_most": 0.6,
                                       "edge_blend": 0.5})
    result = noisy(noise, view, captures=400)[:, 0]
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
    steep = noisy(noise, plane(0.5, 82), captures=300)[..., 1:-1, middle]
    assert (steep == 0).float().mean().item() == pytest.approx(0.5, abs=0.02)
    assert (noisy(noise, plane(0.5, 78), captures=20)[..., 1:-1, middle] > 0).all()


def test_holes_are_rare_and_anywhere():
    noise = NOTHING.model_copy(update={"hole_percent": 0.1})
    result = noisy(noise, plane(), captures=200)
    assert (result == 0).float().mean().item() == pytest.approx(0.001, rel=0.1)


def test_depth_comes_in_whole_millimetres():
    result = noisy(NOTHING.model_copy(update={"axial_mm": 0.6, "step_mm": 1.0}), plane(0.5004))
    counts = result.double() * 1e3
    assert (counts - counts.round()).abs().max() < 1e-4
    assert len(counts.round().unique()) > 3


def test_the_shipped_sensor_stays_within_the_makers_bounds():
    noise = load_sensor("tof")
    assert noise == TimeOfFlight()
    view = plane(0.53, 40)
    result = noisy(noise, view, captures=200)[..., 2:-2, 2:-2]
    error = (result - view[..., 2:-2, 2:-2]).where(result > 0, torch.nan)
    offset = error.nanmean((1, 2, 3))
    assert (offset.abs() < 0.011 + 0.001 * 0.53).float().mean() > 0.98
    assert (error - offset[:, None, None, None]).nan_to_num().std() < 0.002


def test_strength_scales_errors_and_losses():
    noise = NOTHING.model_copy(update={"axial_mm": 0.6, "hole_percent": 1.0, "strength": 3.0})
    result = noisy(noise, plane(), captures=20)
    assert (result == 0).float().mean().item() == pytest.approx(0.03, rel=0.1)
    assert (result[result > 0] - 0.5).std().item() == pytest.approx(1.8e-3, rel=0.05)
    view = plane()
    assert torch.equal(noisy(TimeOfFlight(strength=0), view)[0], view)


def test_settings_out_of_range_are_named():
    for wrong in ({"edge_blend": 1.5}, {"edge_invalid_least": 0.8}, {"correlation_px": 0.1},
                  {"grazing_deg": 95}, {"hole_percent": 101}, {"axial_mm": -1}):
        with pytest.raises(InputError, match=f"sensor: {next(iter(wrong))}"):
            TimeOfFlight.of(wrong, "sensor")
