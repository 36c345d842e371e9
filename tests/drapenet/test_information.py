"""What depth views tell: against pictures of a drape that has moved, and by its scaling."""

import numpy as np
import pytest
from scipy.ndimage import maximum_filter, minimum_filter

from data.cameras import CameraRig
from data.fabrics import THETA_NAMES
from data.render import render_views
from drapenet.information import (
    CAMERA,
    SPECIMEN,
    bounds,
    bounds_alone,
    combinations,
    depth_information,
)
from sim.drape import drape
from sim.material import Fabric
from sim.newton import NewtonOptions
from sim.sensitivity import sensitivities

CAM = CameraRig.load().nominal().resized(120, 90)
FABRIC = Fabric([60e-6, 25e-6, 30e-6], [-150e-9, -50e-9, -80e-9])
TURN = 0.4


@pytest.fixture(scope="module")
def draped():
    return drape(FABRIC, edge=8e-3)


@pytest.fixture(scope="module")
def information(draped):
    return depth_information(draped, CAM, orientation=TURN)


def test_information_is_what_pictures_of_moved_drapes_show(draped, information):
    """The diagonal: squared differences of depths over the noise, one pixel in a hundred."""
    moves = sensitivities(draped).positions
    here = render_views(draped.positions, draped.faces, CAM, TURN)
    # Pixels at a silhouette or a jump from fold to fold are not compared.
    nearest, farthest = (f(here, (1, 3, 3)) for f in (minimum_filter, maximum_filter))
    smooth = (nearest > 0) & (farthest - nearest < 12e-3)
    assert smooth.sum() == information.pixels
    for k, step in ((0, 0.01), (4, 1e-4)):
        views = [render_views(draped.positions + s * moves[k], draped.faces, CAM, TURN)
                 for s in (step, -step)]
        change = (views[0] - views[1])[smooth].astype(float) / (2 * step)
        expected = (change**2).sum() / (1e-3**2 * 100)
        assert information.fisher[k, k] == pytest.approx(expected, rel=0.05)


def test_noise_and_fewer_pixels_widen_the_bounds(draped, information):
    other = depth_information(draped, CAM, orientation=TURN, noise=2e-3,
                              pixels_per_measurement=400.0)
    assert bounds(other.covariance()) == pytest.approx(4 * bounds(information.covariance()))


def test_what_is_unknown_costs(information):
    assert information.ok and information.names[:6] == THETA_NAMES
    known, specimen, camera = (information.covariance(unknown)
                               for unknown in ((), SPECIMEN, (*SPECIMEN, *CAMERA)))
    for less, more in ((known, specimen), (specimen, camera)):
        assert np.linalg.eigvalsh(more - less).min() > -1e-9 * np.linalg.eigvalsh(more).max()
        assert (bounds(more) > 1.0001 * bounds(less)).all()
    assert (bounds_alone(specimen) < bounds(specimen)).all()


def test_combinations_are_independent_and_ordered(information):
    covariance = information.covariance()
    scale = np.repeat([0.9, 1.8e-3], 3)
    deviations, weights = combinations(covariance, scale)
    assert (np.diff(deviations) > 0).all()
    assert weights @ (covariance / np.outer(scale, scale)) @ weights.T == pytest.approx(
        np.diag(deviations**2), abs=1e-9 * deviations[-1] ** 2)


def test_a_drape_without_derivatives_says_so():
    result = drape(FABRIC, edge=0.01, options=NewtonOptions(max_iterations=1))
    found = depth_information(result, CAM)
    assert not found.ok and "no equilibrium" in found.message
    assert np.isnan(bounds(found.covariance())).all()
