import math

import pytest
import torch

from data.view_order import ORDERS, reorder_axis
from drapenet.convention import TARGET_NAMES
from drapenet.targets import (
    TargetScale,
    axis_angle,
    direction_vectors,
    to_moduli,
    to_stiff_soft,
)

WARP_STIFF = torch.tensor([-9.0, -10.0, -11.0, -0.001, -0.002, -0.003])
WEFT_STIFF = torch.tensor([-11.0, -10.0, -9.0, -0.003, -0.002, -0.001])


def test_a_quarter_turn_of_the_specimen_changes_no_target() -> None:
    assert torch.equal(to_stiff_soft(WARP_STIFF), WARP_STIFF)
    assert torch.equal(to_stiff_soft(WEFT_STIFF), WARP_STIFF)
    both = torch.stack([WEFT_STIFF, WARP_STIFF])
    assert torch.equal(to_stiff_soft(both), torch.stack([WARP_STIFF, WARP_STIFF]))
    first = direction_vectors(WARP_STIFF, torch.tensor(0.3))
    second = direction_vectors(WEFT_STIFF, torch.tensor(0.3 + math.pi / 2))
    assert torch.allclose(first, second, atol=1e-6)


def test_the_vector_points_along_the_stiff_axis() -> None:
    assert axis_angle(direction_vectors(WARP_STIFF, torch.tensor(0.3))).item() == pytest.approx(0.3)
    angle = axis_angle(direction_vectors(WEFT_STIFF, torch.tensor(0.3))).item()
    assert angle == pytest.approx(0.3 + math.pi / 2)


def test_the_vector_shrinks_with_the_anisotropy_and_has_no_jump() -> None:
    theta = WARP_STIFF.repeat(101, 1)
    theta[:, 2] = torch.linspace(-9.5, -8.5, 101)  # the stiffer yarn changes in the middle
    vectors = direction_vectors(theta, torch.tensor(0.3))
    steps = (vectors[1:] - vectors[:-1]).norm(dim=1)
    assert steps.max() < 0.011  # 0.01 in log alpha moves it by no more
    assert vectors[50].norm() < 1e-6
    assert torch.allclose(vectors.norm(dim=1), torch.tanh((theta[:, 0] - theta[:, 2]).abs()))


@pytest.mark.parametrize(("first", "mirror"), ORDERS)
def test_the_vector_follows_the_view_order(first: int, mirror: bool) -> None:
    psi = reorder_axis(0.3, first=first, mirror=mirror)
    x, y = direction_vectors(WARP_STIFF, torch.tensor(0.3)).tolist()
    turned = [x * (-1) ** first, y * (-1) ** first * (-1 if mirror else 1)]
    assert direction_vectors(WARP_STIFF, torch.tensor(psi)).tolist() == pytest.approx(
        turned, abs=1e-6)


def test_standardised_training_set_has_mean_zero_and_deviation_one() -> None:
    theta = torch.randn(500, 6, generator=torch.Generator().manual_seed(1))
    theta = theta * torch.tensor([1, 1, 1, 1e-3, 1e-3, 1e-3]) + WARP_STIFF
    scale = TargetScale.fit(theta)
    encoded = scale.encode(to_stiff_soft(theta))
    assert encoded.mean(dim=0).abs().max() < 1e-4
    assert (encoded.std(dim=0, correction=0) - 1).abs().max() < 1e-4
    assert torch.allclose(scale.decode(encoded), to_stiff_soft(theta), rtol=1e-5, atol=1e-7)


def test_moduli_have_si_units() -> None:
    targets = torch.tensor([math.log(20e-6)] * 3 + [-2.5e-3] * 3, dtype=torch.float64)
    alpha, beta = to_moduli(targets)
    assert alpha.tolist() == pytest.approx([20e-6] * 3)
    assert beta.tolist() == pytest.approx([-50e-9] * 3)
    assert TARGET_NAMES[0] == "log_alpha_stiff" and TARGET_NAMES[5] == "beta_over_alpha_soft"
