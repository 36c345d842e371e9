"""What is known of a fabric beside its captures, as evidence."""

from dataclasses import replace

import numpy as np
import pytest
from estimates import estimate_of

from common.errors import InputError
from data.captures.known import ByDirection, Known
from data.fabrics.properties import ClothProperties
from drapenet.known import weigh
from drapenet.result.estimate import Estimate
from drapenet.result.readings import bending_length
from sim.material import MICRO, STIFF_SOFT

SPREAD = 0.3  # standard deviation of the logarithms of the membrane stiffness and of alpha


def posterior() -> Estimate:
    """Log-normal membrane stiffness and alpha, independent; at 300 g/m²."""
    rng, estimate = np.random.default_rng(0), estimate_of(
        np.full(3, 60 * MICRO), np.zeros(3), density=0.3)
    theta = np.tile(estimate.samples[0], (40_000, 1))
    theta[:, :3] += SPREAD * rng.standard_normal((len(theta), 3))
    membrane = 600 * np.exp(SPREAD * rng.standard_normal(len(theta)))
    return replace(estimate, cloth=ClothProperties(
        theta, np.zeros((len(theta), 2)), membrane, np.full(len(theta), 0.2)))


def test_a_known_value_gives_the_posterior_of_normal_logarithms():
    before = posterior()
    after = weigh(before, Known(membrane_n_per_m=900, error_percent={"membrane_n_per_m": 30}))
    found = np.log(after.cloth.membrane)
    # Both have the same deviation: halfway, and narrower by the root of 2.
    assert found.mean() == pytest.approx(np.log(np.sqrt(600 * 900)), abs=0.01)
    assert found.std() == pytest.approx(SPREAD / np.sqrt(2), rel=0.03)
    assert after.samples.mean(axis=0) == pytest.approx(before.samples.mean(axis=0), abs=0.01)
    assert not after.warnings and weigh(before, Known()) is before


def test_a_known_bending_length_moves_its_direction_alone():
    """Of a linear law it goes with the cube root of alpha (Peirce): 5 % of it are 15 % of alpha."""
    length = 1e3 * bending_length(80 * MICRO, 0.0, 0.3)
    after = weigh(posterior(), Known(bending_length_mm=ByDirection(weft=length)))
    share = SPREAD**2 / (SPREAD**2 + 0.15**2)
    expected = np.log(60 * MICRO) + share * np.log(80 / 60) * np.array([0, 0, 1])
    assert after.samples.mean(axis=0)[:3] == pytest.approx(expected, abs=0.01)


@pytest.mark.parametrize(("known", "said"), [
    ({"membrane_n_per_m": 6000}, "the known membrane_n_per_m = 6000 contradicts the captures"),
    ({"kes_b_gf_cm2_per_cm": ByDirection(bias=9.0)}, "kes_b_gf_cm2_per_cm bias = 9 contradicts"),
    ({"membrane_n_per_m": 1900, "error_percent": {"membrane_n_per_m": 1}}, "agree with only")])
def test_what_contradicts_the_captures_is_named(known, said):
    assert said in "; ".join(weigh(posterior(), Known(**known)).warnings)


def test_values_along_the_yarns_need_the_direction_of_the_warp():
    unmarked = replace(posterior(), names=STIFF_SOFT)
    with pytest.raises(InputError, match="need warp_direction_deg"):
        weigh(unmarked, Known(bending_length_mm=ByDirection(warp=20)))
    weigh(unmarked, Known(membrane_n_per_m=600))
    with pytest.raises(InputError, match="no fabric of the posterior"):
        weigh(replace(unmarked, cloth=replace(unmarked.cloth, membrane=np.zeros(40_000))),
              Known(membrane_n_per_m=600))
