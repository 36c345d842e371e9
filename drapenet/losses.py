"""Training loss."""

import torch

from drapenet.convention import RATIO, TARGET_NAMES

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
    ratio_weight: float = 1.0,
) -> torch.Tensor:
    """Eq. 10 over the standardised targets plus the weighted same of the stiff axis.

    A drape hardly tells beta/alpha, whose errors stay near 1 and drown those of log alpha in
    the sum of squares; a ``ratio_weight`` below 1 lets the network attend to what it can learn.

    Args:
        outputs: (N, 8) of the network.
        targets: (N, 6) standardised targets.
        directions: (N, 2), see :func:`drapenet.targets.direction_vectors`.
        direction_weight: weight of the second term.
        ratio_weight: factor on the errors of beta/alpha in the first.
    """
    moduli, axes = split_outputs(outputs)
    errors = (moduli - targets) * target_weights(ratio_weight).to(outputs)
    return root_mean_square(errors) + direction_weight * root_mean_square(
        axes - directions
    )


def target_weights(ratio_weight: float) -> torch.Tensor:
    """(6,) factors on the errors of the targets: 1 for log alpha, ``ratio_weight`` otherwise."""
    weights = torch.ones(len(TARGET_NAMES))
    weights[RATIO] = ratio_weight
    return weights


def split_outputs(outputs: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """The network's outputs (..., 8) as standardised targets (..., 6) and axis (..., 2)."""
    return outputs[..., :-2], outputs[..., -2:]
