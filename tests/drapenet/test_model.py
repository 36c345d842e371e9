import pytest
import torch

from common.errors import InputError
from drapenet.model import DrapeNet


@pytest.mark.parametrize("size", [(60, 80), (90, 120)])
def test_four_views_become_eight_outputs_at_any_size(size: tuple[int, int]) -> None:
    model = DrapeNet().eval()
    assert model(torch.zeros(2, 4, *size)).shape == (2, 8)


def test_it_is_a_resnet18_on_four_channels() -> None:
    parameters = sum(value.numel() for value in DrapeNet().parameters())
    # ImageNet's 11 689 512, one more input channel of 64 7x7 filters, 8 outputs for 1000 classes.
    assert parameters == 11_689_512 + 64 * 49 - 992 * (512 + 1)


def test_every_view_counts() -> None:
    torch.manual_seed(0)
    model = DrapeNet().eval()
    views = torch.zeros(1, 4, 60, 80)
    still = model(views)
    for k in range(4):
        changed = views.clone()
        changed[0, k, 20:40, 30:50] = 1.0
        assert (model(changed) - still).abs().max() > 1e-4


def test_unknown_backbone() -> None:
    with pytest.raises(InputError, match="resnet18"):
        DrapeNet(backbone="resnet999")
