"""The outline of a drape as an objective of refinement, and cloth laid on it."""

import numpy as np
import pytest
from cloths import waves

from drapenet.refine.outline import NUISANCES, Hem, OutlineRadii, hem_near
from drapenet.refine.springs import captured_shape
from drapenet.views.directions import AZIMUTH
from drapenet.views.outline import DrapeOutline, silhouettes
from sim.drape import drape
from sim.material import MICRO, Fabric
from sim.rig import DISC_RIG
from sim.scene import make_specimen

HEIGHT = 1.2  # m, of the camera
NUISANCE = np.array([0.02, 1e-3, -2e-3, 0.01, 1 / HEIGHT])


@pytest.fixture(scope="module")
def scene():
    return make_specimen(DISC_RIG, edge=8e-3)


def objective_of(positions: np.ndarray, edges: np.ndarray, **moved: float) -> OutlineRadii:
    """Comparison with the outline of a shape, with an azimuth that is not seen."""
    radius = silhouettes(positions, edges, np.array([HEIGHT]), zero=0.0)[0]
    radius[5] = np.nan
    return OutlineRadii(DrapeOutline(radius, HEIGHT), DISC_RIG, edges)


def test_a_shape_fits_its_outline_and_derivatives_are_exact(scene):
    shape, edges = waves(scene.mesh.rest), scene.mesh.edges
    objective = objective_of(shape, edges)
    assert np.abs(objective.residuals(shape, objective.start)).max() < 0.5  # 1 mm at the hem
    rng = np.random.default_rng(0)
    shape = shape + rng.normal(0, 5e-4, shape.shape)
    found = objective.linearised(shape, NUISANCE)
    np.testing.assert_array_equal(found.residuals, objective.residuals(shape, NUISANCE))
    assert len(found.residuals) == len(AZIMUTH) - 1
    h, moves = 1e-7, rng.normal(0, 1.0, (2, *shape.shape))
    expected = np.stack([(objective.residuals(shape + h * move, NUISANCE)
                          - objective.residuals(shape - h * move, NUISANCE)) / (2 * h)
                         for move in moves], axis=1)
    assert np.abs(found.along(moves) - expected).max() < 1e-4 * np.abs(expected).max()
    for k, name in enumerate(NUISANCES):
        step = 1e-5 * objective.scale * (np.arange(len(NUISANCES)) == k)
        ahead, back = (objective.residuals(shape, NUISANCE + s * step) for s in (1, -1))
        difference = (ahead - back) / (2 * step[k])
        assert np.abs(found.by_nuisance[:, k] - difference).max() < (
            1e-3 * np.abs(difference).max()), name


def test_the_captured_outline_in_the_specimen_s_axes_is_that_of_the_shape(scene):
    """A picture that is turned, moved and scaled gives the outline that it was made from."""
    shape, edges = waves(scene.mesh.rest), scene.mesh.edges
    turn, x, y, scale, _ = NUISANCE
    c, s = np.cos(turn), np.sin(turn)
    straight = silhouettes(shape, edges, np.array([HEIGHT]), zero=0.0)[0]
    seen = shape[:, :2] / (1 - shape[:, 2:] / HEIGHT) @ np.array([[c, s], [-s, c]])
    picture = np.column_stack([np.exp(scale) * seen + [x, y], 0 * shape[:, 2]])
    radius = silhouettes(picture, edges, np.array([np.inf]), zero=0.0)[0]
    objective = OutlineRadii(DrapeOutline(radius, HEIGHT), DISC_RIG, edges)
    assert objective.radius(NUISANCE) == pytest.approx(straight, abs=1e-3)


def test_cloth_laid_on_an_outline_has_it(scene):
    fabric = Fabric(np.full(3, 15 * MICRO), np.full(3, -2e-3 * 15 * MICRO))
    truth = drape(fabric, rig=DISC_RIG, edge=5e-3, seed=3)
    radius = silhouettes(truth.positions, truth.mesh.edges, np.array([HEIGHT]), zero=0.0)[0]
    hem = Hem(radius, 1 / HEIGHT, DISC_RIG)
    laid = captured_shape(fabric, hem, rig=DISC_RIG, edge=5e-3)
    found = silhouettes(laid.positions, laid.mesh.edges, np.array([HEIGHT]), zero=0.0)[0]
    assert np.median(np.abs(found - radius)) < 1.5e-3 and np.abs(found - radius).max() < 8e-3
    assert len(hem_near(laid.scene, laid.positions, hem, reach=4e-3)) > 75  # of 89 on the border
    assert np.abs(laid.positions[:, 2].min() - truth.positions[:, 2].min()) < 0.01
