"""Objectives for registered drapes, and surfaces of points: values, derivatives."""

import numpy as np
import pytest

from common.errors import InputError
from drapenet.refine.surface import Cloud, RobustPositions, distances
from sim.rig import DISC_RIG
from sim.scene import Scene, make_specimen


def waves(
    rest: np.ndarray, *, folds: int = 8, phase: float = 0.0, depth: float = 0.02
) -> np.ndarray:
    """A drape-like surface over rest points (V, 2) on the disc rig."""
    radius, angle = np.linalg.norm(rest, axis=1), np.arctan2(rest[:, 1], rest[:, 0])
    beyond = np.maximum(radius - DISC_RIG.plate_radius, 0.0) / 0.06
    out = np.minimum(radius, DISC_RIG.plate_radius) + 0.035 * beyond
    out = out + depth * beyond**2 * np.cos(folds * (angle - phase))
    return np.column_stack([out * np.cos(angle), out * np.sin(angle), -0.045 * beyond])


@pytest.fixture(scope="module")
def disc() -> Scene:
    return make_specimen(DISC_RIG, edge=9e-3, grading=1.0)


def test_derivatives_match_central_differences(disc: Scene) -> None:
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


def test_raw_points_get_the_normals_of_the_surface() -> None:
    rng = np.random.default_rng(1)
    rest = rng.uniform(-0.15, 0.15, (12000, 2))
    cloud = Cloud.of_points(np.column_stack([rest, np.zeros(len(rest))]))
    assert np.abs(cloud.normals[:, 2]).min() > 1 - 1e-9
    above = np.array([[0.0, 0.0, 2e-3], [0.25, 0.0, 0.0]])  # over the surface, and beyond its hem
    assert distances(cloud, above) == pytest.approx([2e-3, 0.1], abs=2e-3)
    with pytest.raises(InputError, match="too few"):
        Cloud.of_points(np.zeros((20, 3)))
