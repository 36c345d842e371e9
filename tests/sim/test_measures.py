"""Figures of drapes on shapes where they are known."""

import numpy as np
import pytest
from scipy.signal import find_peaks

from common.errors import InputError
from sim.measures import (
    drape_coefficient,
    fold_angles,
    fold_count,
    fold_outline,
    maximum_stretch,
    projected_area,
)
from sim.outlines import _peaks
from sim.rig import Rig
from sim.scene import make_specimen

RIG = Rig()


@pytest.fixture(scope="module")
def specimen():
    specimen = make_specimen(RIG, edge=0.006, grading=1)
    return specimen.mesh, specimen.held


def skirt(rest: np.ndarray, folds: int, depth: float) -> np.ndarray:
    """The overhang turned straight down, with sinusoidal folds."""
    radius, angle = np.hypot(*rest.T), np.arctan2(rest[:, 1], rest[:, 0])
    drop = np.maximum(radius - 0.05, 0)
    wave = depth * drop / 0.1 * np.cos(folds * angle + 1)
    reach = np.minimum(radius, 0.05) + wave
    return np.column_stack([reach * np.cos(angle), reach * np.sin(angle), -drop])


def test_flat_specimen_covers_itself(specimen):
    mesh, _ = specimen
    flat = np.column_stack([mesh.rest, np.zeros(len(mesh.rest))])
    assert projected_area(flat, mesh.faces) == pytest.approx(0.09, rel=3e-3)
    assert drape_coefficient(flat, mesh.faces, RIG) == pytest.approx(1.0, abs=4e-3)


def test_cloth_hanging_straight_down_covers_the_plate_only(specimen):
    mesh, _ = specimen
    hanging = skirt(mesh.rest, folds=1, depth=0.0)
    assert drape_coefficient(hanging, mesh.faces, RIG) == pytest.approx(0.0, abs=4e-3)


@pytest.mark.parametrize("folds", [3, 4, 7, 11])
def test_folds_are_counted(specimen, folds):
    mesh, _ = specimen
    assert fold_count(skirt(mesh.rest, folds, 0.008), mesh.rest, RIG) == folds


def test_ripples_below_three_millimetres_are_no_folds(specimen):
    mesh, _ = specimen
    assert fold_count(skirt(mesh.rest, 6, 0.001), mesh.rest, RIG) == 0


@pytest.mark.parametrize(("arguments", "word"), [
    ({"scale": 1e3}, "positions extend over .* give metres"), ({"scale": 1e-3}, "give metres"),
    ({"scale": np.nan}, r"positions of the shape .*give finite positions"),
    ({"rig": "disc"}, "class Rig"), ({"faces": np.array([[0, 1, 10**6]])}, "faces of the shape"),
    ({"faces": np.zeros((3, 9), int)}, r"faces of the shape \(3, 9\)")])
def test_coefficients_of_other_units_and_arrays_are_refused(specimen, any_shapes, arguments, word):
    given = {"scale": 1.0, "faces": specimen[0].faces, "rig": RIG} | arguments
    positions = given.pop("scale") * skirt(specimen[0].rest, 4, 0.008)
    with pytest.raises(InputError, match=word):
        drape_coefficient(positions, **given)


@pytest.mark.parametrize(("scale", "rig"), [(1e3, RIG), (1.0, Rig(0.4))])
def test_folds_of_other_specimens_are_not_counted(specimen, scale, rig):
    rest = specimen[0].rest
    with pytest.raises(InputError, match=r"rest extend over .* give metres"):
        fold_count(skirt(rest, 4, 0.008), scale * rest, rig)


def test_outline_tells_where_the_folds_are(specimen):
    mesh, _ = specimen
    outline = fold_outline(skirt(mesh.rest, 5, 0.008), mesh.rest, RIG)
    # The material circle lies 0.135 - 0.05 m below the rim.
    wave = 0.05 + 0.008 * 0.085 / 0.1 * np.cos(5 * np.linspace(0, 2 * np.pi, 720, False) + 1)
    assert np.abs(np.linalg.norm(outline, axis=1) - wave).max() < 4e-4
    peaks = (2 * np.pi * np.arange(1, 6) - 1) / 5
    np.testing.assert_allclose(fold_angles(outline), peaks, atol=np.radians(2))


def test_stretch_is_that_of_the_most_stretched_direction(specimen):
    mesh, held = specimen
    positions = np.column_stack([1.03 * mesh.rest[:, 0], 0.98 * mesh.rest[:, 1],
                                 np.zeros(len(mesh.rest))])
    stretch = maximum_stretch(positions, mesh.rest, mesh.faces, held)
    assert stretch == pytest.approx(0.03, rel=1e-9)


def test_peaks_are_those_of_scipy():
    rng = np.random.default_rng(0)
    for _ in range(50):
        values = np.cumsum(rng.normal(size=200))
        np.testing.assert_array_equal(_peaks(values, 1.5), find_peaks(values, prominence=1.5)[0])
