from dataclasses import replace

import numpy as np
import pytest
import torch

from common.errors import InputError
from drapenet.preprocess import InputFormat, crop_doubts, prepare

FORM = InputFormat(width=40, height=30, centre=0.5, scale=0.1, background=2.0)


def test_a_pixel_is_the_mean_of_its_cloth_only() -> None:
    views = torch.zeros(4, 120, 160)
    views[:, :4, :4] = 0.6
    views[:, :2, 0] = 0.0  # 14 of the 16 pixels of the first area are cloth
    views[:, 0, 3] = 0.46
    prepared = prepare(views, form=FORM)
    assert prepared.shape == (4, 30, 40)
    expected = ((13 * 0.6 + 0.46) / 14 - 0.5) / 0.1
    assert prepared[:, 0, 0].tolist() == pytest.approx([expected] * 4, abs=1e-5)
    assert (prepared[:, 1:] == 2.0).all() and (prepared[:, :, 1:] == 2.0).all()


@pytest.mark.parametrize(("cloth_pixels", "is_cloth"), [(7, False), (8, True)])
def test_half_an_area_of_cloth_is_cloth(cloth_pixels: int, is_cloth: bool) -> None:
    views = torch.zeros(1, 120, 160)
    rows, columns = torch.arange(cloth_pixels) // 4, torch.arange(cloth_pixels) % 4
    views[0, rows, columns] = 0.5
    value = prepare(views, form=FORM)[0, 0, 0].item()
    assert value == pytest.approx(0.0 if is_cloth else 2.0, abs=1e-6)


def test_no_value_lies_between_cloth_and_background() -> None:
    rows, columns = torch.meshgrid(torch.arange(180), torch.arange(240), indexing="ij")
    disc = (rows - 90) ** 2 + (columns - 120) ** 2 < 61**2
    prepared = prepare(torch.where(disc, 0.52, 0.0)[None], form=FORM)
    cloth, background = torch.tensor(0.2), torch.tensor(2.0)
    assert (torch.isclose(prepared, cloth, atol=1e-4) | (prepared == background)).all()
    assert (prepared != background).sum().item() * 36 == pytest.approx(disc.sum().item(), rel=0.03)


def test_a_batch_is_prepared_like_its_captures() -> None:
    form = InputFormat(width=40, height=32, crop_width=80, crop_height=64)
    batch = torch.zeros(4, 4, 90, 120)  # the last without any cloth
    for i in range(3):
        batch[i, :, 20 + 5 * i : 50 + 5 * i, 30 + 10 * i : 70] = 0.5 + 0.01 * i
    single = torch.stack([prepare(capture, form=form) for capture in batch])
    assert torch.equal(prepare(batch, form=form), single)


@pytest.mark.parametrize(("top", "left"), [(30, 60), (0, 0), (128, 172), (61, 33)])
def test_the_crop_follows_the_cloth_and_stays_in_the_picture(top: int, left: int) -> None:
    form = InputFormat(width=64, height=48, crop_width=128, crop_height=96)
    views = torch.zeros(4, 180, 240)
    views[1, top : top + 40, left : left + 40] = 0.5  # all views are cropped alike
    views[2, top + 12 : top + 52, left + 28 : left + 68] = 0.6
    prepared = prepare(views, form=form)
    cloth = prepared < 2.0
    assert cloth[1].sum() >= 18 * 18 and cloth[2].sum() >= 18 * 18
    if (top, left) == (30, 60):  # away from the borders, the cloth is in the middle
        found = cloth.any(dim=0).nonzero().float()
        middle = (found.min(dim=0).values + found.max(dim=0).values) / 2
        assert middle.tolist() == pytest.approx([23.5, 31.5], abs=0.6)


@pytest.mark.parametrize(("width", "height"), [(128, 96), (129, 96), (100, 97), (170, 100)])
def test_cloth_beyond_the_window_is_reported(width: int, height: int) -> None:
    form = InputFormat(width=64, height=48, crop_width=128, crop_height=96)
    views = np.zeros((4, 180, 240), dtype=np.float32)
    views[0, 20 : 20 + height, 30:60] = 0.5  # none of the views is as large as all together
    views[3, 20:60, 30 : 30 + width] = 0.5
    seen = prepare(torch.from_numpy(views), form=InputFormat(width=240, height=180)) < 2.0
    kept = prepare(torch.from_numpy(views), form=replace(form, width=128, height=96)) < 2.0
    doubts = crop_doubts(views, form=form)
    assert bool(doubts) == (width > 128 or height > 96)
    for doubt in doubts:
        share = 100 * (1 - kept.sum().item() / seen.sum().item())
        assert f"is {width} x {height} pixels of 240 x 180" in doubt
        assert "sees 128 x 96" in doubt and f": {share:.1f}% of the cloth" in doubt
    assert not crop_doubts(views, form=InputFormat())  # sees the whole picture


def test_cloth_that_lies_mostly_beyond_the_window_is_refused() -> None:
    form = InputFormat(width=64, height=48, crop_width=128, crop_height=96)
    with pytest.raises(InputError, match=r"71\.6% of the cloth is cut off, and at most 50%"):
        crop_doubts(np.full((4, 180, 240), 0.5), form=form)


@pytest.mark.parametrize("options", [{"width": 8}, {"scale": 0.0}, {"crop_width": -1}])
def test_senseless_formats_are_refused(options: dict) -> None:
    with pytest.raises(InputError):
        InputFormat(**options)
