"""Training loss."""

import torch

from drapenet.convention import TARGET_NAMES

OUTPUTS = len(TARGET_NAMES) + 2  # six standardised targets, two components of the stiff axis


def root_mean_square(errors: torch.Tensor) -> torch.Tensor:
    """Eq. 10 of Feng et al. 2022: square root of the mean of squared error norms.

    Args:
        errors: (N, D) differences g_i - p_i.
    """
    # The root has no slope at zero; a floor far below any error that matters gives it one.
    return (errors.square().sum(dim=1).mean() + 1e-12).sqrt()


def drape_loss(
    outputs: torch.Tensor,
    targets: torch.Tensor,
    directions: torch.Tensor,
    *,
    direction_weight: float,
) -> torch.Tensor:
    """Eq. 10 over the standardised targets plus the weighted same of the stiff axis.

    Args:
        outputs: (N, 8) of the network.
        targets: (N, 6) standardised targets.
        directions: (N, 2), see :func:`drapenet.targets.direction_vectors`.
        direction_weight: weight of the second term.
    """
    moduli, axes = split_outputs(outputs)
    return root_mean_square(moduli - targets) + direction_weight * root_mean_square(
        axes - directions
    )


def split_outputs(outputs: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """The network's outputs (..., 8) as standardised targets (..., 6) and axis (..., 2)."""
    return outputs[..., :-2], outputs[..., -2:]
