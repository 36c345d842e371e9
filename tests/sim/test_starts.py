"""Ring and borrowed starts: folds of another drape survive; files with one; interpolation."""

import numpy as np
import pytest
from cloths import isotropic

from apps.drape_file import read_borrowed, write_drape
from common.errors import InputError
from sim.draping import drape
from sim.measures import fold_angles, fold_outline
from sim.rig import DISC_RIG, HUNG_SQUARE, Rig
from sim.scene import make_specimen
from sim.start import borrowed_positions, initial_positions, interpolate_positions


@pytest.fixture(scope="module")
def lender():
    """A disc has many fold configurations to choose from; this drape has ten folds."""
    return drape(isotropic(15), rig=DISC_RIG, edge=0.008, seed=1)


def mean_distance(first, second) -> float:
    """Between two drapes at the rest points of the first, m."""
    other = interpolate_positions(second.rest, second.positions, first.rest)
    return np.linalg.norm(first.positions - other, axis=1).mean()


def folds(result) -> np.ndarray:
    """Directions of the folds, rad."""
    return fold_angles(fold_outline(result.positions, result.rest, result.rig))


def test_the_same_fabric_stays_where_its_drape_was(lender):
    again = drape(isotropic(15), rig=DISC_RIG, edge=0.008, seed=1,
                  borrowed=(lender.rest, lender.positions))
    assert again.converged
    assert np.abs(again.positions - lender.positions).max() < 1e-6
    assert again.iterations < 0.5 * lender.iterations


def test_folds_survive_in_another_fabric_on_another_mesh(lender):
    others, lent = [], []
    for seed in (8, 9):
        settings = {"rig": DISC_RIG, "edge": 0.008, "seed": seed}
        borrowed = drape(isotropic(17), **settings, borrowed=(lender.rest, lender.positions))
        assert borrowed.converged and len(folds(borrowed)) == len(folds(lender))
        apart = np.exp(1j * folds(borrowed)[:, None]) / np.exp(1j * folds(lender))
        assert np.degrees(np.abs(np.angle(apart)).min(axis=1)).max() < 9
        lent.append(mean_distance(borrowed, lender))
        others.append(mean_distance(drape(isotropic(17), **settings, start="ring"), lender))
    assert max(others) > 2 * max(lent)  # other starts may find the same folds, not all do


def test_borrowed_drape_drifts_with_the_specimen(lender):
    offset = (4e-3, -2e-3)
    moved = drape(isotropic(15), rig=DISC_RIG, edge=0.008, seed=1, offset=offset,
                  borrowed=(lender.rest, lender.positions))
    assert moved.converged
    assert np.allclose((moved.rest.max(0) + moved.rest.min(0)) / 2, offset, atol=2e-4)
    assert len(folds(moved)) == len(folds(lender))
    assert mean_distance(moved, lender) < 5e-3


@pytest.mark.parametrize("rig", [Rig(), DISC_RIG], ids=lambda rig: rig.name)
def test_drift_matches_plate_with_plate_and_border_with_border(rig):
    lent = make_specimen(rig, edge=0.008, topology=1).mesh
    mesh = make_specimen(rig, edge=0.006, offset=(5e-3, 3e-3), topology=2).mesh
    flat = np.column_stack([lent.rest, np.zeros(len(lent.rest))])
    found = borrowed_positions(mesh.rest, rig=rig, borrowed=(lent.rest, flat))[:, :2]
    radius = np.linalg.norm(mesh.rest, axis=1)
    assert np.allclose(found[radius < rig.plate_radius], mesh.rest[radius < rig.plate_radius],
                       atol=1e-9)
    border = np.unique(mesh.edges[mesh.edge_faces[:, 1] < 0])
    shifted = mesh.rest[border] - [5e-3, 3e-3]
    # The centre of a disc is found from its corners, good to their distance from the circle.
    assert np.allclose(found[border], shifted, atol=1e-4 if rig.specimen == "disc" else 1e-9)
    stretched = np.linalg.norm(np.diff(found[mesh.edges], axis=1), axis=-1) / np.linalg.norm(
        np.diff(mesh.rest[mesh.edges], axis=1), axis=-1)
    assert abs(stretched - 1).max() < 0.15


def test_interpolation_is_exact_for_planes_beyond_a_disc_s_polygon_too():
    coarse, fine = (make_specimen(DISC_RIG, edge=e).mesh.rest for e in (0.016, 0.004))
    plane = np.array([[1.0, 0.2, -0.3], [0.1, 0.9, 0.4]])
    assert np.allclose(interpolate_positions(coarse, coarse @ plane, fine), fine @ plane,
                       atol=1e-9)


def test_hung_start_is_isometric_between_the_corners():
    """The arc has the square's width, so that it starts nearly without stretch."""
    mesh = make_specimen(HUNG_SQUARE, edge=0.015).mesh
    rng = np.random.default_rng(0)
    start = initial_positions(mesh.rest, rig=HUNG_SQUARE, start="sine", rng=rng)
    bottom = np.isclose(mesh.rest[:, 1], -0.3)
    steps = np.diff(mesh.rest[mesh.edges], axis=1)[:, 0]
    lengths = np.linalg.norm(np.diff(start[mesh.edges], axis=1)[:, 0], axis=1)
    assert np.allclose(start[bottom, 2], -0.6)
    assert np.median(lengths / np.linalg.norm(steps, axis=1)) == pytest.approx(1.0, abs=0.02)
    assert np.ptp(start[:, 0]) == pytest.approx(0.5, abs=1e-3)


def test_file_gives_the_drape_back(tmp_path, lender):
    write_drape(tmp_path / "drape.npz", lender)
    rest, positions = read_borrowed(tmp_path / "drape.npz")
    assert np.array_equal(rest, lender.rest) and np.array_equal(positions, lender.positions)
    with np.load(tmp_path / "drape.npz", allow_pickle=False) as archive:
        assert np.array_equal(archive["faces"], lender.faces)
        assert np.array_equal(archive["held"], lender.held)


@pytest.mark.parametrize("changes", [
    {"rest": np.array([{}], dtype=object)}, {"rest": 1.0, "positions": 2.0}, {"positions": None},
    {"rest": np.zeros((3, 2))}, {"positions": np.full((9, 3), np.nan), "rest": np.zeros((9, 2))}],
    ids=["pickle", "scalars", "no positions", "another number", "holes"])
def test_bad_files_are_refused_in_one_line(tmp_path, lender, changes):
    arrays = {"rest": lender.rest, "positions": lender.positions} | changes
    np.savez(tmp_path / "other.npz", **{k: v for k, v in arrays.items() if v is not None})
    with pytest.raises(InputError) as caught:
        read_borrowed(tmp_path / "other.npz")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("rig", "word"), [(HUNG_SQUARE, "3600"), (Rig(), "900")])
def test_drapes_of_other_specimens_are_not_borrowed(lender, rig, word):
    with pytest.raises(InputError, match=word):
        drape(isotropic(20), rig=rig, borrowed=(lender.rest, lender.positions))


def test_a_ring_start_has_waves_all_around_and_leads_to_more_than_one_number_of_folds():
    """Folds as deep on all sides; of one fabric, the number depends on the start's."""
    found = set()
    for seed in range(3):
        rng = np.random.default_rng([seed, 1])
        rest = make_specimen(DISC_RIG, edge=0.008, topology=0, offset=(0.0, 0.0)).mesh.rest
        start = initial_positions(rest, rig=DISC_RIG, start="ring", rng=rng)
        radius = np.linalg.norm(rest, axis=1)
        assert np.abs(start[radius <= DISC_RIG.plate_radius, 2]).max() < 1e-12
        hem = start[radius > 0.149]
        angle = np.arctan2(hem[:, 1], hem[:, 0])
        spectrum = [abs((hem[:, 2] * np.exp(-1j * k * angle)).mean()) for k in range(1, 20)]
        assert 4 <= 1 + int(np.argmax(spectrum)) <= 14
        result = drape(isotropic(15), rig=DISC_RIG, edge=0.01, seed=seed, start="ring")
        assert result.converged
        found.add(len(folds(result)))
    assert len(found) > 1 and min(found) >= 4
