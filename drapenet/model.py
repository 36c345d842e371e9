"""The regression network: ResNet-18 on the four views as channels (Feng et al. 2022, 6.1–6.3)."""

import torch
import torchvision

from common.errors import InputError
from data.render import VIEWS
from drapenet.losses import OUTPUTS

BACKBONES = {"resnet18": torchvision.models.resnet18}


class DrapeNet(torch.nn.Module):
    """Maps views (N, 4, H, W), see :mod:`drapenet.preprocess`, to outputs (N, 8).

    The outputs are six standardised targets and two components of the stiff axis, see
    :mod:`drapenet.targets`. Any input size works; training fixes one.

    Raises:
        InputError: unknown backbone.
    """

    def __init__(self, *, backbone: str = "resnet18") -> None:
        super().__init__()
        if backbone not in BACKBONES:
            raise InputError(f"unknown backbone '{backbone}'; known: {', '.join(BACKBONES)}")
        network = BACKBONES[backbone](weights=None, num_classes=OUTPUTS)
        network.conv1 = torch.nn.Conv2d(
            VIEWS, network.conv1.out_channels, kernel_size=7, stride=2, padding=3, bias=False
        )
        torch.nn.init.kaiming_normal_(network.conv1.weight, mode="fan_out", nonlinearity="relu")
        self.backbone = network

    def forward(self, views: torch.Tensor) -> torch.Tensor:
        return self.backbone(views.contiguous(memory_format=torch.channels_last))
