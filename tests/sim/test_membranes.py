"""In-plane laws: derivatives, analytic tension, invariances, and what the guard lets go free."""

import numpy as np
import pytest
from test_energies import STEPS, assert_error_falls_with_square, crumpled_strip, scattered

from common.errors import InputError
from sim.cloth import Laws
from sim.drape import drape
from sim.energies.membrane import Corotational, Guarded, OrthotropicStVK
from sim.material import Fabric
from sim.mesh import strip

ORTHOTROPIC = OrthotropicStVK(warp=400.0, weft=90.0, poisson=0.6, shear=30.0)
MEMBRANES = {
    "corotational": Corotational(),
    "stvk": ORTHOTROPIC,
    "guarded corotational": Guarded(Corotational(5000.0)),
    "guarded stvk": Guarded(OrthotropicStVK(5000.0, 2000.0, 0.5, 600.0)),
}


def energy_and_state(name: str, amplitude: float = 1e-3):
    mesh, active, q = crumpled_strip(amplitude=amplitude)
    return MEMBRANES[name].energy(mesh, active), q[: 3 * len(mesh.rest)]


def stretched(membrane, warp: float, weft: float, shear: float = 0.0):
    """Energy per rest area (J/m²) of cloth stretched and sheared evenly."""
    mesh, _ = strip(length=0.03, width=0.02, edge=0.01, clamp=0.01, diagonals="random", seed=1)
    everywhere = np.ones(len(mesh.faces), dtype=bool)
    energy = membrane.energy(mesh, everywhere)
    F = np.array([[warp, shear], [0.0, weft], [0.0, 0.0]])
    return energy.value((mesh.rest @ F.T).ravel()) / mesh.areas.sum()


def pull(membrane, warp: float, weft: float, axis: int) -> float:
    """Force per rest width (N/m) along warp (0) or weft (1) at these stretches."""
    h = 1e-6
    step = (h, 0.0) if axis == 0 else (0.0, h)
    ahead = stretched(membrane, warp + step[0], weft + step[1])
    return (ahead - stretched(membrane, warp - step[0], weft - step[1])) / (2 * h)


@pytest.mark.parametrize("amplitude", [1e-3, 1e-4], ids=["crumpled", "in the band"])
@pytest.mark.parametrize("name", MEMBRANES)
def test_gradient_is_the_derivative_of_the_value(name, amplitude):
    energy, q = energy_and_state(name, amplitude)
    direction = np.random.default_rng(2).standard_normal(len(q))
    gradient = scattered(energy, energy.gradient(q))
    errors = [
        abs((energy.value(q + h * direction) - energy.value(q - h * direction)) / (2 * h)
            - gradient @ direction)
        for h in STEPS
    ]
    assert_error_falls_with_square(errors, np.abs(gradient) @ np.abs(direction))


@pytest.mark.parametrize("amplitude", [1e-3, 1e-4], ids=["crumpled", "in the band"])
@pytest.mark.parametrize("name", MEMBRANES)
def test_hessian_is_the_derivative_of_the_gradient(name, amplitude):
    energy, q = energy_and_state(name, amplitude)
    blocks = energy.hessian(q)
    direction = 0.2 * np.random.default_rng(3).standard_normal(len(q))
    exact = np.einsum("nij,nj->ni", blocks, direction[energy.dofs])
    errors = [
        np.abs((energy.gradient(q + h * direction) - energy.gradient(q - h * direction)) / (2 * h)
               - exact).max()
        for h in STEPS
    ]
    assert_error_falls_with_square(errors, np.abs(exact).max())
    assert np.allclose(blocks, np.swapaxes(blocks, 1, 2), atol=1e-12 * np.abs(blocks).max())


@pytest.mark.parametrize("name", MEMBRANES)
def test_convexity_removes_the_indefinite_part(name):
    energy, q = energy_and_state(name)
    exact, convex = energy.hessian(q), energy.hessian(q, convex=True)
    size = np.abs(convex).max()
    assert np.linalg.eigvalsh(exact).min() < -1e-6 * size  # or nothing would be removed
    assert np.linalg.eigvalsh(convex).min() > -1e-12 * size


def test_convexity_leaves_cloth_under_tension_alone():
    mesh, active, _ = crumpled_strip()
    taut = np.column_stack([1.03 * mesh.rest, np.zeros(len(mesh.rest))]).ravel()
    for membrane in MEMBRANES.values():
        energy = membrane.energy(mesh, active)
        exact, convex = energy.hessian(taut), energy.hessian(taut, convex=True)
        assert np.allclose(exact, convex, rtol=0, atol=1e-12 * np.abs(exact).max())


@pytest.mark.parametrize("name", MEMBRANES)
def test_rigid_motions_cost_nothing(name):
    energy, q = energy_and_state(name)
    mesh, _, _ = crumpled_strip()
    rotation, _ = np.linalg.qr(np.random.default_rng(4).standard_normal((3, 3)))
    moved = (q.reshape(-1, 3) @ rotation.T + [1, 2, 3]).ravel()
    assert energy.value(moved) == pytest.approx(energy.value(q), rel=1e-10)
    flat = np.column_stack([mesh.rest, np.zeros(len(mesh.rest))]) @ rotation.T
    assert abs(energy.value(flat.ravel())) < 1e-18
    assert np.abs(energy.gradient(flat.ravel())).max() < 1e-12


def test_uniaxial_tension_has_the_youngs_modulus_and_poisson_ratio_of_each_direction():
    """Larionov et al., Eq. 6: with free sides S_uu = E_warp E_uu and E_vv = -n E_uu."""
    for axis, modulus, ratio in ((0, 400.0, 0.6), (1, 90.0, 0.6 * 90 / 400)):
        green = 0.03
        along, across = np.sqrt(1 + 2 * green), np.sqrt(1 - 2 * ratio * green)
        stretches = (along, across) if axis == 0 else (across, along)
        assert pull(ORTHOTROPIC, *stretches, 1 - axis) == pytest.approx(0.0, abs=1e-7)
        # Force per rest width is the first Piola-Kirchhoff stress, stretch times S.
        assert pull(ORTHOTROPIC, *stretches, axis) == pytest.approx(
            along * modulus * green, rel=1e-7
        )


def test_simple_shear_has_the_shear_modulus():
    gamma = 0.01
    normal = gamma**2 / 2  # E_vv of simple shear
    weft = 90 / (1 - 0.36 * 90 / 400)
    expected = 0.5 * 30 * gamma**2 + 0.5 * weft * normal**2
    assert stretched(ORTHOTROPIC, 1.0, 1.0, gamma) == pytest.approx(expected, rel=1e-10)


def test_small_strains_do_not_tell_isotropic_stvk_from_corotational():
    laws = Corotational(200.0, 0.3), OrthotropicStVK()
    for stretches in ((1.001, 1.0), (0.9995, 1.001), (1.0, 1.001)):
        one, other = (stretched(law, *stretches) for law in laws)
        assert one == pytest.approx(other, rel=3e-3)


def test_corotational_guard_of_no_width_is_the_corotational_law():
    mesh, active, q = crumpled_strip()
    plain = Corotational(200.0).energy(mesh, active)
    guarded = Guarded(Corotational(200.0), low=1 - 1e-9, high=1 + 1e-9).energy(mesh, active)
    assert guarded.value(q) == pytest.approx(plain.value(q), rel=1e-6)
    assert np.allclose(guarded.gradient(q), plain.gradient(q), rtol=0, atol=1e-7)
    exact = plain.hessian(q)
    assert np.allclose(guarded.hessian(q), exact, rtol=0, atol=1e-6 * np.abs(exact).max())


@pytest.mark.parametrize(
    "inner",
    [Corotational(5000.0), OrthotropicStVK(5000.0, 3000.0, 0.3, 900.0)],
)
def test_strain_within_the_band_costs_the_share_only(inner):
    guard = Guarded(inner, share=1e-6)
    for stretches in ((1.007, 1.0), (0.993, 1.006), (1.0, 0.993), (1.005, 1.005)):
        plain = stretched(inner, *stretches)
        assert plain > 0
        assert stretched(guard, *stretches) == pytest.approx(1e-6 * plain, rel=1e-3, abs=1e-18)
    # A little shear too, which turns the principal directions
    assert stretched(guard, 1.0, 1.0, 0.01) < 2e-6 * stretched(inner, 1.0, 1.0, 0.01)


def test_beyond_the_band_the_guard_resists_the_excess():
    """Stretched to 103 % along warp: 2 % too much of 5000 N/m, and the share of all of it."""
    inner = Corotational(5000.0, 0.0)
    guard = Guarded(inner, share=0.02)
    assert pull(guard, 1.03, 1.0, 0) == pytest.approx(0.98 * 100 + 0.02 * 150, rel=1e-6)
    assert pull(guard, 0.98, 1.0, 0) == pytest.approx(-0.98 * 50 - 0.02 * 100, rel=1e-6)


def test_corotational_guard_has_no_direction():
    """The same stretches at 0° and 30° from the mesh's axes cost the same."""
    mesh, _ = strip(length=0.03, width=0.02, edge=0.01, clamp=0.01)
    energy = Guarded(Corotational(5000.0)).energy(mesh, np.ones(len(mesh.faces), dtype=bool))
    c, s = np.cos(np.pi / 6), np.sin(np.pi / 6)
    turn = np.array([[c, -s], [s, c]])
    stretch = np.diag([1.025, 0.995])
    values = []
    for F in (stretch, turn @ stretch @ turn.T):
        flat = np.column_stack([mesh.rest @ F.T, np.zeros(len(mesh.rest))])
        values.append(energy.value(flat.ravel()))
    assert values[0] == pytest.approx(values[1], rel=1e-10) and values[0] > 0


def test_excess_is_nothing_inside_and_the_distance_outside():
    guard = Guarded(low=0.99, high=1.02)
    strain = np.array([[-0.03, -0.007], [0.0, 0.014], [0.05, 0.0]])
    excess, slope, bend = guard.excess(strain)
    assert np.allclose(excess, [[-0.02, 0], [0, 0], [0.03, 0]], atol=1e-15)
    assert np.allclose(slope, [[1, 0], [0, 0], [1, 0]]) and np.allclose(bend, 0)


def test_warp_and_weft_are_not_swapped_in_a_drape():
    """Cloth whose warp is soft in plane is strained along warp, on the rest axis of the mesh."""
    fabric = Fabric(np.full(3, 100e-6))
    for warp, weft in ((30.0, 400.0), (400.0, 30.0)):
        membrane = OrthotropicStVK(warp, weft, 0.0, 50.0)
        result = drape(fabric, edge=8e-3, seed=1, laws=Laws(membrane=membrane))
        assert result.converged, result.message
        ends = result.mesh.edges
        edges = result.rest[ends[:, 1]] - result.rest[ends[:, 0]]
        now = result.positions[ends[:, 1]] - result.positions[ends[:, 0]]
        lengths = np.linalg.norm(edges, axis=1)
        strain = np.linalg.norm(now, axis=1) / lengths - 1
        along_warp, along_weft = (
            np.sqrt((strain[np.abs(edges[:, axis]) > 0.95 * lengths] ** 2).mean())
            for axis in (0, 1)
        )
        assert (along_warp > 3 * along_weft) == (warp < weft)
        assert (along_weft > 3 * along_warp) == (weft < warp)


def test_the_guard_keeps_a_stiff_membrane_from_stiffening_a_coarse_drape():
    """On a mesh of 8 mm edges at the rim, 5000 N/m moves it; guarded it moves less than half."""
    fabric = Fabric(np.full(3, 100e-6))
    drapes = [
        drape(fabric, edge=8e-3, seed=1, laws=Laws(membrane=membrane))
        for membrane in (Corotational(), Corotational(5000.0), Guarded(Corotational(5000.0)))
    ]
    assert all(d.converged for d in drapes)
    plain, stiff, guarded = (d.positions for d in drapes)
    moved, kept = (np.linalg.norm(p - plain, axis=1).mean() for p in (stiff, guarded))
    assert kept < 0.5 * moved


def test_stiffness_scales():
    mesh, active, q = crumpled_strip()
    for membrane in MEMBRANES.values():
        once, thrice = membrane.energy(mesh, active), membrane.scaled(3.0).energy(mesh, active)
        assert thrice.value(q) == pytest.approx(3 * once.value(q), rel=1e-9)


@pytest.mark.parametrize(
    ("make", "word"),
    [
        (lambda: Corotational(-1.0), "stiffness"),
        (lambda: Corotational(200.0, 1.0), "poisson"),
        (lambda: OrthotropicStVK(shear=0.0), "shear"),
        (lambda: OrthotropicStVK(warp=100.0, weft=400.0, poisson=0.5), "poisson"),
        (lambda: Guarded(low=1.0), "free stretch"),
        (lambda: Guarded(share=0.0), "share"),
    ],
)
def test_impossible_parameters_are_refused(make, word):
    with pytest.raises(InputError, match=word):
        make()
