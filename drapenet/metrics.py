"""Figures that say how good predictions are."""

import torch

from drapenet.convention import LINEAR, RATIO, TARGET_NAMES
from drapenet.losses import drape_loss, split_outputs
from drapenet.targets import axis_angle

ANISOTROPIC = 0.3
"""Length of a direction vector from which a stiff axis counts as real: tanh of the logarithm of
alpha_stiff/alpha_soft, so a ratio of about 1.36."""


def angle_between_axes(first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
    """Angle (...,) in [0, pi/2], rad, between axes given by their angles, rad."""
    turned = torch.remainder(first - second, torch.pi)
    return torch.minimum(turned, torch.pi - turned)


def regression_metrics(
    outputs: torch.Tensor,
    targets: torch.Tensor,
    directions: torch.Tensor,
    *,
    direction_weight: float = 0.0,
    ratio_weight: float = 1.0,
) -> dict:
    """Errors over a set of drapes.

    Args:
        outputs: (N, 8) of the network.
        targets: (N, 6) standardised targets.
        directions: (N, 2) stiff axes, see :func:`drapenet.targets.direction_vectors`.
        direction_weight, ratio_weight: of ``loss`` only.

    Returns:
        ``rmse_log_alpha``, ``rmse_beta_over_alpha`` (root mean squares over drapes and the three
        directions, standardised: always predicting the training mean scores about 1),
        ``rmse`` (each of the six), ``loss`` (:func:`drapenet.losses.drape_loss`),
        ``axis_error_deg`` (median over clearly anisotropic fabrics, None without any; guessing
        scores 45), ``samples``.
    """
    moduli, axes = split_outputs(outputs)
    squares = (moduli - targets).double().square()
    errors = angle_between_axes(axis_angle(axes), axis_angle(directions))
    errors = errors[directions.norm(dim=-1) > ANISOTROPIC]
    return {
        "rmse_log_alpha": squares[:, LINEAR].mean().sqrt().item(),
        "rmse_beta_over_alpha": squares[:, RATIO].mean().sqrt().item(),
        "rmse": dict(zip(TARGET_NAMES, squares.mean(dim=0).sqrt().tolist(), strict=True)),
        "loss": drape_loss(outputs.double(), targets, directions, ratio_weight=ratio_weight,
                           direction_weight=direction_weight).item(),
        "axis_error_deg": torch.rad2deg(errors.median()).item() if len(errors) else None,
        "samples": len(outputs),
    }
