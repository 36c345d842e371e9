"""Hinge laws: derivatives, the energy of one hinge written down by hand, clamp and direction."""

import numpy as np
import pytest
from test_energies import (
    ANISOTROPIC,
    STEPS,
    STIFFENING,
    assert_error_falls_with_square,
    crumpled_strip,
)

from common.errors import InputError
from sim.energies.hinges import DihedralBending, QuadraticBending, find_hinges
from sim.hinge_laws import HINGE_LAWS, HingeLaw
from sim.laws import BENDING, Laws
from sim.material import SOFTENING_LIMIT, Fabric, bending_work, torque
from sim.mesh import Mesh, strip

CASES = {
    "hinge softening": (HingeLaw("hinge", "edge"), ANISOTROPIC),
    "hinge stiffening": (HingeLaw("hinge"), STIFFENING),
    "hinge linear": (HingeLaw("hinge_linear", "edge"), ANISOTROPIC),
    "quadratic": (HingeLaw("quadratic", "edge"), ANISOTROPIC),
}
ISOTROPIC = Fabric(np.full(3, 20e-6), np.full(3, -60e-9))


def energy_and_state(name: str):
    mesh, active, q = crumpled_strip()
    law, fabric = CASES[name]
    return law(mesh, active, fabric=fabric), q


@pytest.mark.parametrize("name", CASES)
def test_gradient_and_hessian_are_derivatives(name):
    energy, q = energy_and_state(name)
    direction = np.random.default_rng(2).standard_normal(len(q))
    ahead = [(q + h * direction, q - h * direction, 2 * h) for h in STEPS]
    gradient = np.bincount(energy.dofs.ravel(), energy.gradient(q).ravel(), minlength=len(q))
    errors = [abs((energy.value(a) - energy.value(b)) / h - gradient @ direction)
              for a, b, h in ahead]
    assert_error_falls_with_square(errors, np.abs(gradient) @ np.abs(direction))
    exact = np.einsum("nij,nj->ni", energy.hessian(q), direction[energy.dofs])
    errors = [np.abs((energy.gradient(a) - energy.gradient(b)) / h - exact).max()
              for a, b, h in ahead]
    assert_error_falls_with_square(errors, np.abs(exact).max())


@pytest.mark.parametrize("name", CASES)
def test_the_convex_hessian_is_semi_definite(name):
    energy, q = energy_and_state(name)
    exact, convex = energy.hessian(q), energy.hessian(q, convex=True)
    size = np.abs(convex).max()
    assert np.linalg.eigvalsh(convex).min() > -1e-12 * size
    if name != "quadratic":
        assert np.linalg.eigvalsh(exact).min() < -1e-3 * size  # or there was nothing to remove


@pytest.mark.parametrize("name", CASES)
def test_rigid_motions_and_turning_over_change_nothing(name):
    energy, q = energy_and_state(name)
    vertices = 3 * len(crumpled_strip()[0].rest)
    rotation, _ = np.linalg.qr(np.random.default_rng(4).standard_normal((3, 3)))
    for turn in (rotation, -rotation):  # one of them mirrors
        moved = q.copy()
        moved[:vertices] = (q[:vertices].reshape(-1, 3) @ turn.T + [1, 2, 3]).ravel()
        assert energy.value(moved) == pytest.approx(energy.value(q), rel=1e-9)


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


@pytest.mark.parametrize("angle", [0.05, -0.4, 1.5])
@pytest.mark.parametrize("beta", [-60e-9, 0.0, 40e-9])
def test_a_hinge_stores_the_work_of_its_torque(angle, beta):
    """Eq. 1 with kappa = 2 theta/(H0 + H1), by quadrature; up to far beyond the torque's peak."""
    mesh, q, edge, heights = one_hinge(angle)
    fabric = Fabric(np.full(3, 20e-6), np.full(3, beta))
    path = np.linspace(0, abs(angle), 20001)
    moments = torque(2 * path / sum(heights), 20e-6, beta) * edge
    work = np.sum((moments[1:] + moments[:-1]) / 2 * np.diff(path))
    assert HingeLaw("hinge")(mesh, BOTH, fabric=fabric).value(q) == pytest.approx(work, rel=1e-7)
    linear = HingeLaw("hinge_linear")(mesh, BOTH, fabric=fabric).value(q)
    assert linear == pytest.approx(20e-6 * angle**2 * edge / sum(heights), rel=1e-12)


def test_the_law_is_the_materials_and_passes_its_limit_smoothly():
    alpha, beta = 20e-6, -60e-9
    limit = SOFTENING_LIMIT * alpha / -beta
    curvature = np.concatenate([np.linspace(0, limit, 40), limit * np.linspace(1, 5, 40)])
    _, moment, tangent = bending_work(curvature, alpha, beta)
    assert np.allclose(moment, torque(curvature, alpha, beta), rtol=1e-12, atol=0)
    assert tangent.min() == pytest.approx(alpha * (1 - 2 * SOFTENING_LIMIT))
    before, after = (bending_work(np.array([limit * (1 + d)]), alpha, beta)
                     for d in (-1e-9, 1e-9))
    assert np.allclose(before, after, rtol=1e-8)


@pytest.mark.parametrize("angle", [0.01, 0.7, 2.5])
def test_quadratic_law_of_a_fold(angle):
    """|K x| = 2 e sin(theta/2), so E = 12 gamma e sin²(theta/2)/(H0 + H1), gamma = alpha/3."""
    mesh, q, edge, heights = one_hinge(angle)
    energy = HingeLaw("quadratic")(mesh, BOTH, fabric=ISOTROPIC)
    expected = 4 * 20e-6 * edge * np.sin(angle / 2) ** 2 / sum(heights)
    assert energy.value(q) == pytest.approx(expected, rel=1e-12)
    assert np.array_equal(energy.hessian(q), energy.hessian(2 * q, 1.0))
    # flat cloth, however deformed in its plane, costs nothing
    flat = np.column_stack([mesh.rest @ np.array([[1.2, 0.3], [-0.1, 0.9]]), np.zeros(4)])
    assert energy.value(flat.ravel()) < 1e-25


def test_the_clamp_counts_on_its_free_side_alone():
    mesh, q, edge, heights = one_hinge(0.4)
    free_side = np.array([False, True])
    energy = HingeLaw("hinge_linear")(mesh, free_side, fabric=ISOTROPIC)
    assert energy.value(q) == pytest.approx(20e-6 * 0.4**2 * edge / heights[1], rel=1e-12)
    assert len(find_hinges(mesh, np.zeros(2, dtype=bool)).edge) == 0


def test_hinges_are_the_inner_edges_once_each():
    mesh, active, _ = crumpled_strip()
    hinges = find_hinges(mesh, active)
    inner = mesh.edge_faces[:, 1] >= 0
    beside = active[mesh.edge_faces].any(axis=1)
    assert np.array_equal(hinges.edge, np.flatnonzero(inner & beside))
    assert np.array_equal(np.sort(hinges.corners[:, :2], axis=1), mesh.edges[hinges.edge])
    assert hinges.movable[:, 0].all() and not hinges.movable.all()
    # both triangles' areas from the corners themselves
    for side, sign in ((0, 1.0), (1, -1.0)):
        e, a = hinges.vectors, hinges.opposite[:, side]
        twice = sign * (e[:, 0] * a[:, 1] - e[:, 1] * a[:, 0])
        assert np.allclose(hinges.areas[:, side], twice / 2, rtol=1e-12)


@pytest.mark.parametrize(("turn", "modulus"), [(0, 0), (45, 1), (90, 2), (-45, 1), (180, 0)])
def test_edge_based_modulus_is_that_across_the_edge(turn, modulus):
    """A hinge whose edge runs along weft bends the warp, and so on."""
    mesh, q, edge, heights = one_hinge(0.3, np.deg2rad(turn))
    energy = HingeLaw("hinge_linear", "edge")(mesh, BOTH, fabric=ANISOTROPIC)
    expected = ANISOTROPIC.alpha[modulus] * 0.3**2 * edge / sum(heights)
    assert energy.value(q) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("diagonals", ["alternating", "equal", "random"])
def test_an_imposed_cylinder_costs_what_the_plate_costs_on_a_grid(diagonals):
    """Exactly, but for the half cell at either end that no hinge stands for; not if jittered."""
    radius, cells = 0.2, 40
    stored = {}
    for jitter in (0.0, 0.2):
        mesh, _ = strip(length=0.3, width=0.15, edge=0.3 / cells, clamp=0.0, diagonals=diagonals,
                        jitter=jitter)
        x, y = mesh.rest.T
        bent = np.column_stack([radius * np.sin(x / radius), y, radius * np.cos(x / radius)])
        everywhere = np.ones(len(mesh.faces), dtype=bool)
        energy = HingeLaw("hinge_linear")(mesh, everywhere, fabric=ISOTROPIC)
        plate = 0.5 * 20e-6 / radius**2 * 0.3 * 0.15
        stored[jitter] = energy.value(bent.ravel()) / plate
    assert stored[0.0] == pytest.approx(1 - 1 / cells, abs=1e-3)
    assert stored[0.2] > 1.05


def test_moduli_enter_linearly_and_isotropic_fabrics_have_no_direction():
    mesh, active, q = crumpled_strip()
    hinges = find_hinges(mesh, active)
    count = len(hinges.edge)
    once, thrice = (QuadraticBending(hinges, gamma=np.full(count, g)).value(q)
                    for g in (1e-5, 3e-5))
    assert thrice == pytest.approx(3 * once)
    axes = np.random.default_rng(0).uniform(-0.7, 0.7, (count, 2))
    values = [HingeLaw("hinge", direction, axes)(mesh, active, fabric=ISOTROPIC).value(q)
              for direction in ("mean", "edge", "curvature")]
    assert values == pytest.approx([values[0]] * 3, rel=1e-12)
    by_hand = DihedralBending(hinges, alpha=np.full(count, 20e-6), beta=np.full(count, -60e-9),
                              stiffness=20e-6)
    assert by_hand.value(q) == pytest.approx(values[0], rel=1e-12)


def test_laws_by_name_and_by_value():
    assert set(HINGE_LAWS) < set(BENDING) and len(HINGE_LAWS) == 9
    assert Laws(bending="quadratic_edge").bending_law == HingeLaw("quadratic", "edge")
    assert Laws(bending=HingeLaw("hinge")).bending_law is not None
    with pytest.raises(InputError, match="unknown bending law 'hinges'"):
        Laws(bending="hinges")
    with pytest.raises(InputError, match="unknown hinge law"):
        HingeLaw("cubic")
    with pytest.raises(InputError, match="unknown direction"):
        HingeLaw("hinge", "weft")
    mesh, active, _ = crumpled_strip()
    with pytest.raises(InputError, match="find_equilibrium"):
        HINGE_LAWS["hinge_curvature"](mesh, active, fabric=ISOTROPIC)
