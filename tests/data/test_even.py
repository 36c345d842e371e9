from functools import cache

import numpy as np
import pytest

from common.command import compose_config
from common.errors import InputError
from data.dataset.config import Options, SamplingConfig, config_from_options
from data.dataset.plan import Stream, plan_drape, stream
from data.fabrics.fabrics import from_theta
from data.fabrics.prior import TablePrior, load_prior, log_stiffness, sample_admissible
from data.fabrics.prior.even import STIFFNESS, draw_fabric, draw_fabrics, moved
from sim.material import BIAS, LINEAR, RATIO, WARP, WEFT, Fabric, is_admissible

PRIOR = load_prior("vae")
COUNT = 2000
SHARE = 0.8


@cache
def drawn():
    """Fabrics (N, 6) of the autoencoder with an even share, and their shifts (N,)."""
    rng = np.random.default_rng(3)
    draws = [draw_fabric(PRIOR, rng, even_share=SHARE) for _ in range(COUNT)]
    return np.array([theta for theta, _, _ in draws]), np.array([shift for *_, shift in draws])


def places(theta):
    """Where each mean log alpha lies in the range, from 0 to 1, in order."""
    low, high = np.log(STIFFNESS)
    return np.sort((log_stiffness(theta) - low) / (high - low))


def test_moved_fabrics_are_evenly_stiff():
    theta, shift = drawn()
    even = places(theta[shift != 0])
    assert abs(len(even) / COUNT - SHARE) < 0.03
    # The bound of Kolmogorov and Smirnov that one sample in a thousand exceeds.
    bound = 1.95 / np.sqrt(len(even))
    assert np.abs(even - (np.arange(len(even)) + 0.5) / len(even)).max() < bound
    plain = places(theta[shift == 0])
    assert np.abs(plain - (np.arange(len(plain)) + 0.5) / len(plain)).max() > 4 * bound


def test_all_are_possible_fabrics():
    theta, _ = drawn()
    assert is_admissible(*from_theta(theta)).all()
    for alpha, beta in zip(*from_theta(theta), strict=True):
        Fabric(alpha, beta)  # refuses what has the wrong unit


def test_a_move_keeps_the_ratios_between_directions():
    plain = PRIOR.sample(50, np.random.default_rng(1))
    stiffer = moved(plain, 2.0, 0.25)
    np.testing.assert_allclose(stiffer[:, LINEAR] - plain[:, LINEAR], 2.0, atol=1e-11)
    np.testing.assert_allclose(stiffer[:, RATIO], np.exp(0.5) * plain[:, RATIO], atol=1e-11)


@pytest.mark.parametrize("anisotropy", [(0.0, 0.0), (0.8, 0.3), (0.0, 1.0), (1.0, 1.0)])
def test_shares_of_the_anisotropy_are_kept(anisotropy):
    plain = draw_fabrics(PRIOR, 300)[0]
    found = draw_fabrics(PRIOR, 300, anisotropy=anisotropy)[0]

    def differences(values):
        across = values[:, WARP] - values[:, WEFT]
        return np.stack([across, values[:, BIAS] - values[:, [WARP, WEFT]].mean(axis=1)], axis=1)

    for part in (LINEAR, RATIO):
        np.testing.assert_allclose(differences(found[:, part]), anisotropy * differences(
            plain[:, part]), atol=1e-11)
        np.testing.assert_allclose(found[:, part].mean(axis=1), plain[:, part].mean(axis=1),
                                   atol=1e-11)
    assert is_admissible(*from_theta(found)).all()


@pytest.mark.parametrize("words", ["[0.8,1.5]", "[0.8]", "0.8", "[-0.1,1]"])
def test_other_shares_of_the_anisotropy_are_refused(words):
    with pytest.raises(InputError, match="anisotropy"):
        config_from_options(compose_config("generate", [f"dataset.anisotropy={words}"],
                                           schema=Options))


def test_the_exponent_of_a_known_power_is_found():
    rng = np.random.default_rng(2)
    stiffness = rng.uniform(-14, -8, 40)[:, None]
    theta = np.hstack([stiffness + rng.normal(0, 0.3, (40, 3)), np.zeros((40, 3))])
    theta[:, RATIO] = -1e-3 * np.exp(0.4 * (log_stiffness(theta)[:, None] + 10))
    assert TablePrior(theta).softening == pytest.approx(0.4, abs=1e-9)
    linear = theta * np.repeat([1.0, 0.0], 3)
    assert TablePrior(linear).softening == pytest.approx(0.0, abs=1e-9)
    assert TablePrior(theta[:1]).softening == pytest.approx(0.0, abs=1e-9)


def test_the_others_are_the_fabrics_of_the_prior():
    for fabric in range(40):
        theta, rejected = sample_admissible(PRIOR, stream(4, Stream.FABRIC, fabric))
        alone, mixed = (plan_drape(fabric, prior=PRIOR, config=SamplingConfig(
            seed=4, starts_per_fabric=1, even_share=share)) for share in (0.0, 0.5))
        np.testing.assert_array_equal(alone.theta, theta)
        assert (alone.shift, alone.rejected) == (0.0, rejected)
        np.testing.assert_allclose(
            mixed.theta, moved(theta, mixed.shift, PRIOR.softening) if mixed.shift else theta,
            rtol=1e-12)


def test_the_same_seed_gives_the_same_bytes():
    first, second = (draw_fabric(PRIOR, stream(6, Stream.FABRIC, 1), even_share=1.0)
                     for _ in range(2))
    assert first[0].tobytes() == second[0].tobytes() and first[1:] == second[1:]
    assert first[2] != 0
    some, more = (draw_fabrics(PRIOR, count, even_share=SHARE)[0] for count in (3, 5))
    assert some.tobytes() == more[:3].tobytes()
