import math

import pytest
import torch
from torch.utils.data import Dataset

from drapenet.config import OptimConfig
from drapenet.losses import drape_loss, root_mean_square, split_outputs
from drapenet.metrics import angle_between_axes, regression_metrics
from drapenet.training import validate


def test_loss_is_equation_10() -> None:
    errors = torch.tensor([[3.0, 4.0, 0, 0, 0, 0], [0, 0, 1.0, 2.0, 2.0, 0]])
    assert root_mean_square(errors).item() == pytest.approx(math.sqrt((25 + 9) / 2))


def test_direction_counts_by_its_weight() -> None:
    outputs = torch.zeros(2, 8)
    targets = torch.tensor([[1.0, 0, 0, 0, 0, 0]] * 2)
    axes = torch.tensor([[0.0, 0.5]] * 2)
    for weight in (0.0, 0.5, 2.0):
        loss = drape_loss(outputs, targets, axes, direction_weight=weight).item()
        assert loss == pytest.approx(1 + 0.5 * weight, abs=1e-5)


def test_ratio_weight_scales_the_errors_of_beta_over_alpha_only() -> None:
    targets, axes = torch.tensor([[3.0, 0, 0, 0, 4.0, 0]]), torch.zeros(1, 2)
    for weight, expected in ((1.0, 5.0), (0.5, math.hypot(3, 2)), (0.0, 3.0)):
        loss = drape_loss(torch.zeros(1, 8), targets, axes, direction_weight=1.0,
                          ratio_weight=weight).item()
        assert loss == pytest.approx(expected, abs=1e-4)
        metrics = regression_metrics(torch.zeros(1, 8), targets, axes, ratio_weight=weight)
        assert metrics["loss"] == pytest.approx(expected)
        assert metrics["rmse_beta_over_alpha"] == pytest.approx(4 / math.sqrt(3))


def test_a_perfect_prediction_has_a_finite_gradient() -> None:
    outputs = torch.zeros(2, 8, requires_grad=True)
    drape_loss(outputs, torch.zeros(2, 6), torch.zeros(2, 2), direction_weight=1.0).backward()
    assert outputs.grad.isfinite().all()


def test_predicting_the_mean_scores_one() -> None:
    targets = torch.randn(4000, 6, generator=torch.Generator().manual_seed(0))
    metrics = regression_metrics(torch.zeros(4000, 8), targets, torch.zeros(4000, 2))
    assert metrics["rmse_log_alpha"] == pytest.approx(1, abs=0.03)
    assert metrics["rmse_beta_over_alpha"] == pytest.approx(1, abs=0.03)
    assert metrics["loss"] == pytest.approx(math.sqrt(6), abs=0.05)
    assert metrics["axis_error_deg"] is None  # no anisotropic fabric among them


class Fixed(Dataset):
    """Three drapes whose views are what the network says of them."""

    outputs = torch.arange(24.0).reshape(3, 8) / 24
    targets, axes = torch.ones(3, 6), torch.tensor([[0.3, -0.4]] * 3)

    def __len__(self) -> int:
        return 3

    def __getitems__(self, items: list[int]) -> tuple[torch.Tensor, ...]:
        return self.outputs[items], self.targets[items], self.axes[items]


@pytest.mark.parametrize("weights", [{"direction_weight": 0.0, "ratio_weight": 1.0},
                                     {"direction_weight": 2.0, "ratio_weight": 0.5}])
def test_training_and_validation_measure_the_same_loss(weights: dict) -> None:
    found = validate(torch.nn.Identity(), Fixed(), device=torch.device("cpu"),
                     optim=OptimConfig(**weights))
    expected = drape_loss(Fixed.outputs, Fixed.targets, Fixed.axes, **weights).item()
    assert found["loss"] == pytest.approx(expected, rel=1e-6)


def test_metrics_tell_the_targets_apart() -> None:
    outputs = torch.zeros(10, 8)
    outputs[:, 2], outputs[:, 3] = 0.3, 0.6
    outputs[:, 6:] = torch.tensor([math.cos(2 * 0.2), math.sin(2 * 0.2)])
    axes = torch.tensor([[1.0, 0.0]]).repeat(10, 1)
    metrics = regression_metrics(outputs, torch.zeros(10, 6), axes)
    assert metrics["rmse"]["log_alpha_soft"] == pytest.approx(0.3)
    assert metrics["rmse_log_alpha"] == pytest.approx(0.3 / math.sqrt(3))
    assert metrics["rmse_beta_over_alpha"] == pytest.approx(0.6 / math.sqrt(3))
    assert metrics["axis_error_deg"] == pytest.approx(math.degrees(0.2), rel=1e-4)


@pytest.mark.parametrize(("first", "second", "angle"), [
    (0.1, 0.3, 0.2), (0.05, math.pi - 0.05, 0.1), (0.0, math.pi / 2, math.pi / 2)])
def test_axes_have_no_sense(first: float, second: float, angle: float) -> None:
    found = angle_between_axes(torch.tensor(first), torch.tensor(second)).item()
    assert found == pytest.approx(angle, abs=1e-5)


def test_outputs_split_into_six_and_two() -> None:
    moduli, axes = split_outputs(torch.arange(8.0)[None])
    assert moduli.tolist() == [[0, 1, 2, 3, 4, 5]] and axes.tolist() == [[6, 7]]
