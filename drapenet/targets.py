"""What the network predicts: moduli in the stiff/soft convention, and the stiff axis.

The six targets, named in :mod:`drapenet.convention`, are the log alphas and the beta/alphas of
the stiff yarn direction, the bias and the soft yarn direction, standardised with the mean and
standard deviation of the training set. Where the stiff axis points in the first view is a second
output, see :func:`direction_vectors`.
"""

from dataclasses import dataclass

import torch

from drapenet.convention import LINEAR, RATIO
from sim.material import BIAS, WARP, WEFT

STIFF, SOFT = 0, 2  # among (stiff, bias, soft)

_WARP_STIFF = [WARP, BIAS, WEFT, 3 + WARP, 3 + BIAS, 3 + WEFT]
_WEFT_STIFF = [WEFT, BIAS, WARP, 3 + WEFT, 3 + BIAS, 3 + WARP]


def warp_is_stiff(theta: torch.Tensor) -> torch.Tensor:
    """(...,) bool: whether the warp is the stiffer yarn direction of theta (..., 6)."""
    return theta[..., WARP] >= theta[..., WEFT]


def to_stiff_soft(theta: torch.Tensor) -> torch.Tensor:
    """Targets (..., 6) of parameters theta (..., 6) in warp, bias, weft order."""
    return torch.where(
        warp_is_stiff(theta)[..., None], theta[..., _WARP_STIFF], theta[..., _WEFT_STIFF]
    )


def direction_vectors(theta: torch.Tensor, psi: torch.Tensor) -> torch.Tensor:
    """w (cos 2 psi_stiff, sin 2 psi_stiff), the stiff axis weighted by the anisotropy.

    The doubled angle makes an axis (no sense of direction) single-valued. The weight
    w = tanh |log(alpha_stiff/alpha_soft)| lets the vector shrink to zero where the two yarn
    directions are alike: there the stiff axis jumps by 90°, which turns the vector around.

    Args:
        theta: (..., 6) parameters in warp, bias, weft order.
        psi: (...,) direction of the warp in the first view, rad.

    Returns:
        (..., 2), of length below 1.
    """
    # A quarter turn of the axis turns the doubled angle by half a turn, which is the sign that
    # the anisotropy log(alpha_warp/alpha_weft) has anyway.
    weight = torch.tanh(theta[..., WARP] - theta[..., WEFT])
    return weight[..., None] * torch.stack([torch.cos(2 * psi), torch.sin(2 * psi)], dim=-1)


def axis_angle(vectors: torch.Tensor) -> torch.Tensor:
    """Direction (...,) in [0, pi), rad, of the axis of vectors (..., 2)."""
    return torch.remainder(torch.atan2(vectors[..., 1], vectors[..., 0]) / 2, torch.pi)


@dataclass(frozen=True)
class TargetScale:
    """Standardisation of the six targets.

    Attributes:
        mean, std: (6,) float32, in the targets' units.
    """

    mean: torch.Tensor
    std: torch.Tensor

    @staticmethod
    def fit(theta: torch.Tensor) -> "TargetScale":
        """The scale of a training set's parameters theta (N, 6)."""
        targets = to_stiff_soft(theta.to(torch.float64))
        std = targets.std(dim=0, correction=0).clamp_min(1e-12)
        return TargetScale(targets.mean(dim=0).float(), std.float())

    def encode(self, targets: torch.Tensor) -> torch.Tensor:
        """Standardised targets (..., 6)."""
        return (targets - self.mean.to(targets)) / self.std.to(targets)

    def decode(self, standardised: torch.Tensor) -> torch.Tensor:
        """Targets (..., 6) in their units."""
        return standardised * self.std.to(standardised) + self.mean.to(standardised)


def to_moduli(targets: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Moduli alpha (..., 3) N·m and beta (..., 3) N·m², stiff, bias, soft, at 300 g/m²."""
    alpha = torch.exp(targets[..., LINEAR])
    return alpha, alpha * targets[..., RATIO]
