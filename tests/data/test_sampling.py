import numpy as np
import pytest

from data.prior import load_prior
from data.sampling import SamplingConfig, plan_drape
from sim.errors import InputError

PRIOR = load_prior()


def plans(count, **changes):
    config = SamplingConfig(**changes)
    return [plan_drape(i, config=config, prior=PRIOR) for i in range(count)]


def test_a_plan_depends_on_seed_and_index_only():
    ahead = plan_drape(7, config=SamplingConfig(seed=3), prior=PRIOR)
    later = plans(8, seed=3)[7]
    for name in ("fabric", "start", "seed", "rejected"):
        assert getattr(ahead, name) == getattr(later, name)
    for name in ("theta", "offset", "orientations", "turns"):
        np.testing.assert_array_equal(getattr(ahead, name), getattr(later, name))
    other = plan_drape(7, config=SamplingConfig(seed=4), prior=PRIOR)
    assert other.seed != ahead.seed
    assert not np.isclose(other.theta, ahead.theta).any()


def test_drapes_of_a_fabric_share_the_parameters_and_nothing_else():
    drapes = plans(9, starts_per_fabric=3)
    assert [p.fabric for p in drapes] == [0, 0, 0, 1, 1, 1, 2, 2, 2]
    np.testing.assert_array_equal(drapes[0].theta, drapes[2].theta)
    assert len({p.theta.tobytes() for p in drapes}) == 3
    assert len({p.seed for p in drapes}) == 9
    assert len({p.offset.tobytes() for p in drapes}) == 9


@pytest.mark.parametrize("per_fabric", [1, 2, 4])
def test_starts_are_balanced(per_fabric):
    starts = [p.start for p in plans(40, starts_per_fabric=per_fabric)]
    assert starts.count("sine") == starts.count("fold") == 20


@pytest.mark.parametrize("number", [0, 2])
def test_the_number_of_orientations_does_not_change_the_fabric_or_start(number):
    few, many = plans(3, orientations=number)[2], plans(3, orientations=12)[2]
    assert few.orientations.shape == (number,) and few.turns.shape == (number, 4)
    np.testing.assert_array_equal(few.theta, many.theta)
    np.testing.assert_array_equal(few.offset, many.offset)
    assert few.seed == many.seed


def test_orientations_are_stratified_and_uniform():
    orientations = np.array([p.orientations for p in plans(300, orientations=6)])
    sectors = np.floor(orientations / (2 * np.pi / 6))
    np.testing.assert_array_equal(sectors, np.broadcast_to(np.arange(6), sectors.shape))
    within = orientations / (2 * np.pi / 6) % 1
    # The mean of 1800 uniform numbers has a standard error of 0.0068.
    assert abs(within.mean() - 0.5) < 0.03
    assert within.min() < 0.01 and within.max() > 0.99


def test_drift_has_its_standard_deviation():
    offsets = np.array([p.offset for p in plans(500, drift=0.004)])
    assert abs(offsets.std() / 0.004 - 1) < 0.08
    assert not np.any([p.offset for p in plans(4, drift=0.0)])


def test_the_table_turns_by_quarters_give_or_take():
    turns = np.array([p.turns for p in plans(200, orientations=3, turn=0.05)])
    assert turns.shape == (200, 3, 4) and not turns[..., 0].any()
    assert abs(turns[..., 1:].std() / 0.05 - 1) < 0.06


@pytest.mark.parametrize(
    "changes",
    [{"seed": -1}, {"starts_per_fabric": 0}, {"orientations": -1}, {"starts": ("flat",)},
     {"starts": ()}, {"drift": -0.001}, {"drift": float("nan")}, {"drift": 0.1}, {"turn": 0.5}],
)
def test_nonsense_is_refused(changes):
    with pytest.raises(InputError):
        SamplingConfig(**changes)
