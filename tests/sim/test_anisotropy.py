"""Moduli by direction, directions of bending, and the lagged iteration that joins them."""

from dataclasses import replace

import numpy as np
import pytest

from sim.energies.hinges import find_hinges
from sim.equilibrium import find_equilibrium
from sim.hinge_laws import (
    HingeLaw,
    edge_directions,
    hinge_directions,
    mean_modulus,
    modulus_along,
    modulus_of_bending,
    shape_operators,
    smoothed,
)
from sim.laws import Laws
from sim.material import Fabric
from sim.mesh import strip
from sim.mesh.specimens import make_specimen
from sim.newton import NewtonOptions, Status
from sim.scene import Rig, Scene
from sim.state import State

MODULI = np.array([90e-6, 25e-6, 40e-6])
OPTIONS = NewtonOptions(residual=1e-6, step=1e-6)


def eq_8(moduli: np.ndarray, angle: float) -> float:
    """Eq. 8 as printed, with the symmetries of the text below it."""
    phi = np.arctan2(abs(np.sin(angle)), abs(np.cos(angle)))  # in [0, 90°]
    first = phi <= np.pi / 4
    samples = np.array([0, np.pi / 4] if first else [np.pi / 4, np.pi / 2])
    matrix = np.stack([np.cos(samples) ** 2, np.sin(samples) ** 2], axis=1)
    two = np.linalg.solve(matrix, moduli[:2] if first else moduli[1:])
    return np.array([np.cos(phi) ** 2, np.sin(phi) ** 2]) @ two


def test_moduli_by_direction_are_those_of_eq_8():
    angles = np.linspace(-4, 4, 333)
    expected = [eq_8(MODULI, angle) for angle in angles]
    assert np.allclose(modulus_along(MODULI, angles), expected, rtol=1e-12)
    samples = modulus_along(MODULI, np.deg2rad([0, 45, 90]))
    assert np.allclose(samples, MODULI, rtol=1e-12)


def test_mean_modulus_is_the_mean_over_all_directions():
    angles = np.linspace(0, 2 * np.pi, 100_000, endpoint=False)
    assert mean_modulus(MODULI) == pytest.approx(modulus_along(MODULI, angles).mean(), rel=1e-8)


def test_bending_without_direction_has_the_mean_modulus():
    angle = np.array([0.3, 1.0, 2.0])
    axis = np.stack([np.cos(2 * angle), np.sin(2 * angle)], axis=1)
    assert np.allclose(modulus_of_bending(MODULI, axis), modulus_along(MODULI, angle))
    assert np.allclose(modulus_of_bending(MODULI, 0 * axis), mean_modulus(MODULI))
    half = modulus_of_bending(MODULI, 0.5 * axis)
    assert np.allclose(half, (modulus_along(MODULI, angle) + mean_modulus(MODULI)) / 2)


def sheet():
    """A perturbed square, all of it free, and its hinges away from the border."""
    mesh = make_specimen(Rig(), edge=0.01, grading=1, topology=4).mesh
    active = np.ones(len(mesh.faces), dtype=bool)
    ends = mesh.rest[find_hinges(mesh, active).corners[:, :2]]
    return mesh, active, np.abs(ends).max(axis=(1, 2)) < 0.1


@pytest.mark.parametrize("degrees", [0, 30, 45, 80, 120])
def test_direction_of_a_cylinder(degrees):
    radius = 0.1
    mesh, active, inner = sheet()
    phi = np.deg2rad(degrees)
    along, across = np.array([np.cos(phi), np.sin(phi)]), np.array([-np.sin(phi), np.cos(phi)])
    s, t = mesh.rest @ along, mesh.rest @ across
    plane = np.outer(radius * np.sin(s / radius), along) + np.outer(t, across)
    positions = np.column_stack([plane, radius * np.cos(s / radius)])
    directions = hinge_directions(mesh, active, positions)[inner]
    off = directions @ [np.cos(2 * phi), np.sin(2 * phi)]
    assert off.min() > 0.98  # the angle is right to 6°, the alignment to 2 %
    operators = smoothed(mesh, shape_operators(mesh, active, positions))
    middle = np.abs(mesh.rest).max(axis=1) < 0.1
    expected = np.array([along[0] ** 2, along[1] ** 2, along[0] * along[1]]) / radius
    mean = np.abs(operators[middle].mean(axis=0) * [1, 1, 1])
    assert np.allclose(mean, np.abs(expected), atol=0.12 / radius)


def test_equal_curvatures_have_no_direction():
    """Domes and saddles: the principal curvatures have the same size."""
    mesh, active, inner = sheet()
    x, y = mesh.rest.T
    cylinder, dome, saddle = (
        np.linalg.norm(
            hinge_directions(mesh, active, np.column_stack([x, y, height]))[inner], axis=1
        ).mean()
        for height in (x**2, x**2 + y**2, x**2 - y**2)
    )
    assert cylinder > 0.97 and dome < 0.2 and saddle < 0.2
    flat = np.column_stack([x, y, 0 * x])
    assert np.array_equal(hinge_directions(mesh, active, flat), np.zeros((len(inner), 2)))


def test_smoothing_keeps_constants_and_flattens_noise():
    mesh, _, _ = sheet()
    assert np.allclose(smoothed(mesh, np.full((len(mesh.rest), 3), 7.0)), 7.0)
    noise = np.random.default_rng(0).standard_normal((len(mesh.rest), 3))
    assert smoothed(mesh, noise).std() < 0.4 * noise.std()
    assert np.array_equal(smoothed(mesh, noise, rounds=0), noise)


def test_directions_across_the_edges_are_unit_and_even():
    mesh, active, _ = sheet()
    hinges = find_hinges(mesh, active)
    axes = edge_directions(hinges)
    angle = np.arctan2(hinges.vectors[:, 1], hinges.vectors[:, 0]) + np.pi / 2
    assert np.allclose(axes, np.stack([np.cos(2 * angle), np.sin(2 * angle)], axis=1))


@pytest.fixture(scope="module")
def warp_strip():
    """A strip cut along warp: it bends in that direction only."""
    mesh, held = strip(length=0.06, width=0.02, edge=4e-3, clamp=8e-3, diagonals="random", seed=1)
    flat = np.column_stack([mesh.rest, np.zeros(len(mesh.rest))])
    return Scene(mesh=mesh, held=held), State.at(mesh, flat)


def tip(state: State) -> float:
    """Height of the free end, m."""
    return float(state.positions[-3:, 2].mean())


def test_curvature_based_strip_feels_the_modulus_along_it(warp_strip):
    """It hangs as an isotropic strip of the warp's modulus; edge-based it does not."""
    scene, start = warp_strip
    moduli = np.array([600e-6, 200e-6, 150e-6])
    heights = {}
    for name, alpha, law in (
        ("warp alone", np.full(3, moduli[0]), "hinge"),
        ("curvature", moduli, "hinge_curvature"),
        ("edge", moduli, "hinge_edge"),
        ("mean", moduli, "hinge"),
    ):
        found = find_equilibrium(scene, Fabric(alpha), start, laws=Laws(bending=law),
                                 options=OPTIONS)
        assert found.converged
        heights[name] = tip(found.state)
    assert heights["curvature"] == pytest.approx(heights["warp alone"], rel=0.03)
    assert heights["edge"] < 1.1 * heights["warp alone"]  # hangs lower: the diagonals are soft
    assert heights["mean"] < 1.2 * heights["warp alone"]


def test_an_isotropic_fabric_needs_no_second_shape(warp_strip):
    scene, start = warp_strip
    fabric = Fabric(np.full(3, 30e-6), np.full(3, -60e-9))
    plain, settled = (
        find_equilibrium(scene, fabric, start, laws=Laws(bending=law), options=OPTIONS)
        for law in ("hinge", "hinge_curvature"))
    assert plain.rounds == 1 and plain.change == 0.0
    assert settled.rounds == 2 and settled.change < 1e-4
    assert np.allclose(settled.state.positions, plain.state.positions, atol=1e-8)


def test_a_drape_settles_where_its_directions_are_its_own():
    """A strongly anisotropic fabric, whose directions jump without the blend with the mean."""
    specimen = make_specimen(Rig(), edge=0.02, grading=1)
    mesh, held = specimen.mesh, specimen.held
    x, y = mesh.rest.T
    far = np.maximum(np.hypot(x, y) - 0.05, 0)
    height = -0.5 * far + 0.2 * far * np.cos(4 * np.arctan2(y, x))
    bent = np.column_stack([0.9 * x, 0.9 * y, height])
    bent[held] = np.column_stack([mesh.rest[held], np.zeros(held.sum())])
    scene = Scene(mesh=mesh, held=held, obstacles=Rig().obstacles)
    start = scene.state(bent)
    fabric = Fabric(np.array([98.8e-6, 23.5e-6, 21.2e-6]), np.array([-247e-9, -59e-9, -53e-9]))
    laws = Laws(bending="hinge_curvature")
    found = find_equilibrium(scene, fabric, start, laws=laws, options=OPTIONS)
    state = found.state
    assert found.converged and 3 <= found.rounds <= 15 and found.change < 0.01
    # its own directions, all at once, leave it where it is
    axes = hinge_directions(mesh, scene.active, state.positions)
    own = replace(laws, bending=HingeLaw("hinge", "curvature", axes))
    again = find_equilibrium(scene, fabric, state, laws=own, options=OPTIONS)
    moved = np.linalg.norm(again.state.positions - state.positions, axis=1).max()
    assert moved < 2e-5
    mean = find_equilibrium(scene, fabric, state, laws=Laws(bending="hinge"), options=OPTIONS)
    assert np.linalg.norm(mean.state.positions - state.positions, axis=1).max() > 2e-3


def test_an_unsettled_iteration_says_so(warp_strip, monkeypatch):
    scene, start = warp_strip
    laws = Laws(bending="hinge_curvature")
    short = NewtonOptions(max_iterations=1)
    found = find_equilibrium(scene, Fabric(MODULI), start, laws=laws, options=short)
    assert found.status is Status.MAX_ITERATIONS and found.rounds == 1
    monkeypatch.setattr("sim.lagged.MAX_ROUNDS", 1)
    found = find_equilibrium(scene, Fabric(MODULI), start, laws=laws, options=OPTIONS)
    assert found.status is Status.MAX_ITERATIONS and "do not settle" in found.message
    assert found.rounds == 1 and found.change == np.inf
