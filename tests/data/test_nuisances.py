import numpy as np
import pytest

from data.dataset.config import Options, SamplingConfig, config_from_options
from data.dataset.plan import plan_drape
from data.fabrics.nuisances import LOGARITHMIC, NAMES, NuisanceConfig, Nuisances
from data.fabrics.prior import load_prior
from sim.cloth import Laws
from sim.rig import DISC_RIG, Rig
from sim.scene import make_specimen


def drawn(config, count=2000):
    rng, other = np.random.default_rng(1), np.random.default_rng(2)
    return np.array([config.sample(rng, other).vector for _ in range(count)])


def test_without_spread_specimens_are_those_of_the_simulator():
    nuisances = NuisanceConfig().sample(np.random.default_rng(0), np.random.default_rng(1))
    assert nuisances == Nuisances()
    assert nuisances.laws == Laws() and nuisances.rig(Rig()) == Rig()


def test_real_specimens_spread_as_the_configuration_states():
    from common.command import compose_config

    options = compose_config("generate", ["nuisances=real"], schema=Options)
    columns = dict(zip(NAMES, drawn(config_from_options(options).sampling.nuisances).T,
                       strict=True))
    assert np.mean((columns["membrane"] > 400) & (columns["membrane"] < 2500)) == pytest.approx(
        0.95, abs=0.015)
    assert np.log(columns["membrane"]).mean() == pytest.approx(np.log(400 * 2500) / 2, abs=0.04)
    assert 0.2 <= columns["shear"].min() < 0.21 and 0.99 < columns["shear"].max() <= 1
    ratio = 100 * columns["hysteresis"] / (1 - columns["hysteresis"])  # HB/B, 1/m
    assert ratio.min() >= 5 and ratio.max() <= 60
    assert np.median(ratio) == pytest.approx(np.sqrt(5 * 60), rel=0.05)
    assert columns["curl_warp"].std() == pytest.approx(np.hypot(np.sqrt(2) * 5, 1), rel=0.06)
    assert columns["size"].std() == pytest.approx(1e-3, rel=0.05)
    assert columns["cut"].std() == pytest.approx(np.radians(1), rel=0.05)


def test_a_cloth_keeps_its_nuisances_and_its_specimens_have_their_own():
    config = SamplingConfig(starts_per_fabric=2, nuisances=NuisanceConfig(
        membrane=(100, 1000), hysteresis=(5, 60), curl=5.0, curl_specimen=1.0, size=1e-3))
    one, other, strange = (plan_drape(k, config=config, prior=load_prior("gaussian")).nuisances
                           for k in range(3))
    assert one.membrane == other.membrane != strange.membrane
    assert one.hysteresis == other.hysteresis != strange.hysteresis
    assert one.size != other.size
    assert 0 < abs(one.curl_warp - other.curl_warp) < 5  # of the specimens
    assert one.curl_warp != strange.curl_warp


def test_the_other_face_has_the_opposite_curvature():
    config = NuisanceConfig(hysteresis=(5, 60), curl=5.0, curl_specimen=1.0)
    up, down = (config.sample(np.random.default_rng(1), np.random.default_rng(2), face=face)
                for face in (1, -1))
    assert up.curl_warp == -down.curl_warp != 0 and up.curl_weft == -down.curl_weft
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


def test_deviations_and_means_are_those_of_samples():
    config = NuisanceConfig(membrane=(100.0, 1000.0), shear=(0.2, 1.0), hysteresis=(5.0, 60.0),
                            curl=3.0, size=1e-3, plate=3e-4, cut=0.02)
    values = drawn(config, 4000)
    logarithmic = [name in LOGARITHMIC for name in NAMES]
    values[:, logarithmic] = np.log(values[:, logarithmic])
    means, deviations = ([table[name] for name in NAMES]
                         for table in (config.means, config.deviations))
    assert (np.abs(values.mean(axis=0) - means) < 0.06 * values.std(axis=0)).all()
    assert deviations == pytest.approx(values.std(axis=0), rel=0.05)
