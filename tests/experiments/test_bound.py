"""What depth views determine: against pictures of a drape that has moved, and by its scaling."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import maximum_filter, minimum_filter

from data.fabrics.fabrics import THETA_NAMES
from data.fabrics.nuisances import LOGARITHMIC, NAMES, NuisanceConfig, Nuisances
from data.fabrics.prior import load_prior
from data.render.cameras import nominal_camera
from data.render.rays import DepthRenderer
from drapenet.refine.unknowns import law_moves
from experiments.estimation.bound import (
    CAMERA,
    SETUP,
    SPECIMEN,
    Information,
    bounds,
    depth_information,
    joint_covariance,
    moves_with_plate,
    moves_with_size,
)
from experiments.estimation.in_plane import logarithms, with_known
from sim.draping import drape, follow
from sim.material import DRAPE_CURVATURE, Fabric, secant
from sim.mesh.specimen import share_of_offset
from sim.rig import Rig
from sim.scene import make_specimen
from sim.sensitivity import Tangent, sensitivities
from sim.sensitivity.rest_shape import moves_with_offset
from sim.solver.newton import NewtonOptions

CAM = nominal_camera().resized(120, 90)
FABRIC = Fabric([60e-6, 25e-6, 30e-6], [-150e-9, -50e-9, -80e-9])
TURN = 0.4
EDGE = 8e-3
TIGHT = NewtonOptions(residual=1e-9, step=1e-7)
NUISANCES = Nuisances(membrane=300.0, shear=0.5, hysteresis=0.2, curl_warp=2.0, curl_weft=-1.0,
                      size=1e-3, plate=3e-4, cut=0.02)
RIG = NUISANCES.rig(Rig())
OFFSET = (2e-3, -1e-3)
SPREAD = NuisanceConfig(membrane=(100.0, 1000.0), shear=(0.2, 1.0), hysteresis=(5.0, 60.0),
                        curl=3.0, size=1e-3, plate=3e-4, cut=0.02)


@pytest.fixture(scope="module")
def draped():
    return drape(FABRIC, edge=EDGE)


@pytest.fixture(scope="module")
def information(draped):
    return depth_information(draped, CAM, orientation=TURN)


@pytest.fixture(scope="module")
def specimen():
    """A drape with all nuisances."""
    return drape(FABRIC, edge=EDGE, rig=RIG, laws=NUISANCES.laws, offset=OFFSET, options=TIGHT)


@pytest.fixture(scope="module")
def tangent(specimen):
    return Tangent.of(specimen)


def agree(found, drapes, distance):
    """Whether ``found`` (V, 3) is the difference of two drapes over its ``distance``."""
    assert all(drape.converged for drape in drapes)
    expected = (drapes[0].positions - drapes[1].positions) / distance
    return np.linalg.norm(found - expected) < 0.02 * np.linalg.norm(expected)


def test_information_is_what_pictures_of_moved_drapes_show(draped, information):
    """The diagonal: squared differences of depths over the noise, one pixel in a hundred."""
    moves = sensitivities(draped).positions
    here = DepthRenderer(draped.positions, draped.faces).views(CAM, TURN)
    # Pixels at a silhouette or a jump from fold to fold are not compared.
    nearest, farthest = (f(here, (1, 3, 3)) for f in (minimum_filter, maximum_filter))
    smooth = (nearest > 0) & (farthest - nearest < 12e-3)
    assert smooth.sum() == information.pixels
    for k, step in ((0, 0.01), (4, 1e-4)):
        views = [DepthRenderer(draped.positions + s * moves[k], draped.faces).views(CAM, TURN)
                 for s in (step, -step)]
        change = (views[0] - views[1])[smooth].astype(float) / (2 * step)
        expected = (change**2).sum() / (1e-3**2 * 100)
        assert information.fisher[k, k] == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize(("name", "step"), [
    ("membrane", 0.02), ("shear", 0.02), ("hysteresis", 0.001), ("curl_warp", 0.04),
    ("curl_weft", 0.04)])
def test_moves_with_the_energies_of_the_cloth(specimen, tangent, name, step):
    value = getattr(NUISANCES, name)
    ends = [value * np.exp(s) if name in LOGARITHMIC else value + s for s in (step, -step)]
    laws = [replace(NUISANCES, **{name: end}).laws for end in ends]
    origin = specimen.laws.bending.origin
    drapes = [follow(specimen, FABRIC, options=TIGHT,
                     laws=replace(one, bending=replace(one.bending, origin=origin)))
              for one in laws]
    assert agree(law_moves(tangent, NUISANCES, [name])[name], drapes, 2 * step)


def test_moves_with_the_specimen_and_its_plate(specimen, tangent):
    def settled(rig, offset):
        there = make_specimen(rig, edge=EDGE, offset=offset)
        positions = specimen.positions.copy()
        positions[there.held] = rig.place(there.mesh.rest[there.held])
        return follow(replace(specimen, rig=rig).at(positions, there.mesh), FABRIC, options=TIGHT)

    step = 1e-5  # ten times this jumps to other folds
    for move, change in zip(moves_with_offset(tangent, RIG), step * np.eye(2), strict=True):
        assert agree(move, [settled(RIG, OFFSET + s * change) for s in (1, -1)], 2 * step)
    for move, name in ((moves_with_size(tangent, RIG)[0], "sides"),
                       (moves_with_plate(tangent, RIG), "plate_diameter")):
        rigs = [replace(RIG, **{name: np.add(getattr(RIG, name), s)}) for s in (step, -step)]
        assert agree(move, [settled(rig, OFFSET) for rig in rigs], 2 * step)


def test_moves_with_the_cut(specimen, tangent):
    """Against drapes whose mesh turns at the border only, so that the folds stay where they are."""
    x, y = (specimen.rest - OFFSET).T
    share = np.where(specimen.held, 0.0, share_of_offset(specimen.rest, RIG, OFFSET))

    def settled(angle):
        turned = angle * share[:, None] * np.column_stack([-y, x])
        mesh = specimen.mesh.with_rest(specimen.rest + turned)
        return follow(specimen.at(specimen.positions, mesh), FABRIC, options=TIGHT)

    assert agree(moves_with_size(tangent, RIG)[1], [settled(s) for s in (1e-4, -1e-4)], 2e-4)


def test_noise_and_fewer_pixels_widen_the_bounds(draped, information):
    other = depth_information(draped, CAM, orientation=TURN, noise=2e-3,
                              pixels_per_measurement=400.0)
    assert bounds(other.covariance()) == pytest.approx(4 * bounds(information.covariance()))


def test_what_is_unknown_costs(specimen):
    found = depth_information(specimen, CAM, nuisances=NUISANCES, orientation=TURN)
    assert found.ok and found.names == (*THETA_NAMES, *SPECIMEN, *CAMERA, *SETUP, *NAMES)
    prior, own = load_prior("gaussian").covariance, SPREAD.deviations
    pose = dict.fromkeys((*SPECIMEN, *CAMERA), np.inf)
    less = [found.posterior(prior, unknown) for unknown in (
        {}, pose, pose | {"hysteresis": own["hysteresis"]}, pose | own)]
    more = [*less[1:], found.covariance((*pose, *own))]
    scale = np.sqrt(np.diag(prior))
    for a, b in zip(less, more, strict=True):
        difference = (b - a) / np.outer(scale, scale)
        assert np.linalg.eigvalsh(difference).min() > -1e-8
        assert (bounds(b) > 1.00001 * bounds(a)).all()
    assert (bounds(less[-1]) < scale).all()
    # A prior that leaves everything open, or nothing.
    known = dict.fromkeys(own, 1e-12)
    np.testing.assert_allclose(found.posterior(prior, pose | known), less[1], rtol=1e-6)
    np.testing.assert_allclose(found.posterior(1e12 * prior, dict.fromkeys((*pose, *own), np.inf)),
                               more[-1], rtol=1e-3)


def test_deviations_of_nuisances_are_those_of_their_samples():
    rng = np.random.default_rng(0)
    drawn = np.array([SPREAD.sample(rng, rng).vector for _ in range(4000)])
    logarithmic = [name in LOGARITHMIC for name in NAMES]
    drawn[:, logarithmic] = np.log(drawn[:, logarithmic])
    found = SPREAD.deviations
    means = [SPREAD.means[name] for name in NAMES]
    assert (np.abs(drawn.mean(axis=0) - means) < 0.06 * drawn.std(axis=0)).all()
    assert [found[name] for name in NAMES] == pytest.approx(drawn.std(axis=0), rel=0.05)


def test_a_drape_without_derivatives_says_so():
    result = drape(FABRIC, edge=0.01, options=NewtonOptions(max_iterations=1))
    found = depth_information(result, CAM)
    assert not found.ok and "no equilibrium" in found.message
    assert np.isnan(bounds(found.covariance())).all()


def test_captures_of_one_fabric_share_what_is_unknown_of_its_cloth(specimen):
    found = depth_information(specimen, CAM, nuisances=NUISANCES)
    prior = np.linalg.inv(load_prior("gaussian").covariance)
    pose = dict.fromkeys((*SPECIMEN, *CAMERA), np.inf)
    known = {name: SPREAD.deviations[name] for name in NAMES}
    one, two = (joint_covariance([found] * n, prior, separate=pose, shared=known) for n in (1, 2))
    assert np.allclose(one[:6, :6], found.posterior(load_prior("gaussian").covariance,
                                                    pose | known))
    # The same views twice are views with twice the information, less what is known beforehand.
    beforehand = np.zeros(one.shape)
    beforehand[:6, :6] = prior
    beforehand[6:, 6:] = np.diag([d**-2 for d in known.values()])
    assert np.allclose(np.linalg.inv(two), 2 * np.linalg.inv(one) - beforehand, rtol=1e-6,
                       atol=1e-6 * np.abs(beforehand).max())
    alone = joint_covariance([found] * 2, prior, separate=pose | known)
    assert (np.diag(alone)[:6] < np.diag(two)[:6]).all()


def test_known_stretch_and_shear_act_like_narrower_nuisances():
    names = (*THETA_NAMES, *LOGARITHMIC)
    columns = np.random.default_rng(0).standard_normal((30, len(names)))
    found = Information(names, columns.T @ columns, 30, True, "")
    prior, (membrane, ratio) = load_prior("gaussian").covariance, (0.5, 0.4)
    narrow = dict(zip(LOGARITHMIC, ((membrane**-2 + 0.2**-2) ** -0.5, ratio), strict=True))
    wide = dict(zip(LOGARITHMIC, (membrane, ratio), strict=True))
    assert with_known(found, {"stretch": 0.2}).posterior(prior, wide) == pytest.approx(
        found.posterior(prior, narrow))
    # The shear's stiffness is the ratio's times the membrane's.
    both = with_known(found, {"stretch": 1e-5, "shear": 0.1}).posterior(prior, wide)
    alone = {LOGARITHMIC[0]: 1e-5, LOGARITHMIC[1]: (ratio**-2 + 0.1**-2) ** -0.5}
    assert both == pytest.approx(found.posterior(prior, alone), rel=1e-4)


def test_logarithms_are_of_alpha_and_of_the_stiffness_in_a_drape():
    theta = np.r_[np.log(FABRIC.alpha), FABRIC.beta / FABRIC.alpha]
    assert np.exp(logarithms(theta)) == pytest.approx(np.r_[
        FABRIC.alpha, secant(DRAPE_CURVATURE, FABRIC.alpha, FABRIC.beta)])
