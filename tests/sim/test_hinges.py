"""Bending by hinges, and hysteresis."""

import numpy as np
import pytest
from scipy.integrate import simpson
from scipy.optimize import brentq
from test_energies import ANISOTROPIC, crumpled_strip

from common.errors import InputError
from drapenet.export.material import GAMMA, MESHES, hinge_ratio
from sim.cantilever.elastica import aspect_ratio, gamma_of_aspect_ratio
from sim.cantilever.strip import fabric_of_gamma, hang
from sim.cloth import Laws
from sim.energies.bending_variants import (
    BUILD_UP,
    Hysteresis,
    HystereticBending,
)
from sim.energies.hinges import (
    ARCSIM,
    DISCRETE_SHELLS,
    HingeBending,
    Hinges,
    mean_modulus,
    modulus_along,
)
from sim.equilibrium import find_equilibrium
from sim.material import KES_CURVATURE, Fabric, torque
from sim.mesh import Mesh, strip
from sim.scene import Scene
from sim.solver.newton import NewtonOptions

TWILL = Fabric(np.array([30e-6, 20e-6, 14e-6]), np.array([-66e-9, -40e-9, -21e-9]))
ANGLES = {0: 0.0, 1: np.pi / 4, 2: np.pi / 2}
UP = np.arange(1.0, 251.0)  # KES-FB2 bends to 2.5 cm⁻¹
DOWN = np.arange(249.0, -1.0, -1.0)
STEP = 1e-3  # 1/m, of the differences of the energy


def one_hinge(angle: float, turn: float = 0.0):
    """Two unequal triangles folded by ``angle`` about an edge at ``turn`` + 90° to the warp.

    Returns the mesh, unknowns, the edge's length and both heights.
    """
    edge, heights, feet = 0.011, (0.007, 0.004), (0.3, 0.8)
    flat = np.array([[0.0, 0.0], [0.0, edge], [-heights[0], feet[0] * edge],
                     [heights[1], feet[1] * edge]])
    c, s = np.cos(turn), np.sin(turn)
    mesh = Mesh(rest=flat @ np.array([[c, s], [-s, c]]), faces=np.array([[0, 1, 2], [1, 0, 3]]))
    positions = np.column_stack([flat, np.zeros(4)])
    positions[3] = [heights[1] * np.cos(angle), feet[1] * edge, heights[1] * np.sin(angle)]
    return mesh, positions.ravel(), edge, heights


BOTH = np.ones(2, dtype=bool)
LINEAR = Fabric(np.full(3, 20e-6))


MODULI = np.array([90e-6, 25e-6, 40e-6])


@pytest.mark.parametrize("angle", [0.05, -0.4, 1.5])
@pytest.mark.parametrize("beta", [-60e-9, 0.0, 40e-9])
def test_a_hinge_stores_the_work_of_its_torque(angle, beta):
    """Eq. 1 with kappa = 2 theta/(H0 + H1), by quadrature; up to far beyond the torque's peak. The
    modulus of an isotropic fabric has no direction."""
    mesh, q, edge, heights = one_hinge(angle)
    fabric = Fabric(np.full(3, 20e-6), np.full(3, beta))
    path = np.linspace(0, abs(angle), 20001)
    moments = torque(2 * path / sum(heights), 20e-6, beta) * edge
    work = np.sum((moments[1:] + moments[:-1]) / 2 * np.diff(path))
    for directed in (False, True):
        energy = HingeBending(mesh, BOTH, fabric=fabric, directed=directed)
        assert energy.value(q) == pytest.approx(work, rel=1e-7)
    linear = HingeBending(mesh, BOTH, fabric=fabric, linear=True).value(q)
    assert linear == pytest.approx(20e-6 * angle**2 * edge / sum(heights), rel=1e-12)


def test_the_clamp_counts_on_its_free_side_alone():
    mesh, q, edge, heights = one_hinge(0.4)
    energy = HingeBending(mesh, np.array([False, True]), fabric=LINEAR)
    assert energy.value(q) == pytest.approx(20e-6 * 0.4**2 * edge / heights[1], rel=1e-12)
    assert len(Hinges(mesh, np.zeros(2, dtype=bool)).corners) == 0


def test_hinges_are_the_inner_edges_once_each():
    mesh, active, _ = crumpled_strip()
    hinges = Hinges(mesh, active)
    edge = np.flatnonzero((mesh.edge_faces[:, 1] >= 0) & active[mesh.edge_faces].any(axis=1))
    assert np.array_equal(np.sort(hinges.corners[:, :2], axis=1), mesh.edges[edge])
    # both triangles' areas from the corners themselves, the first of a triangle that can move
    rest = mesh.rest[hinges.corners]
    along, *sides = (rest[:, k] - rest[:, 0] for k in (1, 2, 3))
    first, second = (sign / 2 * (along[:, 0] * a[:, 1] - along[:, 1] * a[:, 0])
                     for sign, a in zip((1, -1), sides, strict=True))
    assert min(first.min(), second.min()) > 0
    clamped = ~active[mesh.edge_faces[edge]].all(axis=1)
    assert clamped.any()
    assert np.allclose(hinges.areas, np.where(clamped, first, first + second), rtol=1e-12)


@pytest.mark.parametrize(("turn", "modulus"), [(0, 0), (45, 1), (90, 2), (-45, 1), (180, 0)])
def test_edge_based_modulus_is_that_across_the_edge(turn, modulus):
    """A hinge whose edge runs along weft bends the warp, and so on."""
    mesh, q, edge, heights = one_hinge(0.3, np.deg2rad(turn))
    energy = HingeBending(mesh, BOTH, fabric=ANISOTROPIC, directed=True, linear=True)
    expected = ANISOTROPIC.alpha[modulus] * 0.3**2 * edge / sum(heights)
    assert energy.value(q) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("diagonals", ["alternating", "equal", "random"])
def test_an_imposed_cylinder_costs_what_the_plate_costs_on_a_grid(diagonals):
    """Exactly, but for the half cell at either end that no hinge stands for; not if jittered."""
    radius, cells = 0.2, 40
    energies = {}
    for jitter in (0.0, 0.2):
        mesh, _ = strip(length=0.3, width=0.15, edge=0.3 / cells, clamp=0.0, diagonals=diagonals,
                        jitter=jitter)
        x, y = mesh.rest.T
        bent = np.column_stack([radius * np.sin(x / radius), y, radius * np.cos(x / radius)])
        everywhere = np.ones(len(mesh.faces), dtype=bool)
        energy = HingeBending(mesh, everywhere, fabric=LINEAR)
        plate = 0.5 * 20e-6 / radius**2 * 0.3 * 0.15
        energies[jitter] = energy.value(bent.ravel()) / plate
    assert energies[0.0] == pytest.approx(1 - 1 / cells, abs=1e-3)
    assert energies[0.2] > 1.05


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
    turn = np.linspace(0, 2 * np.pi, 100_000, endpoint=False)
    assert mean_modulus(MODULI) == pytest.approx(modulus_along(MODULI, turn).mean(), rel=1e-8)


def test_other_tools_store_the_same_energy():
    """ArcSim: k l² theta²/(8 A), and k from a table over kappa = theta l/A for the non-linear law.
    Discrete shells: a theta² e/(2 h) with h a third of the mean height; half of a without the half.
    """
    alpha, beta, angle = 25e-6, -30e-9, 0.5  # kappa = 91 1/m, far below the torque's peak at 417
    mesh, q, edge, (h0, h1) = one_hinge(angle)
    linear, nonlinear = (
        HingeBending(mesh, BOTH, fabric=Fabric([alpha] * 3, [b] * 3)).value(q) for b in (0.0, beta))
    area, height = edge * (h0 + h1) / 2, (h0 + h1) / 2 / 3
    k, b = alpha / ARCSIM, beta / ARCSIM**2
    shells, of_square = alpha / DISCRETE_SHELLS, beta / DISCRETE_SHELLS**2
    assert k * edge**2 / (2 * area) * angle**2 / 4 == pytest.approx(linear, rel=1e-12)
    assert shells * angle**2 * edge / (2 * height) == pytest.approx(linear, rel=1e-12)
    assert shells / 2 * angle**2 * edge / height == pytest.approx(linear, rel=1e-12)
    theta, curvature = np.linspace(0, angle, 2001), 1 / (2 * (h0 + h1))
    for torques in (
            k * curvature * theta + b * (curvature * theta) ** 2,
            4 * (alpha + beta * theta * edge / area) * edge / (4 * area) * theta,
            shells * theta / height + of_square * (theta / height) ** 2):
        assert edge * simpson(torques, x=theta) == pytest.approx(nonlinear, rel=1e-10)


def pure_bending(fabric, law, curvatures, *, angle: float = 0.0) -> np.ndarray:
    """Torques per width (K,), N, of cloth bent to ``curvatures`` (K,), 1/m, one after the other.

    The torque is the derivative of the energy of a cylinder by the curvature, without stresses.
    Hysteresis follows every curvature in turn, so that they should be close to each other.
    """
    flat, _ = strip(length=4e-3, width=4e-3, edge=5e-4, clamp=0.0)
    along, across = flat.rest.T
    cos, sin = np.cos(angle), np.sin(angle)
    mesh = Mesh(np.column_stack([cos * along - sin * across, sin * along + cos * across]),
                flat.faces)
    energy = law(mesh, np.ones(len(mesh.faces), dtype=bool), fabric=fabric)

    def bent(curvature: float) -> np.ndarray:
        """The cylinder's positions and edge normals."""
        turn = curvature * along
        middle = turn[mesh.edges].mean(axis=1)
        reach, drop = along * np.sinc(turn / np.pi), along * np.sinc(turn / 2 / np.pi) * np.sin(
            turn / 2)
        positions = np.column_stack([reach, across, -drop])
        normals = np.column_stack([np.sin(middle), np.zeros(len(middle)), np.cos(middle)])
        return np.concatenate([positions.ravel(), normals.ravel()])

    torques = []
    for curvature in curvatures:
        ends = [energy.value(bent(curvature + sign * STEP)) for sign in (1, -1)]
        torques.append((ends[0] - ends[1]) / (2 * STEP * mesh.areas.sum()))
        if isinstance(energy, HystereticBending):
            energy = energy.with_origin(energy.origin_at(bent(curvature)))
    return np.array(torques)


def cycle(fabric: Fabric, law: Hysteresis, direction: int) -> tuple[np.ndarray, np.ndarray]:
    """Torques, N, at 1 to 250 1/m, and at 249 to 0 1/m on the way back."""
    torques = pure_bending(fabric, law, [*UP, *DOWN], angle=ANGLES[direction])
    return torques[: len(UP)], torques[len(UP):]


@pytest.mark.parametrize(("direction", "share"), [(0, 0.05), (1, 0.2), (2, 0.37)])
def test_fabric_of_moduli_is_loaded_and_unloaded_as_stated(share, direction):
    law = Hysteresis(share)
    loading, unloading = cycle(TWILL, law, direction)
    stated = torque(UP, TWILL.alpha[direction], TWILL.beta[direction])
    assert np.allclose(loading, stated, rtol=1e-2)
    friction = share * stated[UP == KES_CURVATURE][0]
    assert law.friction(TWILL)[direction] == pytest.approx(friction, rel=1e-2)
    # Beyond the build-up of the way back, the difference is 2HB; it is read at 1 cm⁻¹.
    saturated = np.searchsorted(-DOWN, -KES_CURVATURE)
    assert stated[UP == KES_CURVATURE][0] - unloading[saturated] == pytest.approx(
        2 * friction, rel=1e-2)


@pytest.mark.parametrize("direction", ANGLES)
def test_fabric_of_kes_has_its_b_2hb_and_residual_curvature(direction):
    b, two_hb = np.array([9e-6, 6e-6, 5e-6]), np.array([4.5e-4, 2.4e-4, 1.2e-4])
    share = two_hb / (2 * KES_CURVATURE * b + two_hb)  # of a loading torque of B kappa + HB
    fabric, law = Fabric(b), Hysteresis(tuple(share.tolist()), added=True)
    loading, unloading = cycle(fabric, law, direction)
    between = (UP >= 50) & (UP <= 150)
    slope, intercept = np.polyfit(UP[between], loading[between], 1)
    assert slope == pytest.approx(b[direction], rel=1e-2)
    assert intercept == pytest.approx(two_hb[direction] / 2, rel=1e-2)
    at = np.searchsorted(-DOWN, -KES_CURVATURE)
    gap = loading[UP == KES_CURVATURE][0] - unloading[at]
    assert gap == pytest.approx(two_hb[direction], rel=1e-2)
    # B kappa - HB = 0
    residual = brentq(lambda k: np.interp(k, DOWN[::-1], unloading[::-1]), 1.0, 200.0)
    assert residual == pytest.approx(two_hb[direction] / 2 / b[direction], rel=1e-2)


def test_a_closed_cycle_loses_energy_and_a_reversal_inside_the_build_up_does_not():
    law = Hysteresis(0.2)
    path = np.concatenate([UP, DOWN, UP])
    torques = pure_bending(TWILL, law, path)
    loop = slice(len(UP) - 1, None)
    assert np.trapezoid(torques[loop], path[loop]) > 0.5 * 250 * law.friction(TWILL)[0]
    small = 0.1 * BUILD_UP * KES_CURVATURE
    first, _, again = pure_bending(TWILL, law, [80.0, 80.0 - small, 80.0])
    assert again == pytest.approx(first, rel=1e-6)


@pytest.fixture
def small():
    """A strip's mesh and its active faces."""
    mesh, held = strip(length=0.03, width=0.012, edge=0.003, clamp=0.006)
    return mesh, ~held[mesh.faces].all(axis=1)


def test_friction_of_yarns_that_differ_has_a_plate_form(small):
    """Where the bias has too little friction for a plate, it has just enough."""
    fabric = Fabric(np.array([40e-6, 10.5e-6, 2e-6]))
    form = Hysteresis(0.3)(*small, fabric=fabric).variant
    assert form.p_xx * form.p_yy > form.p_mixed**2 and form.p_xy > 0


def test_an_origin_belongs_to_one_mesh(small):
    with pytest.raises(InputError, match=r"origin has shape \(5, 3\)"):
        Hysteresis(0.1, origin=np.zeros((5, 3)))(*small, fabric=TWILL)


def test_a_weightless_strip_rests_in_an_arc_of_its_natural_curvature():
    """Clamped level, it follows a circle of the natural curvature, downwards."""
    mesh, held = strip(length=0.06, width=0.012, edge=0.003, clamp=0.006)
    kappa = 15.0
    scene = Scene(mesh=mesh, held=held, gravity=0.0)
    found = find_equilibrium(
        scene, Fabric(np.full(3, 30e-6)),
        scene.state(np.column_stack([mesh.rest, np.zeros(len(mesh.rest))])),
        laws=Laws(bending=Hysteresis(curvature=(kappa, 0.0, 0.0))),
        options=NewtonOptions(residual=1e-4, step=1e-6))
    assert found.converged
    tip = found.state.positions[np.isclose(mesh.rest[:, 0], 0.06)].mean(axis=0)
    assert tip[0] == pytest.approx(np.sin(kappa * 0.06) / kappa, rel=3e-3)
    assert tip[2] == pytest.approx(-(1 - np.cos(kappa * 0.06)) / kappa, rel=2e-2)


@pytest.mark.parametrize(("kind", "cells"), [
    ("unstructured", 7), ("alternating", 9), ("equal", 6), ("random", 6)])
def test_strips_of_hinges_hang_as_the_elastica_with_the_exported_ratio(kind, cells):
    (diagonals, jitter), edge, found = MESHES[kind], 0.09 / cells, []
    alpha = hinge_ratio(kind, cells) * fabric_of_gamma(GAMMA, 0.09).alpha
    for seed in range(6 if jitter or diagonals == "random" else 1):
        hung = hang(Fabric(alpha), width=round(cells / 2) * edge, edge=edge, seed=seed,
                    diagonals=diagonals, jitter=jitter, laws=Laws(bending="hinge_linear"))
        found.append(gamma_of_aspect_ratio(aspect_ratio(hung.curve[-1])))
    assert np.mean(found) == pytest.approx(GAMMA, rel=5e-3)
