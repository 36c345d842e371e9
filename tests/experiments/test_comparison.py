"""Differences between two shapes whose distance, curvature or folds are known."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from common.errors import InputError
from experiments.comparison import compare, mean_curvature, same_folds
from sim.measures import fold_outline
from sim.mesh import Mesh, grid_faces, grid_points
from sim.rig import Rig
from sim.scene import make_specimen

RIG = Rig()


@dataclass
class Shape:
    rest: np.ndarray
    positions: np.ndarray
    faces: np.ndarray


def specimen(resolution: int, *, seed: int = 0) -> Mesh:
    """Evenly meshed, as many vertices a side as ``resolution``."""
    return make_specimen(RIG, edge=0.3 / (resolution - 1), grading=1, topology=seed).mesh


def bell(mesh: Mesh, *, folds: int = 5, phase: float = 0.0, depth: float = 0.02) -> Shape:
    """A smooth drape: bent over the rim along an arc of 30 mm, then down, with folds."""
    radius, angle = np.hypot(*mesh.rest.T), np.arctan2(mesh.rest[:, 1], mesh.rest[:, 0])
    over = np.maximum(radius - 0.05, 0)
    turn = np.minimum(over / 0.03, 1.2)
    straight = np.maximum(over - 0.036, 0)
    reach = np.minimum(radius, 0.05) + 0.03 * np.sin(turn) + straight * np.cos(1.2)
    reach += depth * (over / 0.1) ** 2 * np.cos(folds * angle + phase)
    height = -0.03 * (1 - np.cos(turn)) - straight * np.sin(1.2)
    positions = np.column_stack([reach * np.cos(angle), reach * np.sin(angle), height])
    return Shape(positions=positions, rest=mesh.rest, faces=mesh.faces)


def turned(drape: Shape, angle: float) -> Shape:
    """The drape turned about the vertical axis in space, its cloth not."""
    c, s = np.cos(angle), np.sin(angle)
    about_z = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    return Shape(positions=drape.positions @ about_z.T, rest=drape.rest,
                           faces=drape.faces)


def outline(drape: Shape) -> np.ndarray:
    return fold_outline(drape.positions, drape.rest, RIG)


def cylinder(mesh: Mesh, radius: float, angle: float) -> np.ndarray:
    """The mesh bent around a horizontal cylinder below it."""
    axis = np.array([np.cos(angle), np.sin(angle)])
    across, along = mesh.rest @ axis, mesh.rest @ [-axis[1], axis[0]]
    bent = radius * np.sin(across / radius)
    plane = bent[:, None] * axis + along[:, None] * [-axis[1], axis[0]]
    return np.column_stack([plane, radius * np.cos(across / radius)])


def test_mean_curvature_of_a_sphere():
    trimesh = pytest.importorskip("trimesh")
    sphere = trimesh.creation.icosphere(subdivisions=3, radius=0.05)
    mesh = Mesh(rest=np.array(sphere.vertices[:, :2]), faces=np.array(sphere.faces))
    found = mean_curvature(np.array(sphere.vertices), mesh)
    np.testing.assert_allclose(found, 20.0, rtol=1e-4)
    inside_out = Mesh(rest=mesh.rest, faces=mesh.faces[:, ::-1])
    np.testing.assert_allclose(mean_curvature(np.array(sphere.vertices), inside_out), -found)


@pytest.mark.parametrize("angle", [0.2, np.pi / 4])
def test_mean_curvature_of_a_cylinder_converges_at_second_order(angle):
    errors = []
    for n in (16, 31, 61):
        points = grid_points((n, n), (0.2, 0.2), 0.0, np.random.default_rng(0)) - 0.1
        mesh = Mesh(rest=points.reshape(-1, 2), faces=grid_faces(np.ones((n - 1, n - 1), bool)))
        found = mean_curvature(cylinder(mesh, 0.08, angle), mesh)
        inner = np.isfinite(found)
        assert inner.sum() == (n - 2) ** 2
        errors.append(np.abs(found[inner] * 0.08 - 0.5).max())
    rates = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (rates > 1.8).all() and errors[-1] < 1e-3


@pytest.mark.parametrize("resolutions", [(41, 41), (41, 81), (81, 41)])
def test_one_shape_on_two_meshes_hardly_differs(resolutions):
    one, two = (bell(specimen(n, seed=seed)) for seed, n in enumerate(resolutions))
    difference = compare(one, two)
    assert difference.displacement < 1e-5
    assert difference.largest < 1e-4
    assert difference.curvature < 0.04


def test_points_of_the_cloth_are_compared_wherever_it_lies():
    centred, shifted = specimen(31), specimen(41, seed=1)
    one, other = bell(centred), bell(shifted)
    other = replace(other, rest=other.rest + np.array([0.01, -0.004]))
    assert compare(one, other).displacement < 2e-5


def test_displacement_is_the_mean_over_the_area():
    mesh = specimen(31)
    drape, moved = bell(mesh), bell(mesh)
    half = mesh.rest[:, 0] > 0.0701
    moved.positions[half] += [0.003, 0.0, 0.004]
    difference = compare(drape, moved)
    share = mesh.vertex_areas[half].sum() / 0.09
    assert difference.displacement == pytest.approx(0.005 * share)
    assert difference.largest == pytest.approx(0.005)


def test_halving_the_size_of_a_shape_doubles_its_curvature():
    drape = bell(specimen(31))
    smaller = Shape(positions=0.5 * drape.positions, rest=drape.rest, faces=drape.faces)
    assert compare(drape, smaller).curvature == pytest.approx(1.0)
    assert compare(smaller, drape).curvature == pytest.approx(0.5)


def test_alignment_removes_a_turn():
    drape = bell(specimen(31))
    other = turned(drape, 0.3)
    assert compare(drape, other).displacement > 0.01
    assert compare(drape, other, turned=True).largest < 1e-12


@pytest.mark.parametrize(("folds", "phase", "same"), [
    (5, 0.0, True), (5, 0.3 * np.pi, True), (5, 0.8 * np.pi, False), (5, -0.3 * np.pi, True),
    (6, 0.0, False), (4, 0.0, False),
])
def test_fold_configurations(folds, phase, same):
    mesh = specimen(41)
    drape = bell(mesh, folds=5)
    other = bell(mesh, folds=folds, phase=phase)
    assert same_folds(outline(drape), outline(other)) is same
    assert same_folds(outline(other), outline(drape)) is same
    flat = outline(bell(mesh, depth=0.0))
    assert same_folds(flat, flat) and not same_folds(flat, outline(drape))


def test_other_specimens_are_refused():
    drape = bell(specimen(31))
    with pytest.raises(InputError, match="not drapes of one specimen"):
        compare(drape, Shape(positions=drape.positions[:500], rest=drape.rest[:500],
                                       faces=drape.faces[(drape.faces < 500).all(axis=1)]))
