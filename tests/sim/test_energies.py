"""Energies: their derivatives, their check, and membranes."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from common.errors import InputError
from sim.cloth import Laws
from sim.draping import drape
from sim.energies.base import Energy, check
from sim.energies.bending_variants import Hysteresis
from sim.energies.external import Gravity, ObstacleContact
from sim.energies.fold_barrier import is_bent
from sim.energies.hinges import HingeBending
from sim.energies.membrane import Corotational, OrthotropicStVK
from sim.energies.midedge import MidEdgeBending
from sim.material import Fabric
from sim.mesh import strip
from sim.rig import Cylinder, Rig
from sim.scene import make_specimen
from sim.solver.newton import NewtonOptions
from sim.solver.state import State, moved

ANISOTROPIC = Fabric(alpha=[98.8e-6, 23.5e-6, 21.2e-6], beta=[-247e-9, -58.8e-9, -53e-9])
STIFFENING = Fabric(alpha=[20e-6, 30e-6, 10e-6], beta=[40e-9, 10e-9, 5e-9])


def crumpled_strip(seed: int = 0, amplitude: float = 1e-3, turn: float = 0.2):
    """A small strip, its active faces, and a strongly bent state."""
    rng = np.random.default_rng(seed)
    mesh, held = strip(length=0.04, width=0.03, edge=0.01, clamp=0.01, diagonals="random",
                       jitter=0.2, seed=seed)
    active = ~held[mesh.faces].all(axis=1)
    x, y = mesh.rest.T
    shape = np.column_stack([x, y, -8 * x**2 + 5 * x * y])
    positions = shape + rng.normal(0, amplitude, shape.shape)
    turns = np.concatenate([np.zeros(positions.size), rng.normal(0, turn, len(mesh.edges))])
    return mesh, active, moved(State.at(mesh, positions, active).q, mesh.edges, turns)


ORTHOTROPIC = OrthotropicStVK(warp=400.0, weft=90.0, poisson=0.6, shear=30.0)
LAWS = {
    "gravity": lambda mesh, active: Gravity(mesh, density=0.3, gravity=9.81),
    "membrane": Corotational().energy,
    "orthotropic membrane": ORTHOTROPIC.energy,
    "midedge softening": partial(MidEdgeBending, fabric=ANISOTROPIC),
    "midedge stiffening": partial(MidEdgeBending, fabric=STIFFENING),
    "fold limit": partial(MidEdgeBending, fabric=STIFFENING),
    "hinges": partial(HingeBending, fabric=ANISOTROPIC, directed=True),
}
HYSTERESIS = {"hysteresis": Hysteresis(0.3), "friction added to curled cloth": Hysteresis(
    (0.2, 0.3, 0.25), added=True, curvature=(3.0, -2.0, 0.0))}
SHAPES = {"fold limit": {"amplitude": 8e-3, "turn": 0.0}}
MESH, ACTIVE, BENT = crumpled_strip(amplitude=1e-4, turn=0.1)
FABRIC = Fabric([60e-6, 30e-6, 40e-6], [-90e-9, -40e-9, -60e-9])
MEMBRANES = (Corotational(), ORTHOTROPIC)


def case_of(name: str):
    """An energy, a state, and the edges whose normals are among its unknowns."""
    mesh, active, q = crumpled_strip(**SHAPES.get(name, {}))
    if name in HYSTERESIS:
        plain = MidEdgeBending(mesh, active, fabric=STIFFENING)
        law = replace(HYSTERESIS[name], origin=plain.curvatures(crumpled_strip(seed=1)[2]))
        return law(mesh, active, fabric=STIFFENING), q, mesh.edges
    if name in LAWS:
        energy = LAWS[name](mesh, active)
        # Or the cases would test nothing.
        if isinstance(energy, MidEdgeBending):
            assert is_bent(energy.angles(q), energy.pole).any() == (name == "fold limit")
        return energy, q, mesh.edges
    rng = np.random.default_rng(1)
    if name == "contact":
        points = rng.uniform(-0.045, 0.045, (40, 3)) - [0, 0, 0.05]
    else:  # at the rounded rim
        angle = rng.uniform(0, 2 * np.pi, 40)
        radius = 0.05 + rng.uniform(-0.9, -0.2, 40) * Cylinder(0.05).rim
        points = np.stack([radius * np.cos(angle), radius * np.sin(angle),
                           rng.uniform(-0.9, -0.2, 40) * Cylinder(0.05).rim], axis=1)
    contact = ObstacleContact(np.arange(40)[:, None], np.full(40, 1e-5), obstacle=Cylinder(0.05),
                              pressure=60.0)
    return contact, points.ravel(), np.zeros((0, 2), int)


ENERGIES = [*LAWS, *HYSTERESIS, "contact", "rim"]


STEPS = 2e-5 * 2.0 ** -np.arange(12)


def assert_error_falls_with_square(errors: list[float], scale: float) -> None:
    """Central differences over STEPS: the error falls by four per halving, down to rounding."""
    rates = np.log2(np.maximum(errors[:-1], 1e-300) / np.maximum(errors[1:], 1e-300))
    quadratic = np.abs(rates - 2) < 0.15
    in_a_row = quadratic[:-2] & quadratic[1:-1] & quadratic[2:]
    already_rounding = max(errors) < 1e-9 * scale
    assert in_a_row.any() or already_rounding, rates
    assert min(errors) < 1e-6 * scale


@pytest.mark.parametrize("name", ENERGIES)
def test_gradient_is_the_derivative_of_the_value(name):
    energy, q, edges = case_of(name)
    direction = np.random.default_rng(2).standard_normal(len(q) - 2 * len(edges))
    direction *= 0.1 if name == "rim" else 1.0  # within the rounding
    gradient = np.zeros(len(direction))
    np.add.at(gradient, energy.dofs, energy.gradient(q))
    errors = [abs((energy.value(moved(q, edges, h * direction))
                   - energy.value(moved(q, edges, -h * direction))) / (2 * h)
                  - gradient @ direction) for h in STEPS]
    assert_error_falls_with_square(errors, np.abs(gradient) @ np.abs(direction))


@pytest.mark.parametrize("name", ENERGIES)
def test_the_hessian_is_the_derivative_of_the_gradient_and_its_convex_form_semi_definite(name):
    energy, q, edges = case_of(name)
    check(energy, q, edges)
    if name not in ("gravity", "contact", "fold limit"):
        exact = energy.hessian(q)
        assert np.linalg.eigvalsh(exact).min() < -1e-6 * np.abs(exact).max()  # or it tests little


def test_the_rim_turns_smoothly_from_top_to_side():
    """Where cloth touches: normals of close points are close, depths those of the sharp solid."""
    rng, cylinder = np.random.default_rng(0), Cylinder(0.05)
    angle = rng.uniform(0, 2 * np.pi, 20_000)
    radius, z = np.array([[0.05], [0.0]]) + rng.uniform(-2e-3, 2e-4, (2, 20_000))
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)
    depths = cylinder.depths(points)
    sharp = np.minimum(0.05 - radius, -z)
    assert (depths <= sharp + 1e-12).all()
    away = np.maximum(0.05 - radius, -z) > cylinder.rim
    assert np.allclose(depths[away], sharp[away], atol=1e-15)
    pressed = np.abs(depths) < 0.8 * cylinder.rim
    nudge = rng.normal(0, 1e-6, points.shape)
    turned = np.linalg.norm(cylinder.normals(points + nudge) - cylinder.normals(points), axis=1)
    assert turned[pressed].max() < 0.05
    moved_by = np.linalg.norm(nudge, axis=1)
    assert (np.abs(cylinder.depths(points + nudge) - depths) <= moved_by + 1e-15).all()


@pytest.mark.parametrize("name", ["membrane", "orthotropic membrane", "hinges"])
def test_the_convex_hessian_of_flat_and_of_taut_cloth_is_exact(name):
    mesh, active, _ = crumpled_strip()
    energy, stretch = LAWS[name](mesh, active), 1.0 if name == "hinges" else 1.03
    q = np.column_stack([stretch * mesh.rest, np.zeros(len(mesh.rest))]).ravel()
    exact, convex = energy.hessian(q), energy.hessian(q, convex=True)
    assert np.allclose(exact, convex, rtol=0, atol=1e-12 * np.abs(convex).max())


@pytest.mark.parametrize("name", [
    "membrane", "orthotropic membrane", "midedge softening", "midedge stiffening", "hysteresis",
    "hinges"])
def test_rigid_motions_cost_nothing(name):
    energy, q, _ = case_of(name)
    mesh, _, _ = crumpled_strip()
    rotation, _ = np.linalg.qr(np.random.default_rng(4).standard_normal((3, 3)))
    rotation *= np.sign(np.linalg.det(rotation))
    state = State.of(q, len(mesh.rest))
    turned = State(state.positions @ rotation.T + [1, 2, 3], state.normals @ rotation.T).q
    assert energy.value(turned) == pytest.approx(energy.value(q), rel=1e-10)
    if "membrane" in name:
        flat = np.column_stack([mesh.rest, np.zeros(len(mesh.rest))]) @ rotation.T
        assert abs(energy.value(flat.ravel())) < 1e-18
        assert np.abs(energy.gradient(flat.ravel())).max() < 1e-12


@pytest.mark.parametrize("name", ["midedge softening", "hinges"])
def test_face_and_back_agree(name):
    energy, q, _ = case_of(name)
    mesh, _, _ = crumpled_strip()
    state = State.of(q, len(mesh.rest))
    mirrored = State(state.positions * [1, 1, -1], state.normals * [-1, -1, 1]).q
    assert energy.value(mirrored) == pytest.approx(energy.value(q), rel=1e-12)


@pytest.mark.parametrize("angle", [0.0, 22.5, 45.0, 90.0])
def test_a_cylinder_has_its_curvature_in_every_triangle(angle):
    """Constant curvature is reproduced exactly by the element: bend by 1/R along any direction."""
    radius = 0.5
    mesh = make_specimen(Rig(), edge=0.01, topology=3).mesh
    bending = MidEdgeBending(mesh, np.ones(len(mesh.faces), dtype=bool), fabric=ANISOTROPIC)
    direction = np.array([np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))])
    along = np.array([-direction[1], direction[0]])
    s, t = mesh.rest @ direction, mesh.rest @ along
    plane = np.outer(radius * np.sin(s / radius), direction) + np.outer(t, along)
    positions = np.column_stack([plane, radius * (np.cos(s / radius) - 1)])
    middle = mesh.rest[mesh.edges].mean(axis=1) @ direction / radius
    normals = np.column_stack([np.outer(np.sin(middle), direction), np.cos(middle)])
    chord = np.diff(positions[mesh.edges], axis=1)[:, 0]
    chord /= np.linalg.norm(chord, axis=1, keepdims=True)
    normals -= np.einsum("ei,ei->e", normals, chord)[:, None] * chord
    q = State(positions, normals / np.linalg.norm(normals, axis=1, keepdims=True)).q
    expected = np.array([direction[0] ** 2, direction[1] ** 2, direction[0] * direction[1]])
    # Positive: bent down, as the cylinder falls off to both sides.
    assert np.allclose(bending.curvatures(q), expected / radius, atol=0.01 / radius)


def test_a_plate_law_of_the_users_overrides_the_response_alone():
    class Doubled(MidEdgeBending):
        def response(self, *arguments):
            return tuple(2.0 * part for part in super().response(*arguments))

        @property
        def form(self):
            return 2.0 * super().form

    mesh, active, q = crumpled_strip(seed=2)
    linear = Fabric(ANISOTROPIC.alpha)
    twice = Fabric(2 * ANISOTROPIC.alpha)
    one, other = (law(mesh, active, fabric=fabric)
                  for law, fabric in ((Doubled, linear), (MidEdgeBending, twice)))
    assert not is_bent(one.angles(q), one.pole).any()
    assert one.value(q) == pytest.approx(other.value(q), rel=1e-12)
    assert np.allclose(one.gradient(q), other.gradient(q), rtol=1e-9, atol=1e-15)
    for convex in (False, True):
        assert np.allclose(one.hessian(q, convex), other.hessian(q, convex), rtol=1e-9, atol=1e-12)


class Quartic(Energy):
    """k z⁴ of every vertex, J, with factors on its derivatives."""

    def __init__(self, mesh, active, *, fabric, slope=1.0, bend=1.0, convexity=1.0):
        self.dofs = 3 * np.arange(len(mesh.rest))[:, None] + 2
        self.slope, self.bend, self.convexity = slope, bend, convexity

    def value(self, q):
        return 1e3 * float((q[self.dofs] ** 4).sum())

    def gradient(self, q):
        return self.slope * 4e3 * q[self.dofs] ** 3

    def hessian(self, q, convex=False):
        return (self.convexity if convex else self.bend) * 12e3 * q[self.dofs][:, :, None] ** 2


class Aimless(Quartic):
    def __init__(self, mesh, active, *, fabric):
        pass


def test_right_derivatives_pass():
    check(Quartic(MESH, ACTIVE, fabric=FABRIC), BENT, MESH.edges)


@pytest.mark.parametrize(("factors", "complaint"), [
    ({"slope": -1.0}, "Quartic.gradient is not the derivative of the value"),
    ({"slope": 1.001}, "Quartic.gradient is not"), ({"bend": -1.0}, "Quartic.hessian is not"),
    ({"convexity": -1.0}, "negative eigenvalue"),
])
def test_wrong_derivatives_are_named(factors, complaint):
    with pytest.raises(InputError, match=complaint):
        check(Quartic(MESH, ACTIVE, fabric=FABRIC, **factors), BENT, MESH.edges)


def test_a_gradient_of_another_shape_is_named():
    class Short(Quartic):
        def gradient(self, q):
            return super().gradient(q)[:-1]

    with pytest.raises(InputError, match=r"Short.gradient has the shape \(\d+, 1\)"):
        check(Short(MESH, ACTIVE, fabric=FABRIC), BENT, MESH.edges)


def test_an_energy_without_dofs_is_named_by_a_drape_and_by_the_check():
    for failing in (lambda: drape(FABRIC, edge=0.02, laws=Laws(others=(Aimless,))),
                    lambda: check(Aimless(MESH, ACTIVE, fabric=FABRIC), BENT, MESH.edges)):
        with pytest.raises(InputError, match=r"Aimless\.dofs must be an array"):
            failing()


def test_a_drape_that_fails_by_a_wrong_derivative_points_to_the_check():
    law = partial(Quartic, slope=-1.0)
    result = drape(FABRIC, edge=0.02, laws=Laws(others=(law,)),
                   options=NewtonOptions(max_iterations=10))
    assert not result.converged and "sim.energies.base" in result.message


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


def test_warp_and_weft_are_not_swapped_in_a_drape():
    """Cloth whose warp is soft in plane is strained along warp, on the rest axis of the mesh."""
    fabric = Fabric(np.full(3, 100e-6))
    for warp, weft in ((30.0, 400.0), (400.0, 30.0)):
        membrane = OrthotropicStVK(warp, weft, 0.0, 50.0)
        result = drape(fabric, edge=8e-3, seed=1, start="sine",
                       laws=Laws(membrane=membrane))
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


def test_stiffness_scales():
    mesh, active, q = crumpled_strip()
    for membrane in MEMBRANES:
        once, thrice = membrane.energy(mesh, active), membrane.scaled(3.0).energy(mesh, active)
        assert thrice.value(q) == pytest.approx(3 * once.value(q), rel=1e-9)


@pytest.mark.parametrize(("make", "word"), [
    (lambda: Corotational(-1.0), "stiffness"),
    (lambda: Corotational(200.0, 1.0), "poisson"),
    (lambda: OrthotropicStVK(shear=0.0), "shear"),
    (lambda: OrthotropicStVK(warp=100.0, weft=400.0, poisson=0.5), "poisson"),
])
def test_impossible_parameters_are_refused(make, word):
    with pytest.raises(InputError, match=word):
        make()
