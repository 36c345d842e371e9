"""Estimates from views: the network's mean over all equivalent view orders.

The views may start anywhere in the circle and may be mirrored (:mod:`data.view_order`); the
network is asked about all eight orders. Their mean is better than one answer, and their spread
is the least uncertainty that an estimate can claim.
"""

from dataclasses import dataclass

import numpy as np
import torch

from data.view_order import ORDERS, reorder_views, restore_axis
from drapenet.losses import split_outputs
from drapenet.preprocess import InputFormat, prepare
from drapenet.targets import SOFT, STIFF, TargetScale, axis_angle, to_moduli


@dataclass(frozen=True)
class Prediction:
    """What the network says about one capture, at 300 g/m².

    Attributes:
        targets: (6,) in their units, see :mod:`drapenet.convention`.
        spread: (6,) standard deviation over the eight view orders, in the targets' units.
        axis: direction of the stiff axis in the first view, rad in [0, pi).
        axis_confidence: in [0, 1]. 0: no direction (nearly isotropic fabric, or the view orders
            disagree); 1: a strongly anisotropic fabric and one answer.
    """

    targets: np.ndarray
    spread: np.ndarray
    axis: float
    axis_confidence: float

    @property
    def moduli(self) -> tuple[np.ndarray, np.ndarray]:
        """alpha (3,) N·m and beta (3,) N·m², stiff, bias, soft."""
        alpha, beta = to_moduli(torch.from_numpy(self.targets))
        return alpha.numpy(), beta.numpy()


def in_order(targets: np.ndarray) -> np.ndarray:
    """targets (6,) whose stiff alpha is no smaller than the soft one.

    Stiff is the larger by definition; equal moduli are the nearest that agree with it.
    """
    targets = targets.copy()
    if targets[STIFF] < targets[SOFT]:
        targets[[STIFF, SOFT]] = targets[[STIFF, SOFT]].mean()
    return targets


@torch.no_grad()
def average_orders(
    model: torch.nn.Module, views: np.ndarray, *, form: InputFormat
) -> tuple[torch.Tensor, torch.Tensor]:
    """Outputs of the network for all view orders of one capture, in the capture's own order.

    Args:
        model: in evaluation mode.
        views: (4, H, W) z-depth, m, background 0.
        form: the network's input.

    Returns:
        Standardised targets (8, 6) and stiff axes (8, 2), turned back to the first view.
    """
    orders = np.stack([reorder_views(views, first=first, mirror=mirror)
                       for first, mirror in ORDERS])
    device = next(model.parameters()).device
    targets, axes = split_outputs(model(prepare(torch.from_numpy(orders), form=form).to(device)))
    axes = axes.cpu()
    angles = [restore_axis(angle, first=first, mirror=mirror)
              for angle, (first, mirror) in zip(axis_angle(axes).tolist(), ORDERS, strict=True)]
    doubled = 2 * torch.tensor(angles)
    restored = torch.stack([doubled.cos(), doubled.sin()], dim=1) * axes.norm(dim=1, keepdim=True)
    return targets.cpu(), restored


def predict(
    model: torch.nn.Module, views: np.ndarray, *, form: InputFormat, scale: TargetScale
) -> Prediction:
    """Estimate one capture; arguments as for :func:`average_orders`."""
    targets, axes = average_orders(model, views, form=form)
    axis = axes.mean(dim=0)
    mean = scale.decode(targets.mean(dim=0)).double().numpy()
    return Prediction(
        targets=in_order(mean),
        spread=(targets.std(dim=0, correction=0) * scale.std).double().numpy(),
        axis=float(axis_angle(axis)),
        axis_confidence=min(1.0, float(axis.norm())),
    )
