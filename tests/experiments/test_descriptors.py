"""Descriptors of drapes: derivatives and invariances."""

import numpy as np
import pytest
from cloths import waves

from experiments.papers.descriptors import (
    DescriptorObjective,
    GridSpectrum,
    RingSpectrum,
    interpolation,
)
from sim.rig import DISC_RIG, Rig
from sim.scene import make_specimen


def test_ring_spectrum_is_invariant_to_rotation_but_not_to_fold_depth(disc):
    rest = disc.mesh.rest
    rings = RingSpectrum(rest, DISC_RIG, blur=0.0)
    here = rings.describe(waves(rest))
    for phase in (0.1, 0.35):
        assert np.linalg.norm(rings.describe(waves(rest, phase=phase)) - here) < 1e-3
    deeper = rings.describe(waves(rest, depth=0.03))
    assert np.linalg.norm(deeper - here) > 3e-3
    # Parseval: a wave of amplitude a at the hem has the root mean square a/sqrt(2)
    amplitudes = here.reshape(2, 6, 25)
    assert amplitudes[0, -1, 8] * np.sqrt(6) == pytest.approx(0.02 / np.sqrt(2), rel=0.06)
    blurred = RingSpectrum(rest, DISC_RIG, blur=1.0)
    nine = waves(rest, folds=9)
    gap = np.linalg.norm(rings.describe(nine) - here)
    assert np.linalg.norm(blurred.describe(nine) - blurred.describe(waves(rest))) < 0.7 * gap


@pytest.mark.parametrize("kind", [RingSpectrum, GridSpectrum])
def test_descriptor_derivatives(kind):
    specimen = make_specimen(Rig(), edge=8e-3)
    rng = np.random.default_rng(2)
    rest = specimen.mesh.rest
    positions = np.column_stack([rest, 0.02 * np.sin(40 * rest[:, 0]) * np.cos(30 * rest[:, 1])])
    positions += rng.normal(0, 1e-3, positions.shape)
    descriptor = kind(rest, Rig())
    objective = DescriptorObjective(descriptor, descriptor.describe(positions[::-1]))
    moves = rng.normal(0, 1.0, (3, *positions.shape))
    h = 1e-6
    expected = np.stack([(objective.residuals(positions + h * m, np.zeros(0))
                          - objective.residuals(positions - h * m, np.zeros(0))) / (2 * h)
                         for m in moves], axis=1)
    found = objective.linearised(positions, np.zeros(0))
    np.testing.assert_allclose(found.along(moves), expected, atol=1e-5 * np.abs(expected).max())
    assert found.by_nuisance.shape == (len(found.residuals), 0)


def test_grid_spectrum_is_invariant_to_phase_but_not_to_amplitude():
    specimen = make_specimen(Rig(), edge=5e-3, grading=1.0)
    rest = specimen.mesh.rest

    def wave(phase: float, height: float) -> np.ndarray:
        return np.column_stack([rest, height * np.cos(2 * np.pi * 5 * rest[:, 0] / 0.3 + phase)])

    grid = GridSpectrum(rest, Rig())
    here = grid.describe(wave(0.0, 0.01))
    shifted, higher = (np.linalg.norm(grid.describe(p) - here)
                       for p in (wave(1.3, 0.01), wave(0.0, 0.015)))
    assert 3 * shifted < higher


def test_interpolation_is_exact_for_linear_functions(disc):
    rest = disc.mesh.rest
    points = np.random.default_rng(3).uniform(-0.1, 0.1, (50, 2))
    matrix = interpolation(rest, points)
    np.testing.assert_allclose(matrix @ (rest @ [2.0, -1.0] + 0.5), points @ [2.0, -1.0] + 0.5)
