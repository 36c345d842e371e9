"""Captured surfaces: their points, the objective for registered drapes, cloth pulled onto them."""

import numpy as np
import pytest
from cloths import waves

from common.errors import InputError
from data.render.cameras import QUARTERS, nominal_camera
from data.render.rays import DepthRenderer
from drapenet.refine.depth import DepthViews
from drapenet.refine.positions import RobustPositions
from drapenet.surface.shape import Cloud, distances
from drapenet.surface.springs import MAX_HINGE_ANGLE, Surface, captured_shape, uncrumpled
from drapenet.views.located import LocatedViews
from sim.draping import drape
from sim.energies.hinges import Hinges, hinge_angles
from sim.material import MICRO, Fabric
from sim.rig import Rig
from sim.scene import Scene, make_specimen


def test_derivatives_match_central_differences(disc):
    target = waves(disc.mesh.rest)
    objective = RobustPositions(target, vertices=~disc.held, sigma=1e-3, limit=2.0)
    rng = np.random.default_rng(0)
    positions = waves(disc.mesh.rest, depth=0.018) + rng.normal(0, 1e-3, target.shape)
    found = objective.linearised(positions, np.zeros(0))
    np.testing.assert_array_equal(found.residuals, objective.residuals(positions, np.zeros(0)))
    moves = rng.normal(0, 1.0, (2, *positions.shape))
    h = 1e-8
    expected = np.stack([(objective.residuals(positions + h * m, np.zeros(0))
                          - objective.residuals(positions - h * m, np.zeros(0))) / (2 * h)
                         for m in moves], axis=1)
    assert np.abs(found.along(moves) - expected).max() < 1e-4 * np.abs(expected).max()


def test_raw_points_get_the_normals_of_the_surface():
    rng = np.random.default_rng(1)
    rest = rng.uniform(-0.15, 0.15, (12000, 2))
    cloud = Cloud.of_points(np.column_stack([rest, np.zeros(len(rest))]))
    assert np.abs(cloud.normals[:, 2]).min() > 1 - 1e-9
    above = np.array([[0.0, 0.0, 2e-3], [0.25, 0.0, 0.0]])  # over the surface, and beyond its hem
    assert distances(cloud, above) == pytest.approx([2e-3, 0.1], abs=2e-3)
    with pytest.raises(InputError, match="too few"):
        Cloud.of_points(np.zeros((20, 3)))


def bent(scene: Scene, positions: np.ndarray) -> np.ndarray:
    hinges = Hinges(scene.mesh, scene.active)
    return np.abs(hinge_angles(positions.ravel(), hinges.dofs)) > MAX_HINGE_ANGLE


def test_crumpled_cloth_is_smoothed_and_other_cloth_stays():
    scene = make_specimen(Rig(), edge=8e-3)
    rest = scene.mesh.rest
    crumpled = np.column_stack([rest, np.zeros(len(rest))])
    far = np.linalg.norm(rest, axis=1) > 0.09
    crumpled[far, 2] = np.random.default_rng(0).uniform(-0.02, 0.02, far.sum())
    assert bent(scene, crumpled).sum() > 50
    smooth = uncrumpled(scene, crumpled)
    assert not bent(scene, smooth).any()
    np.testing.assert_array_equal(smooth[scene.held], crumpled[scene.held])
    wavy = np.column_stack([rest, 0.01 * np.sin(40 * rest[:, 0])])
    assert not bent(scene, wavy).any()
    np.testing.assert_array_equal(uncrumpled(scene, wavy), wavy)


def test_soft_cloth_takes_the_captured_folds():
    fabric = Fabric(np.full(3, 5 * MICRO), np.full(3, -2e-3 * 5 * MICRO))
    truth = drape(fabric, edge=4e-3, seed=3)
    camera, turn = nominal_camera(), 0.4
    views = DepthRenderer(truth.positions, truth.faces).views(camera, turn)
    located = LocatedViews.exact(views, camera, Rig(), QUARTERS)
    objective = DepthViews(located, make_specimen(Rig(), edge=4e-3).mesh.faces, turn=turn)
    surface = Surface(*objective.points(objective.start), Rig())
    shape = captured_shape(fabric, surface, edge=4e-3)
    seen = objective.render(shape.positions, objective.start)
    apart = np.abs(seen - views)[(seen > 0) & (views > 0)]
    assert np.median(apart) < 0.5e-3 and np.quantile(apart, 0.9) < 3e-3
    assert shape.self_intersections < 5
