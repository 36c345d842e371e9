"""Objectives against unregistered scans and phase-free descriptions: derivatives, invariances."""

import numpy as np
import pytest

from common.errors import InputError
from drapenet.refine.descriptor import GridSpectrum, PhaseFree, RingSpectrum, interpolation
from drapenet.refine.scan import Chamfer, Cloud, Hem, Outline, Placed, border_edges, outline
from sim.mesh.specimens import Specimen, make_specimen
from sim.scene import DISC_RIG, HUNG_SQUARE, Rig


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
def disc() -> Specimen:
    return make_specimen(DISC_RIG, edge=9e-3, grading=1.0)


@pytest.fixture(scope="module")
def cloud() -> Cloud:
    fine = make_specimen(DISC_RIG, edge=4.5e-3, grading=1.0)
    return Cloud.of_mesh(waves(fine.mesh.rest), fine.mesh.faces)


def objectives(disc: Specimen, cloud: Cloud) -> dict:
    faces = disc.mesh.faces
    border = border_edges(faces)
    return {
        "chamfer": Chamfer(faces, cloud, free=~disc.held, limit=50.0),
        "hem": Hem(faces, cloud, limit=50.0),
        "outline": Outline(faces, outline(waves(disc.mesh.rest), border, 90)[0], limit=50.0),
    }


@pytest.mark.parametrize("name", ["chamfer", "hem", "outline"])
def test_derivatives_match_central_differences(
    disc: Specimen, cloud: Cloud, name: str
) -> None:
    """Where no pair of nearest points changes, which is nearly everywhere for a small move."""
    objective = Placed(objectives(disc, cloud)[name])
    rng = np.random.default_rng(0)
    positions = waves(disc.mesh.rest, depth=0.018) + rng.normal(0, 1e-3, (len(disc.mesh.rest), 3))
    nuisance = np.array([0.02, 1e-3, -2e-3])
    found = objective.linearised(positions, nuisance)
    np.testing.assert_array_equal(found.residuals, objective.residuals(positions, nuisance))
    moves = rng.normal(0, 1.0, (2, *positions.shape))
    h = 1e-8
    columns = [(objective.residuals(positions + h * m, nuisance)
                - objective.residuals(positions - h * m, nuisance)) / (2 * h) for m in moves]
    for k in range(3):
        step = h * np.eye(3)[k]
        columns.append((objective.residuals(positions, nuisance + step)
                        - objective.residuals(positions, nuisance - step)) / (2 * h))
    expected = np.stack(columns, axis=1)
    derivatives = np.concatenate([found.along(moves), found.by_nuisance], axis=1)
    wrong = np.abs(derivatives - expected) > 1e-4 * np.abs(expected).max(axis=0)
    assert wrong.mean() < 2e-3


def test_a_drape_fits_its_own_scan_and_no_shifted_one(disc: Specimen, cloud: Cloud) -> None:
    for objective in objectives(disc, cloud).values():
        own = objective.residuals(waves(disc.mesh.rest), np.zeros(0))
        other = objective.residuals(waves(disc.mesh.rest, phase=np.pi / 8), np.zeros(0))
        assert 15 * (own @ own) < other @ other


def test_turning_and_shifting_the_scan_is_found_by_gauss_newton(
    disc: Specimen, cloud: Cloud
) -> None:
    c, s = np.cos(0.05), np.sin(0.05)
    turn = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    moved = Cloud(cloud.points @ turn + [3e-3, -2e-3, 0], cloud.normals @ turn,
                  cloud.hem @ turn + [3e-3, -2e-3, 0])
    objective = Placed(Chamfer(disc.mesh.faces, moved, free=~disc.held, limit=50.0))
    at = objective.start
    for _ in range(8):
        found = objective.linearised(waves(disc.mesh.rest), at)
        at = at - np.linalg.lstsq(found.by_nuisance, found.residuals, rcond=None)[0]
    np.testing.assert_allclose(at, [0.05, 3e-3, -2e-3], atol=3e-4)


def test_raw_points_get_the_normals_and_the_hem_of_the_surface() -> None:
    rng = np.random.default_rng(1)
    rest = rng.uniform(-0.15, 0.15, (12000, 2))
    rest = rest[np.linalg.norm(rest, axis=1) < 0.15]
    cloud = Cloud.of_points(np.column_stack([rest, np.zeros(len(rest))]))
    assert np.abs(cloud.normals[:, 2]).min() > 1 - 1e-9
    radius = np.linalg.norm(cloud.hem, axis=1)
    assert np.quantile(radius, 0.2) > 0.14
    angle = np.sort(np.arctan2(cloud.hem[radius > 0.14, 1], cloud.hem[radius > 0.14, 0]))
    assert np.diff(angle).max() < 0.3
    with pytest.raises(InputError, match="too few"):
        Cloud.of_points(np.zeros((20, 3)))


def test_outline_of_a_circle() -> None:
    angle = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    ring = 0.1 * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(400)])
    border = np.column_stack([np.arange(400), np.roll(np.arange(400), -1)])
    radius, edge, _ = outline(ring, border, 37)
    np.testing.assert_allclose(radius, 0.1, rtol=1e-4)
    assert (edge >= 0).all()


def test_ring_spectrum_knows_no_turn_and_no_mirror_but_the_folds(disc: Specimen) -> None:
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
    with pytest.raises(InputError, match="plate"):
        RingSpectrum(rest, HUNG_SQUARE)


@pytest.mark.parametrize("kind", [RingSpectrum, GridSpectrum])
def test_description_derivatives(kind: type) -> None:
    specimen = make_specimen(Rig(), edge=8e-3)
    rng = np.random.default_rng(2)
    rest = specimen.mesh.rest
    positions = np.column_stack([rest, 0.02 * np.sin(40 * rest[:, 0]) * np.cos(30 * rest[:, 1])])
    positions += rng.normal(0, 1e-3, positions.shape)
    descriptor = kind(rest, Rig())
    objective = PhaseFree(descriptor, descriptor.describe(positions[::-1]), sigma=1e-3)
    moves = rng.normal(0, 1.0, (3, *positions.shape))
    h = 1e-6
    expected = np.stack([(objective.residuals(positions + h * m, np.zeros(0))
                          - objective.residuals(positions - h * m, np.zeros(0))) / (2 * h)
                         for m in moves], axis=1)
    found = objective.linearised(positions, np.zeros(0))
    np.testing.assert_allclose(found.along(moves), expected, atol=1e-5 * np.abs(expected).max())
    assert found.by_nuisance.shape == (len(found.residuals), 0)


def test_grid_spectrum_forgets_the_phase_only() -> None:
    specimen = make_specimen(Rig(), edge=5e-3, grading=1.0)
    rest = specimen.mesh.rest

    def wave(phase: float, height: float) -> np.ndarray:
        return np.column_stack([rest, height * np.cos(2 * np.pi * 5 * rest[:, 0] / 0.3 + phase)])

    grid = GridSpectrum(rest, Rig())
    here = grid.describe(wave(0.0, 0.01))
    shifted, higher = (np.linalg.norm(grid.describe(p) - here)
                       for p in (wave(1.3, 0.01), wave(0.0, 0.015)))
    assert 3 * shifted < higher


def test_interpolation_is_exact_for_linear_functions(disc: Specimen) -> None:
    rest = disc.mesh.rest
    points = np.random.default_rng(3).uniform(-0.1, 0.1, (50, 2))
    matrix = interpolation(rest, points)
    np.testing.assert_allclose(matrix @ (rest @ [2.0, -1.0] + 0.5), points @ [2.0, -1.0] + 0.5)
