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
from sim.energies.uneven import Crease, Uneven
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
UNEVEN = Uneven(20.0, 0.01, 1, 30.0, 4e-3, (Crease(50.0, 0.3, 5e-3),))
HYSTERESIS = {"uneven and skewed": Hysteresis(0.2, uneven=UNEVEN, skew=0.6),
              "hysteresis": Hysteresis(0.3), "friction added to curled cloth": Hysteresis(
    (0.2, 0.3, 0.25), added=True, curvature=(3.0, -2.0, 0.0))}

MESH, ACTIVE, BENT = crumpled_strip(amplitude=1e-4, turn=0.1)
FABRIC = Fabric([60e-6, 30e-6, 40e-6], [-90e-9, -40e-9, -60e-9])


def case_of(name: str):
    """An energy, a state, and the edges whose normals are among its unknowns."""
    folded = {"amplitude": 8e-3, "turn": 0.0} if name == "fold limit" else {}
    mesh, active, q = crumpled_strip(**folded)
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


@pytest.mark.parametrize("name", [*LAWS, *HYSTERESIS, "contact", "rim"])
def test_derivatives_are_right_and_the_convex_hessian_is_semi_definite(name):
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
def test_rigid_motions_cost_nothing_and_face_and_back_agree(name):
    energy, q, _ = case_of(name)
    mesh, _, _ = crumpled_strip()
    rotation, _ = np.linalg.qr(np.random.default_rng(4).standard_normal((3, 3)))
    rotation *= np.sign(np.linalg.det(rotation))
    state = State.of(q, len(mesh.rest))
    turned = State(state.positions @ rotation.T + [1, 2, 3], state.normals @ rotation.T).q
    assert energy.value(turned) == pytest.approx(energy.value(q), rel=1e-10)
    if name in ("midedge softening", "hinges"):  # which have no natural curvature
        mirrored = State(state.positions * [1, 1, -1], state.normals * [-1, -1, 1]).q
        assert energy.value(mirrored) == pytest.approx(energy.value(q), rel=1e-12)
    if "membrane" in name:
        flat = np.column_stack([mesh.rest, np.zeros(len(mesh.rest))]) @ rotation.T
        assert abs(energy.value(flat.ravel())) < 1e-18
        assert np.abs(energy.gradient(flat.ravel())).max() < 1e-12


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


@pytest.mark.parametrize(("factors", "complaint"), [
    ({"slope": -1.0}, "Quartic.gradient is not the derivative of the value"),
    ({"slope": 1.001}, "Quartic.gradient is not"), ({"bend": -1.0}, "Quartic.hessian is not"),
    ({"convexity": -1.0}, "negative eigenvalue"),
])
def test_wrong_derivatives_are_named_and_right_ones_pass(factors, complaint):
    check(Quartic(MESH, ACTIVE, fabric=FABRIC), BENT, MESH.edges)
    with pytest.raises(InputError, match=complaint):
        check(Quartic(MESH, ACTIVE, fabric=FABRIC, **factors), BENT, MESH.edges)


class Short(Quartic):
    def gradient(self, q):
        return super().gradient(q)[:-1]


@pytest.mark.parametrize(("energy", "complaint"), [
    (Short, r"Short.gradient has the shape \(\d+, 1\)"),
    (Aimless, r"Aimless\.dofs must be an array")])
def test_an_energy_of_another_form_is_named_by_the_check_and_by_a_drape(energy, complaint):
    with pytest.raises(InputError, match=complaint):
        check(energy(MESH, ACTIVE, fabric=FABRIC), BENT, MESH.edges)
    if energy is Aimless:
        with pytest.raises(InputError, match=complaint):
            drape(FABRIC, edge=0.02, laws=Laws(others=(energy,)))


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


def test_simple_shear_has_the_shear_modulus_and_stiffness_scales():
    gamma = 0.01
    normal = gamma**2 / 2  # E_vv of simple shear
    weft = 90 / (1 - 0.36 * 90 / 400)
    expected = 0.5 * 30 * gamma**2 + 0.5 * weft * normal**2
    assert stretched(ORTHOTROPIC, 1.0, 1.0, gamma) == pytest.approx(expected, rel=1e-10)
    for membrane in (Corotational(), ORTHOTROPIC):
        once, thrice = (stretched(law, 1.1, 0.9, gamma) for law in (membrane, membrane.scaled(3.0)))
        assert thrice == pytest.approx(3 * once, rel=1e-9)


def test_small_strains_do_not_tell_isotropic_stvk_from_corotational():
    laws = Corotational(200.0, 0.3), OrthotropicStVK()
    for stretches in ((1.001, 1.0), (0.9995, 1.001), (1.0, 1.001)):
        one, other = (stretched(law, *stretches) for law in laws)
        assert one == pytest.approx(other, rel=3e-3)
