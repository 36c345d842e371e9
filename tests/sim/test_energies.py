"""Every energy against finite differences, and against formulas written down independently."""

import numpy as np
import pytest

from sim.energies.bending_friction import Rubbing
from sim.energies.contact import Cylinder, ObstacleContact
from sim.energies.fold_limit import LIMIT_START, FoldLimit
from sim.energies.gravity import Gravity
from sim.energies.membrane import CorotationalMembrane
from sim.energies.midedge import MidEdgeBending
from sim.material import Fabric
from sim.mesh import strip
from sim.mesh.specimens import make_specimen
from sim.scene import Rig

ANISOTROPIC = Fabric(alpha=[98.8e-6, 23.5e-6, 21.2e-6], beta=[-247e-9, -58.8e-9, -53e-9])
STIFFENING = Fabric(alpha=[20e-6, 30e-6, 10e-6], beta=[40e-9, 10e-9, 5e-9])


def crumpled_strip(seed: int = 0, amplitude: float = 1e-3):
    """A small strip, its active faces, and unknowns around a strongly bent shape."""
    rng = np.random.default_rng(seed)
    mesh, held = strip(length=0.04, width=0.03, edge=0.01, clamp=0.01, diagonals="random",
                       jitter=0.2, seed=seed)
    active = ~held[mesh.faces].all(axis=1)
    x, y = mesh.rest.T
    shape = np.column_stack([x, y, -8 * x**2 + 5 * x * y])
    positions = shape + rng.normal(0, amplitude, shape.shape)
    rotations = rng.normal(0, 0.2, len(mesh.edges))
    return mesh, active, np.concatenate([positions.ravel(), rotations])


def energy_and_state(name: str):
    mesh, active, q = crumpled_strip()
    if name == "gravity":
        return Gravity(mesh, density=0.3, gravity=9.81), q
    if name == "membrane":
        return CorotationalMembrane(mesh, active, stiffness=200.0), q
    if name == "midedge softening":
        return MidEdgeBending(mesh, active, fabric=ANISOTROPIC), q
    if name == "midedge stiffening":
        return MidEdgeBending(mesh, active, fabric=STIFFENING), q
    if name == "friction":
        plain = MidEdgeBending(mesh, active, fabric=STIFFENING)
        origin = plain.curvatures(crumpled_strip(seed=1)[2])
        return Rubbing(3e-4, origin, build_up=20.0)(mesh, active, fabric=STIFFENING), q
    if name == "contact":
        rng = np.random.default_rng(1)
        points = rng.uniform(-0.045, 0.045, (40, 3)) - [0, 0, 0.05]
        contact = ObstacleContact(np.arange(40).reshape(20, 2), np.full(20, 1e-5),
                                  obstacle=Cylinder(0.05), pressure=60.0)
        return contact, points.ravel()
    mesh, active, q = crumpled_strip(amplitude=8e-3)
    energy = FoldLimit(mesh, active, stiffness=2e-5)
    assert np.abs(energy.angles(q)).max() > LIMIT_START + 0.1  # or the test would test nothing
    return energy, q


ENERGIES = ["gravity", "membrane", "midedge softening", "midedge stiffening", "friction",
            "contact", "fold limit"]


def scattered(energy, blocks: np.ndarray, size: int) -> np.ndarray:
    """Element gradients (N, K) summed into (size,)."""
    total = np.zeros(size + 1)
    np.add.at(total, energy.dofs, blocks)  # dof -1 collects in the last entry
    return total[:-1]


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
    energy, q = energy_and_state(name)
    direction = np.random.default_rng(2).standard_normal(len(q))
    exact = scattered(energy, energy.gradient(q), len(q)) @ direction
    errors = [
        abs((energy.value(q + h * direction) - energy.value(q - h * direction)) / (2 * h) - exact)
        for h in STEPS
    ]
    size = np.abs(scattered(energy, energy.gradient(q), len(q))) @ np.abs(direction)
    assert_error_falls_with_square(errors, size)


@pytest.mark.parametrize("name", ENERGIES)
def test_every_hessian_block_is_the_derivative_of_the_gradient(name):
    energy, q = energy_and_state(name)
    blocks = energy.hessian(q, 0.0)
    direction = np.random.default_rng(3).standard_normal(len(q))
    local = np.where(energy.dofs >= 0, direction[energy.dofs], 0.0)
    exact = np.einsum("nij,nj->ni", blocks, local)
    errors = [
        np.abs(
            (energy.gradient(q + h * direction) - energy.gradient(q - h * direction)) / (2 * h)
            - exact
        ).max()
        for h in STEPS
    ]
    if name == "gravity":
        assert np.all(blocks == 0)
    else:
        assert_error_falls_with_square(errors, np.abs(exact).max())
    assert np.allclose(blocks, np.swapaxes(blocks, 1, 2), atol=1e-12 * np.abs(blocks).max())


@pytest.mark.parametrize("name", ENERGIES)
def test_convexity_removes_the_indefinite_part_linearly(name):
    energy, q = energy_and_state(name)
    exact, middle, convex = (energy.hessian(q, c) for c in (0.0, 0.3, 1.0))
    size = np.abs(convex).max() + 1e-300
    assert np.linalg.eigvalsh(convex).min() > -1e-12 * size
    assert np.allclose(middle, 0.7 * exact + 0.3 * convex, atol=1e-12 * size)


@pytest.mark.parametrize(
    "name", ["membrane", "midedge softening", "midedge stiffening", "friction"])
def test_rigid_motions_cost_nothing(name):
    energy, q = energy_and_state(name)
    mesh, _, _ = crumpled_strip()
    vertices = 3 * len(mesh.rest)
    rotation, _ = np.linalg.qr(np.random.default_rng(4).standard_normal((3, 3)))
    rotation *= np.sign(np.linalg.det(rotation))
    moved = q.copy()
    moved[:vertices] = (q[:vertices].reshape(-1, 3) @ rotation.T + [1, 2, 3]).ravel()
    assert energy.value(moved) == pytest.approx(energy.value(q), rel=1e-10)


def test_face_and_back_agree():
    energy, q = energy_and_state("midedge softening")
    mesh, _, _ = crumpled_strip()
    mirrored = q.copy()
    mirrored[2 : 3 * len(mesh.rest) : 3] *= -1
    mirrored[3 * len(mesh.rest) :] *= -1
    assert energy.value(mirrored) == pytest.approx(energy.value(q), rel=1e-12)


def test_membrane_against_the_singular_values():
    mesh, active, q = crumpled_strip()
    membrane = CorotationalMembrane(mesh, active, stiffness=200.0, poisson=0.3)
    mu, lam = 200 / 2.6, 200 * 0.3 / 0.91
    total = 0.0
    for face, area in zip(mesh.faces[active], mesh.areas[active], strict=True):
        rest = mesh.rest[face]
        now = q.reshape(-1)[: 3 * len(mesh.rest)].reshape(-1, 3)[face]
        F = (now[1:] - now[0]).T @ np.linalg.inv((rest[1:] - rest[0]).T)
        s = np.linalg.svd(F, compute_uv=False)
        total += area * (mu * ((s - 1) ** 2).sum() + lam / 2 * (s.sum() - 2) ** 2)
    assert membrane.value(q) == pytest.approx(total, rel=1e-12)


@pytest.mark.parametrize("angle", [0.0, 22.5, 45.0, 90.0])
def test_a_cylinder_has_its_curvature_in_every_triangle(angle):
    """Constant curvature is reproduced exactly by the element: bend by 1/R along any direction."""
    radius = 0.5
    mesh = make_specimen(Rig(), edge=0.02, grading=1, topology=3).mesh
    nothing_held = np.ones(len(mesh.faces), dtype=bool)
    bending = MidEdgeBending(mesh, nothing_held, fabric=ANISOTROPIC)
    direction = np.array([np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))])
    along = np.array([-direction[1], direction[0]])
    s, t = mesh.rest @ direction, mesh.rest @ along
    plane = np.outer(radius * np.sin(s / radius), direction) + np.outer(t, along)
    positions = np.column_stack([plane, radius * (np.cos(s / radius) - 1)])
    q = np.concatenate([positions.ravel(), np.zeros(len(mesh.edges))])
    # Rotations that make the mid-edge normals those of the cylinder
    rotations = _mid_edge_rotations(bending, mesh, positions, radius, direction)
    q[3 * len(mesh.rest) :] = rotations
    expected = np.array([direction[0] ** 2, direction[1] ** 2, direction[0] * direction[1]])
    # Positive: bent down, as the cylinder falls off to both sides.
    assert np.allclose(bending.curvatures(q), expected / radius, atol=0.01 / radius)


def _mid_edge_rotations(bending, mesh, positions, radius, direction):
    """zeta with phi = angle between a face's normal and the cylinder's normal at mid-edge."""
    a, b, c = (positions[mesh.faces[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    middle = mesh.rest[mesh.edges].mean(axis=1) @ direction / radius
    smooth = np.column_stack([np.outer(np.sin(middle), direction), np.cos(middle)])
    first = mesh.edge_faces[:, 0]
    ends = positions[mesh.edges]
    tangent = ends[:, 1] - ends[:, 0]
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    # orient the edge as its first face runs along it
    corner = mesh.faces[first]
    following = np.roll(corner, -1, axis=1)
    forwards = ((corner == mesh.edges[:, :1]) & (following == mesh.edges[:, 1:])).any(axis=1)
    tangent *= np.where(forwards, 1.0, -1.0)[:, None]
    phi = np.einsum("ei,ei->e", np.cross(normals[first], smooth), tangent)
    zeta = phi.copy()
    inner = mesh.edge_faces[:, 1] >= 0
    second = mesh.edge_faces[inner, 1]
    theta = np.einsum("ei,ei->e", np.cross(normals[first[inner]], normals[second]), tangent[inner])
    zeta[inner] = phi[inner] - 0.5 * theta
    return zeta
