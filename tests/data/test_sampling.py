import numpy as np
import pytest

from common.errors import InputError
from data.dataset.config import SamplingConfig
from data.dataset.plan import choose_lender, plan_drape
from data.fabrics.nuisances import NuisanceConfig
from data.fabrics.prior import load_prior
from data.rigs import named_tester
from sim.rig import DISC_RIG, SQUARE_RIG

PRIOR = load_prior("gaussian")


def plans(count, **changes):
    config = SamplingConfig(**changes)
    return [plan_drape(i, config=config, prior=PRIOR) for i in range(count)]


def test_a_plan_depends_on_seed_and_index_only():
    ahead = plan_drape(7, config=SamplingConfig(seed=3), prior=PRIOR)
    later = plans(8, seed=3)[7]
    for name in ("fabric", "start", "seed", "rejected"):
        assert getattr(ahead, name) == getattr(later, name)
    for name in ("theta", "offset"):
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
    starts = [p.start for p in plans(40, starts_per_fabric=per_fabric, starts=("sine", "fold"))]
    assert starts.count("sine") == starts.count("fold") == 20


def test_a_third_of_eight_starts_each_is_borrowed():
    kinds = ("sine", "fold", "borrowed")
    drapes = plans(48, starts_per_fabric=8, starts=kinds)
    assert [[p.start for p in drapes].count(kind) for kind in kinds] == [16, 16, 16]
    for fabric in range(6):
        of_fabric = [p.start for p in drapes if p.fabric == fabric]
        assert sorted(of_fabric.count(kind) for kind in kinds) == [2, 3, 3]
    fallbacks = [p.fallback for p in drapes if p.start == "borrowed"]
    assert fallbacks.count("sine") == fallbacks.count("fold") == 8
    assert all(p.fallback == p.start for p in drapes if p.start != "borrowed")


def test_borrowing_changes_neither_fabrics_nor_seeds():
    for plain, other in zip(plans(6, starts=("sine",)), plans(6, starts=("borrowed", "sine")),
                            strict=True):
        np.testing.assert_array_equal(plain.theta, other.theta)
        np.testing.assert_array_equal(plain.offset, other.offset)
        assert plain.seed == other.seed


def test_lenders_are_equally_likely_and_depend_on_seed_and_drape():
    chosen = [choose_lender(i, seed=1, candidates=[4, 7, 9]) for i in range(3000)]
    counts = [chosen.count(candidate) for candidate in (4, 7, 9)]
    assert sum(counts) == 3000 and max(abs(count - 1000) for count in counts) < 110
    assert chosen[:50] == [choose_lender(i, seed=1, candidates=[4, 7, 9]) for i in range(50)]
    assert chosen[:50] != [choose_lender(i, seed=2, candidates=[4, 7, 9]) for i in range(50)]


def test_drift_has_its_standard_deviation():
    offsets = np.array([p.offset for p in plans(500, drift=0.004)])
    assert abs(offsets.std() / 0.004 - 1) < 0.08
    assert not np.any([p.offset for p in plans(4, drift=0.0)])


def test_half_of_the_testers_are_common_ones_and_the_others_are_within_the_limits():
    settings = {"starts_per_fabric": 4, "testers_per_fabric": 2, "random_testers": 0.5,
                "testers": (SQUARE_RIG.name, DISC_RIG.name)}
    drapes = plans(800, **settings)
    rigs = [p.rig for p in drapes]
    assert rigs[0] == rigs[2] and rigs[1] == rigs[3]
    drawn = [rigs[k] for start in range(0, 800, 4) for k in (start, start + 1)]
    common = [rig for rig in drawn if rig in (SQUARE_RIG, DISC_RIG)]
    assert len(common) == pytest.approx(200, abs=35)
    assert common.count(DISC_RIG) == pytest.approx(len(common) / 2, abs=25)
    others = [rig for rig in drawn if rig not in (SQUARE_RIG, DISC_RIG)]
    size, plate = 1e3 * np.array([(rig.specimen_size, rig.plate_diameter) for rig in others]).T
    assert 200 <= size.min() < 220 and 380 < size.max() <= 400
    assert 60 <= plate.min() < 70 and 180 < plate.max() <= 200
    assert (size - plate).min() >= 40 - 1e-9
    assert {rig.specimen for rig in others} == {"square", "disc"}
    assert [p.rig for p in plans(8, **settings)] == rigs[:8]


def test_rectangles_are_drawn_within_the_limits_and_centred_on_their_plates():
    settings = {"random_testers": 0.25, "rectangles": 0.25, "testers": (DISC_RIG.name,)}
    drapes = plans(2000, **settings, drift=0.008)
    rigs = [p.rig for p in drapes]
    drawn = [rig for rig in rigs if rig.specimen == "rectangle"]
    assert len(drawn) == pytest.approx(500, abs=60)
    assert rigs.count(DISC_RIG) == pytest.approx(1000, abs=80)
    sides = 1e3 * np.array([rig.sides for rig in drawn])
    assert 140 <= sides.min() < 145 and 395 < sides.max() <= 400
    assert np.mean(sides[:, 0] > sides[:, 1]) == pytest.approx(0.5, abs=0.08)
    plate = 1e3 * np.array([rig.plate_diameter for rig in drawn])
    assert 60 <= plate.min() < 65 and 180 < plate.max() <= 200
    assert (sides - plate[:, None]).min() >= 40 - 1e-9
    for rig in drawn[:20]:
        assert named_tester(rig.name) == rig
    # An offset leaves half of the overhang, room for the coarsest mesh of a drape.
    share = np.array([np.hypot(*p.offset) / p.rig.least_overhang for p in drapes])
    assert share.max() == pytest.approx(0.5) and np.mean(share < 0.499) > 0.9


def test_without_rectangles_plans_are_what_they_were():
    settings = {"random_testers": 0.5, "testers": (SQUARE_RIG.name,)}
    plain, mixed = (plans(60, **settings, rectangles=share) for share in (0.0, 0.2))
    kept = [(one.rig, other.rig) for one, other in zip(plain, mixed, strict=True)
            if other.rig.specimen != "rectangle"]
    assert len(kept) > 40 and all(one == other for one, other in kept)


def test_both_faces_of_each_fabric_are_up():
    drapes = plans(400, starts_per_fabric=4, both_faces=True,
                   nuisances=NuisanceConfig(curl=5.0))
    faces = np.array([p.face for p in drapes]).reshape(100, 4)
    assert set(faces.ravel()) == {1, -1} and (np.abs(faces.sum(axis=1)) < 4).all()
    assert abs(faces.mean()) < 0.15
    curls = np.array([p.nuisances.curl_warp for p in drapes]).reshape(100, 4)
    assert np.allclose(faces * curls, (faces * curls)[:, :1]) and (curls != 0).all()
    assert {p.face for p in plans(8)} == {1}


@pytest.mark.parametrize(("changes", "complaint"), [
    ({"starts_per_fabric": 0}, "starts_per_fabric"),
    ({"starts": ("flat",)}, "flat.* must contain only lowered, sine, fold"),
    ({"starts": ()}, "must contain lowered or sine"),
    ({"starts": ("borrowed",)}, "nothing to borrow"),
    ({"testers": ("moon",)}, "moon"),
    ({"testers": ()}, "random_testers=0 .* be 1 without testers"),
    ({"random_testers": 0.7, "rectangles": 0.4}, "rectangles=0.4 .* at most 1"),
    ({"random_testers": -0.1}, "not be negative"), ({"rectangles": -0.1}, "not be negative"),
    ({"starts": ("sine", "borrowed"), "rectangles": 0.5}, "give a single name in testers"),
    ({"testers_per_fabric": 3}, "testers_per_fabric=3 must lie between 1 and"),
    ({"starts": ("sine", "borrowed"), "random_testers": 0.5}, "give a single name in testers")])
def test_nonsense_is_refused(changes, complaint):
    with pytest.raises(InputError, match=complaint):
        SamplingConfig(**changes)
