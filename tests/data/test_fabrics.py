"""Fabrics: tables, even stiffness, what differs between drapes of one; plans of drapes."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from common.command import compose_config
from data.dataset.config import Options, SamplingConfig, config_from_options
from data.dataset.plan import Stream, choose_lender, plan_drape, stream
from data.fabrics.fabrics import fabric_from_theta, from_theta, read_fabric_table, to_theta
from data.fabrics.nuisances import KINDS, NAMES, Kind, NuisanceConfig, Nuisances
from data.fabrics.prior import TablePrior, load_prior, log_stiffness, sample_admissible
from data.fabrics.prior.even import STIFFNESS, draw_fabric, draw_fabrics, moved
from sim.cloth import Laws
from sim.material import (
    BIAS,
    LINEAR,
    MICRO,
    RATIO,
    WARP,
    WEFT,
    Fabric,
    gravity_length,
    is_admissible,
)
from sim.rig import DISC_RIG, SQUARE_RIG, Rig
from sim.scene import make_specimen

HEADER = (
    "density[kg.m-2], linear warp[SI*1e9], linear weft[SI*1e9], linear diag[SI*1e9], "
    "nonlinear warp[SI*1e12], nonlinear weft[SI*1e12], nonlinear diag[SI*1e12]"
)
STIFF = "0.15, 9000, 4000, 6000, -900, -400, -600"
SOFT = "0.30, 2000, 1000, 1500, -20, -10, 15"
PRIOR = load_prior("vae")
COUNT = 2000
SHARE = 0.8
GAUSSIAN = load_prior("gaussian")


def write(path, *lines):
    path.write_text("\n".join(lines) + "\n")
    return path


def test_order_units_and_normalisation(tmp_path):
    table = read_fabric_table(write(tmp_path / "t.csv", HEADER, STIFF, SOFT))
    # 150 g/m² to 300 g/m² doubles the moduli; the file's order is warp, weft, bias.
    np.testing.assert_allclose(table.alpha[0], [18e-6, 12e-6, 8e-6])
    np.testing.assert_allclose(table.beta[0], [-1.8e-9, -1.2e-9, -0.8e-9])
    np.testing.assert_allclose(table.alpha[1], [2e-6, 1.5e-6, 1e-6])
    assert table.beta[1, 1] > 0
    np.testing.assert_allclose(table.density, [0.15, 0.30])


def test_repeated_rows_are_one_fabric(tmp_path):
    table = read_fabric_table(write(tmp_path / "t.csv", HEADER, STIFF, SOFT, "", STIFF, STIFF))
    assert len(table) == 2
    assert table.multiplicity.tolist() == [3, 1]


def test_multiplicity_column_counts(tmp_path):
    path = write(tmp_path / "t.csv", HEADER + ",rows in it", STIFF + ",4", SOFT + ",2")
    assert read_fabric_table(path).multiplicity.tolist() == [4, 2]


def test_columns_are_found_by_name(tmp_path):
    names, cells = HEADER.split(", "), STIFF.split(", ")
    shuffled = [", ".join(reversed(row)) for row in (names, cells)]
    there = read_fabric_table(write(tmp_path / "a.csv", *shuffled))
    here = read_fabric_table(write(tmp_path / "b.csv", HEADER, STIFF))
    np.testing.assert_array_equal(there.theta, here.theta)


def test_theta_and_back():
    alpha = np.array([[30e-6, 20e-6, 10e-6], [1e-6, 2e-6, 3e-6]])
    beta = np.array([[-90e-9, 20e-9, 0.0], [-1e-9, -2e-9, -3e-9]])
    theta = to_theta(alpha, beta)
    np.testing.assert_allclose(theta[0], [*np.log(alpha[0]), -3e-3, 1e-3, 0])
    for there, back in zip((alpha, beta), from_theta(theta), strict=True):
        np.testing.assert_allclose(back, there, rtol=1e-14)
    fabric = fabric_from_theta(theta[0])
    np.testing.assert_allclose(fabric.alpha, alpha[0])
    assert fabric.density == 0.3


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


def nuisances(config, count=2000):
    rng, other = np.random.default_rng(1), np.random.default_rng(2)
    return np.array([config.sample(rng, other).vector for _ in range(count)])


VARIED = NuisanceConfig(
    {"woven": Kind(membrane=(100.0, 1000.0), shear=(20.0, 100.0), curl=3.0, twist=1.0, skew=0.1,
                   uneven=(5.0, 10.0))},
    hysteresis=(5.0, 60.0), curl_specimen=1.0, size=1e-3, plate=3e-4, cut=0.02)


def test_without_spread_specimens_are_those_of_the_simulator():
    nuisances = NuisanceConfig().sample(np.random.default_rng(0), np.random.default_rng(1))
    placed = {"crease_azimuth": 0.0, "crease_distance": 0.0}  # of creases that there are not
    assert replace(nuisances, **placed) == Nuisances()
    assert nuisances.laws == Laws() and nuisances.rig(Rig()) == Rig()


def test_real_specimens_spread_as_the_configuration_states():
    options = compose_config("generate", ["nuisances=real"], schema=Options)
    config = config_from_options(options).sampling.nuisances
    columns = dict(zip(NAMES, nuisances(config).T, strict=True))
    kinds = columns["kind"].astype(int)
    assert np.bincount(kinds) / len(kinds) == pytest.approx(
        [config.cloth[name].share for name in KINDS], abs=0.03)
    for number, name in enumerate(KINDS):
        kind, mine = config.cloth[name], kinds == number
        low, high = kind.membrane
        plain = columns["membrane"][mine & (np.abs(columns["stretch"]) < 1.8)]  # without elastane
        assert np.mean((plain > low) & (plain < high)) == pytest.approx(0.95, abs=0.035)
        shear = (columns["shear"] * columns["membrane"])[mine] / 2.6
        assert (columns["shear"][mine] <= 1).all()
        assert np.median(shear) <= 1.15 * np.sqrt(np.prod(kind.shear))
    woven, knit, coated = (kinds == number for number in range(len(KINDS)))
    same = np.corrcoef(columns["curl_warp"][coated], columns["curl_weft"][coated])[0, 1]
    opposed = np.corrcoef(columns["curl_warp"][knit], columns["curl_weft"][knit])[0, 1]
    assert same > 0.8 and opposed < -0.2
    ratio = 100 * columns["hysteresis"] / (1 - columns["hysteresis"])  # HB/B, 1/m
    assert ratio.min() >= 10 and ratio.max() <= 60
    assert np.median(ratio) == pytest.approx(np.sqrt(10 * 60), rel=0.05)
    assert np.median(columns["uneven"][woven]) == pytest.approx(
        np.sqrt(6 * 24) * 20e-3 / gravity_length(np.sqrt(300) * MICRO, 0.3), rel=0.05)
    assert columns["size"].std() == pytest.approx(1e-3, rel=0.05)
    assert columns["cut"].std() == pytest.approx(np.radians(1), rel=0.05)


def test_kinds_of_cloth_are_those_of_their_stiffness():
    """A knit is not as stiff as canvas; a film that is has no shear of a cloth."""
    config = config_from_options(compose_config("generate", [], schema=Options)).sampling.nuisances
    rng = np.random.default_rng(0)
    for alpha, names in ((2e-6, {"woven", "knit"}), (400e-6, {"woven", "coated"})):
        drawn = [config.sample(rng, rng, alpha=alpha) for _ in range(400)]
        assert np.mean([KINDS[int(one.kind)] in names for one in drawn]) > 0.97
        # Curvature is that of strains that differ through a thickness.
        expected = np.sqrt(6 * 24) * 20e-3 / gravity_length(alpha, 0.3)
        assert np.median([one.uneven for one in drawn]) == pytest.approx(expected, rel=0.25)


def test_a_cloth_keeps_its_nuisances_and_its_specimens_have_their_own():
    config = SamplingConfig(starts_per_fabric=2, nuisances=VARIED)
    one, other, strange = (plan_drape(k, config=config, prior=load_prior("gaussian")).nuisances
                           for k in range(3))
    assert one.membrane == other.membrane != strange.membrane
    assert one.hysteresis == other.hysteresis != strange.hysteresis
    assert one.uneven == other.uneven and one.pattern != other.pattern
    assert one.size != other.size
    assert 0 < abs(one.curl_warp - other.curl_warp) < 5  # of the specimens
    assert one.curl_warp != strange.curl_warp


def test_the_other_face_has_the_opposite_curvature():
    up, down = (VARIED.sample(np.random.default_rng(1), np.random.default_rng(2), face=face)
                for face in (1, -1))
    assert up.curl_warp == -down.curl_warp != 0 and up.curl_weft == -down.curl_weft
    assert up.skew == -down.skew != 0 and up.curl_twist == down.curl_twist != 0
    assert up.hysteresis == down.hysteresis


@pytest.mark.parametrize("nominal", [Rig(), DISC_RIG, Rig((0.22, 0.3), 0.1)],
                         ids=lambda rig: rig.name)
def test_specimens_of_other_sizes_share_triangles_and_hold_their_own_plate(nominal):
    nuisances = Nuisances(size=2e-3, plate=-6e-4, cut=0.03)
    rig, plain = nuisances.rig(nominal), make_specimen(nominal, edge=6e-3)
    offset = (3e-3, -2e-3)
    specimen = make_specimen(rig, edge=6e-3, offset=offset)
    assert (specimen.mesh.faces == plain.mesh.faces).all()
    rest, areas = specimen.mesh.rest, specimen.mesh.areas
    if nominal.specimen != "disc":
        assert np.subtract(rig.sides, nominal.sides) == pytest.approx(2e-3)
        assert areas.sum() == pytest.approx(rig.specimen_area, rel=1e-9)
    held = specimen.held[specimen.mesh.faces].all(axis=1)
    assert areas[held].sum() == pytest.approx(np.pi * rig.plate_radius**2, rel=1e-6)
    assert 0.5 * (rest.max(0) + rest.min(0)) == pytest.approx(offset, abs=3e-4)
    if nominal.specimen != "disc":
        corner = rest[np.argmax(rest.sum(axis=1))] - offset
        diagonal = np.arctan2(*rig.sides[::-1])
        assert np.arctan2(*corner[::-1]) == pytest.approx(diagonal + 0.03, abs=1e-9)
    assert (areas > 0).all()


def plans(count, **changes):
    config = SamplingConfig(**changes)
    return [plan_drape(i, config=config, prior=GAUSSIAN) for i in range(count)]


def test_a_plan_depends_on_seed_and_index_only():
    ahead = plan_drape(7, config=SamplingConfig(seed=3), prior=GAUSSIAN)
    later = plans(8, seed=3)[7]
    for name in ("fabric", "start", "seed", "rejected"):
        assert getattr(ahead, name) == getattr(later, name)
    for name in ("theta", "offset"):
        np.testing.assert_array_equal(getattr(ahead, name), getattr(later, name))
    other = plan_drape(7, config=SamplingConfig(seed=4), prior=GAUSSIAN)
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
    assert 140 <= size.min() < 155 and 380 < size.max() <= 400
    assert 60 <= plate.min() < 70 and 220 < plate.max() <= 250
    assert 1.39 < (size / plate).min() and (size / plate).max() < 3.01
    assert all(rig.rim <= 6e-3 for rig in others)
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
    assert 140 <= sides.min() < 150 and 385 < sides.max() <= 400
    assert np.mean(sides[:, 0] > sides[:, 1]) == pytest.approx(0.5, abs=0.08)
    plate = 1e3 * np.array([rig.plate_diameter for rig in drawn])
    assert 60 <= plate.min() < 70 and 210 < plate.max() <= 250
    assert 1.39 < (sides / plate[:, None]).min() and (sides / plate[:, None]).max() < 3.01
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
                   nuisances=NuisanceConfig({"woven": Kind(curl=5.0)}))
    faces = np.array([p.face for p in drapes]).reshape(100, 4)
    assert set(faces.ravel()) == {1, -1} and (np.abs(faces.sum(axis=1)) < 4).all()
    assert abs(faces.mean()) < 0.15
    curls = np.array([p.nuisances.curl_warp for p in drapes]).reshape(100, 4)
    assert np.allclose(faces * curls, (faces * curls)[:, :1]) and (curls != 0).all()
    assert {p.face for p in plans(8)} == {1}


def test_a_specimen_is_draped_again_from_another_start():
    settings = {"starts_per_fabric": 4, "testers_per_fabric": 2,
                "nuisances": NuisanceConfig(size=1e-3)}
    own, shared = (plans(8, **settings, specimens_per_fabric=number) for number in (0, 2))
    assert len({p.nuisances.size for p in own}) == 8
    sizes = [p.nuisances.size for p in shared]
    assert sizes == [p.nuisances.size for k in (0, 4) for p in own[k : k + 2] * 2]
    assert len({p.seed for p in shared}) == 8
