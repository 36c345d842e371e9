"""Strips between clamps: exact cases, and the clamps' part in the extension along the bias."""

import numpy as np
import pytest

from drapenet.measured.tension.law import compliance, extension, load, reach, softness
from sim.energies.membrane import OrthotropicStVK
from sim.material import BIAS, WARP, WEFT
from sim.tension import pull

WARP_N, WEFT_N, SHEAR_N = 700.0, 350.0, 40.0  # N/m


@pytest.mark.parametrize(("direction", "angle"), [(WARP, 0.0), (WEFT, np.pi / 2)])
def test_cloth_that_need_not_narrow_follows_the_law_everywhere(direction, angle):
    cloth = OrthotropicStVK(warp=WARP_N, weft=WEFT_N, poisson=0.0, shear=SHEAR_N)
    found = pull(cloth, angle=angle, length=0.2, width=0.05, extension=0.05, cells=4)
    law = compliance(direction, (WARP_N, WEFT_N, SHEAR_N), 0.0)
    assert found.load == pytest.approx(load(0.05, law), rel=1e-6)
    assert found.extension() == pytest.approx(0.05) == found.extension(0.06)
    assert extension(found.load, law) == pytest.approx(0.05, rel=1e-6)


@pytest.mark.parametrize(("length", "margin", "cells"), [
    (0.1, 0.0, 48),     # FAST-3
    (0.15, 0.0, 48),
    (0.2, 0.05, 24)])   # marks a width from the clamps
@pytest.mark.parametrize("shear", [10.0, 40.0, 150.0])
def test_simulated_bias_strips_stretch_as_the_table_says(shear, length, margin, cells):
    width, stretch, n = 0.05, 600.0, 0.3
    cloth = OrthotropicStVK(warp=stretch, weft=stretch, poisson=n, shear=shear)
    found = pull(cloth, angle=np.pi / 4, length=length, width=width, extension=0.02, cells=cells)
    law, gauge = (stretch, stretch, shear), (length - 2 * margin) / width
    far = extension(found.load, compliance(BIAS, law, n))
    told = far * reach(BIAS, law, n, gauge=gauge, margin=margin / width)
    assert found.extension(margin) == pytest.approx(told, abs=0.04 * far / gauge)
    if margin == 0.0 and shear == 10.0:  # without the clamps it would be wrong
        assert found.extension() < 0.88 * far


def test_a_strip_with_yarns_that_differ_and_a_large_extension_is_told_to_two_per_cent():
    n = 0.3
    cloth = OrthotropicStVK(warp=WARP_N, weft=WEFT_N, poisson=n * np.sqrt(WARP_N / WEFT_N),
                            shear=SHEAR_N)
    found = pull(cloth, angle=np.pi / 4, length=0.2, width=0.05, extension=0.1, cells=24)
    law = (WARP_N, WEFT_N, SHEAR_N)
    far = extension(found.load, compliance(BIAS, law, n))
    assert found.extension() == pytest.approx(far * reach(BIAS, law, n, gauge=4.0, margin=0.0),
                                              rel=0.02)
    assert found.extension(0.06) == pytest.approx(far, rel=0.02)
    assert 0.1 < softness(*law, n) < 0.2
