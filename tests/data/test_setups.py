"""Synthetic captures: what a camera on a tripod sees of a skirted."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from common.configs import read_option
from common.errors import InputError
from data.captures.plate import plate_of_cloth
from data.render.setups import Setups, SyntheticCapture
from sim.rig import Rig

REAL = Setups.load()
CLEAN = replace(REAL, sensors={"none": 1.0}, border=0, holes=0, hem_share=0.0, turn=0.0, focal=0.0)


def capture(setups: Setups, drape: SimpleNamespace, seed: int) -> SyntheticCapture:
    return setups.capture(drape.positions, drape.faces, np.random.default_rng(seed))


def test_a_capture_is_its_seed_s(skirted):
    one, again, other = (capture(REAL, skirted, seed) for seed in (1, 1, 2))
    assert np.array_equal(one.views, again.views) and one.intrinsics == again.intrinsics
    assert one.views.shape != other.views.shape or not np.array_equal(one.views, other.views)


def test_cameras_stand_where_they_may_and_see_the_specimen(skirted):
    pitches, distances, cut = [], [], []
    for seed in range(20):
        found = capture(replace(CLEAN, views=(0, 0, 0, 1, 0, 0, 0, 0)), skirted, seed)
        cloth = found.views > 0
        cut.append(cloth[:, [0, -1]].any() or cloth[:, :, [0, -1]].any())
        assert cloth.any(axis=(1, 2)).all()
        plate = plate_of_cloth(found.views, found.intrinsics, Rig())
        pitches.append(np.arcsin(-plate.normal[2]))
        distances.append(np.linalg.norm(plate.centre))
    for values, (low, high) in ((pitches, REAL.pitch), (distances, REAL.distance)):
        margin = 0.05 * (high - low)
        assert low - margin < min(values) < low + 6 * margin
        assert high - 6 * margin < max(values) < high + margin
    assert np.mean(cut) < 0.4  # the corners of a wide drape leave the picture


def test_shares_are_those_asked_for(skirted):
    small = replace(CLEAN, views=(0.5, 0.5, 0, 0, 0, 0, 0, 0))
    counts = [len(capture(small, skirted, seed).views) for seed in range(40)]
    assert set(counts) == {1, 2} and 0.3 < np.mean(np.array(counts) == 1) < 0.7


def test_a_cut_out_takes_cloth_away_and_adds_none(skirted):
    spoilt = replace(CLEAN, border=2, holes=3, hem_share=1.0)
    less = []
    for seed in range(12):
        # The same camera, as all that is drawn before the cut-out is the same.
        whole, cut = (capture(setups, skirted, seed).views for setups in (CLEAN, spoilt))
        assert np.array_equal(cut[cut > 0], whole[cut > 0])
        less.append((cut > 0).sum() / (whole > 0).sum())
    assert 0.7 < min(less) < 0.97 and max(less) <= 1.0


def test_a_longer_lens_is_given_with_its_error(skirted):
    wrong = [capture(replace(CLEAN, focal=0.02), skirted, seed).intrinsics.fx
             / capture(CLEAN, skirted, seed).intrinsics.fx for seed in range(60)]
    assert np.std(wrong) == pytest.approx(0.02, rel=0.3)


@pytest.mark.parametrize(("changes", "message"), [
    ({"pitch_deg": [50, 25]}, "pitch_deg"),
    ({"views": [0.5] * 3}, "views.*add up to 1.5"),
    ({"sensors": {"smooth": 0.4}}, "sensors.*add up to 0.4"),
    ({"distance_mm": None}, "distance_mm=None"),
    ({"holes": 10**9}, "holes=1000000000"),
    ({"hem_mm": "15"}, "hem_mm='15'"),
    ({"distance_mm": [-500, 600]}, "distance_mm"), ({"above_mm": [900, 1000]}, "above_mm"),
])
def test_set_ups_that_make_no_sense_are_refused(changes, message):
    with pytest.raises(InputError, match=message):
        Setups.from_config(dict(read_option("setup", "real")) | changes)
