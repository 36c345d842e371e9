"""Objectives: values that are known, and derivatives against differences."""

import math

import numpy as np
import pytest

from common.types import Turns
from data.render.cameras import QUARTERS, Camera, nominal_camera
from data.render.rays import DepthRenderer
from drapenet.refine.depth import BORDER, EDGE, FOCAL, POSE, DepthViews, DepthWeights, table_names
from drapenet.refine.objective import (
    fit_nuisances,
    huber,
    value,
)
from drapenet.surface.springs import surface_positions
from drapenet.views.located import LocatedViews
from sim.mesh import grid_faces
from sim.rig import Rig


def dome(cells: int = 30) -> tuple[np.ndarray, np.ndarray]:
    """A smooth bumpy sheet over the plate, without folds that hide others."""
    side = np.linspace(-0.1, 0.1, cells + 1)
    x, y = (grid.ravel() for grid in np.meshgrid(side, side, indexing="ij"))
    z = -3.0 * (x**2 + y**2) - 0.006 * np.sin(30 * x) * np.cos(25 * y + 0.4)
    return np.column_stack([x, y, z]), grid_faces(np.eye(cells, dtype=bool))


def located(
    views: np.ndarray, camera: Camera, turns: Turns = QUARTERS
) -> LocatedViews:
    return LocatedViews.exact(views, camera, Rig(), turns)


@pytest.fixture(scope="module")
def camera() -> Camera:
    return nominal_camera()


@pytest.fixture(scope="module")
def compared(camera) -> tuple[np.ndarray, DepthViews]:
    positions, faces = dome()
    views = DepthRenderer(positions, faces).views(camera, 0.3)
    return positions, DepthViews(located(views, camera), faces, turn=0.3)


def test_robust_residuals_and_their_derivatives():
    r, limit = np.array([-7.0, -1.5, 0.0, 0.3, 1.9, 2.1, 40.0]), 2.0
    bent, slope = huber(r, limit)
    step = 1e-6
    differences = (huber(r + step, limit)[0] - huber(r - step, limit)[0]) / (2 * step)
    assert slope == pytest.approx(differences, rel=1e-6, abs=1e-9)
    expected = np.where(np.abs(r) > limit, limit * (np.abs(r) - limit / 2), r**2 / 2)
    assert bent**2 / 2 == pytest.approx(expected)


def test_a_drape_fits_its_own_views(compared):
    positions, objective = compared
    residuals = objective.residuals(positions, objective.start)
    # Views are kept in single precision; the border is smoothed by a fraction of a pixel.
    assert value(residuals) < 0.02 * len(residuals) / 10
    moved = objective.residuals(positions + np.array([0, 0, 5e-3]), objective.start)
    assert value(moved) > 100 * value(residuals)


def test_what_is_compared_is_what_is_rendered(compared, camera):
    positions, objective = compared
    expected = DepthRenderer(positions, objective._faces).views(camera, 0.3)
    rendered = objective.render(positions, objective.start)
    both = (rendered > 0) & (expected > 0)
    assert both.sum() > 0.999 * (expected > 0).sum()
    assert np.abs(rendered - expected)[both].max() < 1e-5


@pytest.mark.parametrize("name", [*POSE, *table_names(4), FOCAL, BORDER])
def test_depth_derivatives_by_pose(compared, name):
    """A step aside of one parameter alone, so that the residuals speak of it."""
    positions, objective = compared
    k = objective.nuisances.index(name)
    there, step = objective.start.copy(), np.zeros(len(objective.start))
    there[k] += objective.scale[k]
    step[k] = 0.05 * objective.scale[k]
    found = objective.linearised(positions, there)
    gradient = float(found.by_nuisance[:, k] @ found.residuals)
    difference = (value(objective.residuals(positions, there + step))
                  - value(objective.residuals(positions, there - step))) / (2 * step[k])
    # Pixels that come into sight or leave it are not in the derivative.
    size = np.linalg.norm(found.by_nuisance[:, k]) * np.linalg.norm(found.residuals)
    assert abs(gradient - difference) < 0.2 * size
    assert abs(difference) > 0.5 * size


def test_views_of_any_turns_are_compared(camera):
    positions, faces = dome()
    turns = np.array([0.0, 0.9, 2.0])
    views = DepthRenderer(positions, faces).views(camera, 0.3, turns)
    objective = DepthViews(located(views, camera, turns), faces, turn=0.3)
    assert objective.nuisances == (*POSE, "table_1", "table_2", FOCAL, BORDER)
    there = objective.start.copy()
    there[objective.nuisances.index("table_2")] = 0.05
    values = [value(objective.residuals(positions, n)) for n in (objective.start, there)]
    assert values[1] > 10 * values[0]


def test_pixels_count_by_the_area_of_a_cell(camera):
    positions, faces = dome()
    views = DepthRenderer(positions - [0, 0, 2e-4], faces).views(camera, 0.0)
    fine, coarse = (DepthViews(located(views, camera), faces, weights=DepthWeights(
        border_sigma=np.inf).on_mesh(edge)) for edge in (EDGE, 2 * EDGE))
    costs = [value(d.residuals(positions, d.start)) for d in (fine, coarse)]
    assert costs[0] > 0.5
    assert costs[0] == pytest.approx(4 * costs[1])


def test_depth_derivatives_along_moves_of_single_pixels(camera):
    positions, faces = dome()
    views = DepthRenderer(positions, faces).views(camera) + np.float32(0)
    weights = DepthWeights(limit=1.0, border_sigma=np.inf, border_limit=np.inf)
    objective = DepthViews(located(views, camera), faces, weights=weights)
    x, y, _ = positions.T
    moves = np.stack([np.column_stack([np.sin(20 * y), 0 * x, np.cos(15 * x)]), positions])
    found = objective.linearised(positions, objective.start)
    step = 1e-6
    for move, column in zip(moves, found.along(moves).T, strict=True):
        plus, minus = (objective.residuals(positions + sign * step * move, objective.start)
                       for sign in (1, -1))
        assert len(plus) == len(minus) == len(column)
        difference = (plus - minus) / (2 * step)
        close = np.abs(difference - column) < 1e-3 * np.abs(column).max()
        assert close.mean() > 0.99  # the others' rays change to the next triangle


def test_turn_and_pose_are_found_from_one_shape(compared):
    positions, objective = compared
    off = np.array([0.05, 0.01, -0.008, 3e-3, -2e-3, 2e-3, 0, 0, 0, 0.01, 1.0])
    found = fit_nuisances(objective, positions, objective.start + off)
    assert np.abs((found - objective.start) / objective.scale)[:6].max() < 0.15


def test_points_of_the_views_lie_on_the_shape(compared):
    _, objective = compared
    points, normals = objective.points(objective.start)
    x, y, z = points.T
    height = -3.0 * (x**2 + y**2) - 0.006 * np.sin(30 * x) * np.cos(25 * y + 0.4)
    assert np.abs(z - height).max() < 5e-4  # between the vertices the mesh is flat
    assert np.linalg.norm(normals, axis=1) == pytest.approx(1.0)
    assert (normals[:, 2] > 0.3).mean() > 0.99  # seen from above


def test_a_specimen_is_laid_on_a_cone_at_its_own_arc_lengths():
    rig = Rig()
    slope = math.radians(50)
    rng = np.random.default_rng(3)
    arc, azimuth = rng.uniform(0, 0.18, 60000), rng.uniform(0, 2 * np.pi, 60000)
    radius = rig.plate_radius + arc * math.cos(slope)
    cone = np.column_stack([radius * np.cos(azimuth), radius * np.sin(azimuth),
                            -arc * math.sin(slope)])
    disc = rng.uniform(0, rig.plate_radius, 20000), rng.uniform(0, 2 * np.pi, 20000)
    top = np.column_stack([disc[0] * np.cos(disc[1]), disc[0] * np.sin(disc[1]), 0 * disc[0]])
    side = np.linspace(-0.15, 0.15, 31)
    rest = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    placed = surface_positions(rest, np.concatenate([cone, top]), rig)
    beyond = np.maximum(np.linalg.norm(rest, axis=1) - rig.plate_radius, 0)
    reach = np.hypot(placed[:, 0], placed[:, 1])
    outside = beyond > 0
    expected = rig.plate_radius + beyond * math.cos(slope)
    assert np.abs(reach - expected)[outside].max() < 3e-3
    assert np.abs(placed[:, 2] + beyond * math.sin(slope))[outside].max() < 3e-3
    assert placed[~outside, :2] == pytest.approx(rest[~outside])
