"""Parts of an outline that stand out wider than its folds."""

import numpy as np
import pytest

from data.captures.clarity import bulge
from data.captures.off_axis import AZIMUTH

SHADOWED = np.abs(AZIMUTH - np.pi / 2) < np.pi / 7  # at the top


def outline(folds: int, depth: float) -> np.ndarray:
    """Radii of a disc's drape, m."""
    return 0.12 + depth * (np.cos(folds * AZIMUTH) + 0.3 * np.cos((folds + 1) * AZIMUTH + 1))


@pytest.mark.parametrize(("folds", "depth"), [(2, 0.006), (4, 0.01), (7, 0.012), (11, 0.006)])
def test_folds_do_not_bulge_and_a_shadow_over_them_is_named_with_its_side(folds, depth):
    radii = outline(folds, depth)
    assert not bulge(radii)
    if folds > 4:  # wide folds hide it
        found, = bulge(np.where(SHADOWED, radii.max(), radii))
        assert found.code == "hem_bulges" and found.values == {"place": "at the upper side"}


def test_a_specimen_off_its_centre_does_not_bulge():
    assert not bulge(0.12 + 0.01 * np.cos(AZIMUTH) + 0.002 * np.cos(7 * AZIMUTH))


def test_one_filled_valley_of_wide_folds_is_no_bulge():
    """Its fold is then as wide as two, less than a twelfth of the azimuth."""
    radii = outline(11, 0.006)
    assert not bulge(np.where(np.abs(AZIMUTH - np.pi / 2) < 0.15, radii.max(), radii))


def test_a_flat_specimen_has_no_bulge():
    assert not bulge(np.full(720, 0.15))
    assert not bulge(0.15 + 1e-4 * np.random.default_rng(0).standard_normal(720))
