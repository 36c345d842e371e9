import math

import numpy as np
import pytest
import torch
from blobs import blob_views

from data.view_order import ORDERS, reorder_axis, reorder_views
from drapenet.model import DrapeNet
from drapenet.predict import predict
from drapenet.preprocess import InputFormat
from drapenet.targets import TargetScale

FORM = InputFormat(width=80, height=60)
SCALE = TargetScale(torch.tensor([-10.0, -10.6, -11, -0.003, -0.003, -0.003]),
                    torch.tensor([0.1, 0.1, 0.1, 1e-3, 1e-3, 1e-3]))
THETA = np.array([-10.0, -10.5, -11.0, -0.002, -0.002, -0.002])


@pytest.fixture(scope="module")
def model() -> DrapeNet:
    torch.manual_seed(2)
    return DrapeNet().eval()


class Protractor(torch.nn.Module):
    """Reads the stiff axis of a blob from the widths of its views, as a perfect network would."""

    def __init__(self) -> None:
        super().__init__()
        self.unused = torch.nn.Parameter(torch.zeros(1))

    def forward(self, views: torch.Tensor) -> torch.Tensor:
        cloth = (views < 2).float()
        width = cloth.sum(dim=2).amax(dim=1).flatten(1).sum(dim=1)
        columns = torch.arange(views.shape[-1]) - (views.shape[-1] - 1) / 2
        wide = (cloth * columns.abs()).sum(dim=(2, 3)) / cloth.sum(dim=(2, 3))
        cosine = (wide[:, 0] - wide[:, 1] + wide[:, 2] - wide[:, 3]) / 4
        slope = ((views * cloth * columns).sum(dim=(2, 3)) / cloth.sum(dim=(2, 3)))
        sine = (slope[:, 0] - slope[:, 1] + slope[:, 2] - slope[:, 3]) / 4
        outputs = torch.zeros(len(views), 8)
        outputs[:, 0] = width / 1000
        # Scales that make both components 0.76 at most for the blob of this test.
        outputs[:, 6], outputs[:, 7] = cosine / COSINE, sine / SINE
        return outputs


def response(psi: float) -> torch.Tensor:
    from drapenet.preprocess import prepare

    views = prepare(torch.from_numpy(blob_views(THETA, psi)), form=FORM)
    return Protractor()(views[None])[0, 6:]


COSINE = SINE = 1.0
COSINE, SINE = response(0.0)[0].item() / 0.76, response(math.pi / 4)[1].item() / 0.76


@pytest.mark.parametrize("psi", [0.1, 0.8, 1.5, 2.2, 3.0])
def test_a_perfect_reading_survives_the_averaging(psi: float) -> None:
    prediction = predict(Protractor(), blob_views(THETA, psi), form=FORM, scale=SCALE)
    error = (prediction.axis - psi + math.pi / 2) % math.pi - math.pi / 2
    assert abs(error) < 0.12
    assert 0.5 < prediction.axis_confidence < 0.95
    assert prediction.spread[1:].max() < 1e-6  # all view orders gave the same answer


@pytest.mark.parametrize(("first", "mirror"), ORDERS)
def test_equivalent_captures_have_one_estimate(model: DrapeNet, first: int, mirror: bool) -> None:
    views = np.random.default_rng(0).uniform(0.4, 0.6, (4, 60, 80)).astype(np.float32)
    views[:, :, :20] = 0
    own = predict(model, views, form=FORM, scale=SCALE)
    other = predict(model, reorder_views(views, first=first, mirror=mirror), form=FORM, scale=SCALE)
    np.testing.assert_allclose(other.targets, own.targets, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(other.spread, own.spread, rtol=1e-2, atol=1e-6)
    assert other.axis_confidence == pytest.approx(own.axis_confidence, abs=1e-4)
    expected = reorder_axis(own.axis, first=first, mirror=mirror)
    assert math.sin(other.axis - expected) == pytest.approx(0, abs=1e-2)


def test_stiff_is_never_softer_than_soft(model: DrapeNet) -> None:
    reversed_scale = TargetScale(SCALE.mean[[2, 1, 0, 3, 4, 5]], SCALE.std * 1e-3)
    prediction = predict(model, blob_views(THETA, 0.3), form=FORM, scale=reversed_scale)
    alpha, _ = prediction.moduli
    assert alpha[0] == alpha[2] == pytest.approx(math.exp(-10.5), rel=0.01)
