"""Captured shapes: cloth pulled onto captured points."""

import numpy as np
import pytest

from data.render.cameras import nominal_camera
from data.render.rays import QUARTERS, DepthRenderer
from drapenet.refine.depth import DepthViews
from drapenet.refine.springs import MAX_HINGE_ANGLE, captured_shape, smoothed
from drapenet.views.located import LocatedViews
from sim.drape import drape
from sim.energies.hinges import Hinges, hinge_angles
from sim.material import MICRO, Fabric
from sim.rig import Rig
from sim.scene import Scene, make_specimen


@pytest.fixture
def scene() -> Scene:
    specimen = make_specimen(Rig(), edge=8e-3)
    return Scene(mesh=specimen.mesh, held=specimen.held, obstacles=())


def bent(scene: Scene, positions: np.ndarray) -> np.ndarray:
    hinges = Hinges(scene.mesh, scene.active)
    return np.abs(hinge_angles(positions.ravel(), hinges.dofs)) > MAX_HINGE_ANGLE


def test_crumpled_cloth_is_smoothed_and_held_cloth_stays(scene: Scene) -> None:
    flat = np.column_stack([scene.mesh.rest, np.zeros(len(scene.mesh.rest))])
    crumpled = flat.copy()
    far = np.linalg.norm(scene.mesh.rest, axis=1) > 0.09
    crumpled[far, 2] = np.random.default_rng(0).uniform(-0.02, 0.02, far.sum())
    assert bent(scene, crumpled).sum() > 50
    smooth = smoothed(scene, crumpled)
    assert not bent(scene, smooth).any()
    np.testing.assert_array_equal(smooth[scene.held], flat[scene.held])


def test_cloth_that_is_not_crumpled_stays_as_it_is(scene: Scene) -> None:
    wavy = np.column_stack([scene.mesh.rest, 0.01 * np.sin(40 * scene.mesh.rest[:, 0])])
    assert not bent(scene, wavy).any()
    np.testing.assert_array_equal(smoothed(scene, wavy), wavy)


def test_soft_cloth_takes_the_captured_folds() -> None:
    fabric = Fabric(np.full(3, 5 * MICRO), np.full(3, -2e-3 * 5 * MICRO))
    truth = drape(fabric, edge=4e-3, seed=3)
    camera, turn = nominal_camera(), 0.4
    views = DepthRenderer(truth.positions, truth.faces).views(camera, turn)
    specimen = {"rig": Rig(), "edge": 4e-3}
    located = LocatedViews.exact(views, camera, Rig(), QUARTERS)
    objective = DepthViews(located, make_specimen(**specimen).mesh.faces, turn=turn)
    shape = captured_shape(fabric, *objective.points(objective.start), **specimen)
    seen = objective.render(shape.positions, objective.start)
    apart = np.abs(seen - views)[(seen > 0) & (views > 0)]
    assert np.median(apart) < 0.5e-3 and np.quantile(apart, 0.9) < 3e-3
    assert shape.self_intersections < 5
