"""Cloth that meets itself: found exactly, kept apart, and left alone where it does not."""

import numpy as np
import pytest

from sim.energies.base import check
from sim.energies.self_contact import (
    SelfContact,
    contact_distance,
    self_intersections,
)
from sim.equilibrium import find_equilibrium, untangled
from sim.material import Fabric
from sim.mesh import Mesh, strip
from sim.rig import Rig
from sim.scene import Scene, make_specimen
from sim.solver.newton import NewtonOptions, Status
from sim.solver.state import State

SOFT = Fabric(np.full(3, 4e-6))
OPTIONS = NewtonOptions(residual=1e-4, step=1e-4)
WEIGHT = SOFT.density * 9.81  # N/m²


def sheet(size: float = 0.08, edge: float = 0.01, seed: int = 0, jitter: float = 0.15) -> Mesh:
    mesh, _ = strip(length=size, width=size, edge=edge, clamp=0.0, diagonals="random",
                    jitter=jitter, seed=seed)
    return mesh


def flat(mesh: Mesh, height: float = 0.0) -> np.ndarray:
    return np.column_stack([mesh.rest, np.full(len(mesh.rest), height)])


def two_sheets(gap: float, turn: float = 0.0) -> tuple[Mesh, np.ndarray]:
    """One mesh of two equal sheets, the second ``gap`` above the first and turned in its plane."""
    mesh = sheet()
    centre = mesh.rest.mean(axis=0)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    upper = (mesh.rest - centre) @ rotation.T + centre
    rest = np.concatenate([mesh.rest, mesh.rest + np.array([1.0, 0.0])])
    both = Mesh(rest=rest, faces=np.concatenate([mesh.faces, mesh.faces + len(mesh.rest)]))
    heights = np.repeat([0.0, gap], len(mesh.rest))
    return both, np.column_stack([np.concatenate([mesh.rest, upper]), heights])


def folded(mesh: Mesh, radius: float, at: float = 0.04, turn: float = np.pi) -> np.ndarray:
    """Positions of ``mesh`` bent by ``turn`` from x = at on, over itself, around a cylinder."""
    x, y = mesh.rest.T
    angle = np.clip((x - at) / radius, 0.0, turn)
    straight = np.maximum(x - at - turn * radius, 0.0)
    across = np.minimum(x, at) + radius * np.sin(angle) + straight * np.cos(turn)
    up = radius * (1 - np.cos(angle)) + straight * np.sin(turn)
    return np.column_stack([across, y, up])


# Detection


def test_flat_and_closely_folded_sheets_do_not_intersect():
    mesh, fine = sheet(), sheet(edge=0.002, jitter=0.0)
    both, positions = two_sheets(gap=1e-9, turn=0.3)
    for shape, faces in ((flat(mesh), mesh.faces), (folded(fine, radius=2e-3), fine.faces),
                         (positions, both.faces)):
        assert len(self_intersections(shape, faces)) == 0


@pytest.fixture
def tangled() -> tuple[np.ndarray, Mesh]:
    """A sheet folded through itself, and its mesh."""
    mesh = sheet(edge=0.005, jitter=0.0)
    return folded(mesh, radius=5e-3, turn=1.2 * np.pi), mesh


def test_a_sheet_folded_through_itself_is_found_where_it_crosses(tangled):
    positions, mesh = tangled
    crossing = self_intersections(positions, mesh.faces)
    middle = positions[mesh.faces[crossing[:, 2]]].mean(axis=1)
    assert len(crossing) >= 8  # the line of the crossing is 16 edges long
    assert np.abs(middle[:, 2]).max() < 5e-3  # where the turned part meets the flat one


def test_a_triangle_through_another_has_two_edges_through_it():
    positions = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0],
                          [0.2, 0.2, -1], [0.3, 0.2, -1], [0.2, 0.25, 1.0]])
    faces = np.array([[0, 1, 2], [3, 4, 5]])
    assert self_intersections(positions, faces).tolist() == [[3, 5, 0], [4, 5, 0]]
    lifted = positions + np.repeat([[0, 0, 0], [0, 0, 1.0 + 1e-12]], 3, axis=0)
    assert len(self_intersections(lifted, faces)) == 0
    lifted[3:, 2] -= 2e-12
    assert len(self_intersections(lifted, faces)) == 2


def test_count_does_not_depend_on_the_frame():
    both, positions = two_sheets(gap=0.0, turn=0.3)  # edges in one plane would touch
    positions[len(positions) // 2 :, 2] = 0.3 * (positions[len(positions) // 2 :, 0] - 0.0417)
    rotation, _ = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))
    count = len(self_intersections(positions, both.faces))
    assert count > 8
    assert len(self_intersections(positions @ rotation + [1, 2, 3], both.faces)) == count


# The energy


def touching(gap: float = 0.5e-3, reach: float = 3e-3) -> tuple[SelfContact, np.ndarray, Mesh]:
    """Two wavy sheets in contact at many places, d̂ = 1 mm, their state and mesh."""
    both, positions = two_sheets(gap, turn=0.3)
    positions[:, 2] += np.random.default_rng(1).normal(0, 0.1 * gap, len(positions))
    contact = SelfContact(both, positions, distance=1e-3, pressure=20 * WEIGHT, reach=reach)
    return contact, State.at(both, positions).q, both


COORDINATES = 6 * len(sheet().rest)  # of two sheets


def summed(energy: SelfContact, parts: np.ndarray) -> np.ndarray:
    """Gradients (N, K) or Hessians (N, K, K) of the pairs, summed over the unknowns."""
    order, last = parts.ndim - 1, energy.dofs
    total = np.zeros((COORDINATES + 1,) * order)
    np.add.at(total, (last,) if order == 1 else (last[:, :, None], last[:, None, :]), parts)
    return total[(slice(-1),) * order]


def test_derivatives_and_the_convex_hessian_with_pairs_outside_the_pattern_too():
    full, q, mesh = touching()
    poor, _, _ = touching(reach=1e-6)
    exact = summed(full, full.hessian(q))
    assert np.linalg.eigvalsh(exact).min() < -1e-3 * np.abs(exact).max()
    check(full, q, mesh.edges)
    assert len(poor.dofs) < len(full.dofs)
    assert full.is_complete(q) and not poor.is_complete(q)
    slopes = [summed(energy, energy.gradient(q)) for energy in (full, poor)]
    assert np.array_equal(*slopes) and np.abs(slopes[0]).max() > 1e-4 * WEIGHT  # does touch
    above, convex = (summed(energy, energy.hessian(q, True)) for energy in (full, poor))
    for matrix in (convex, convex - above):
        assert np.linalg.eigvalsh(matrix).min() > -1e-12 * np.abs(convex).max()


@pytest.mark.parametrize("turn", [0.0, 0.3])
def test_sheets_half_the_distance_apart_press_as_asked(turn):
    pressure = 20 * WEIGHT
    both, positions = two_sheets(gap=0.5e-3, turn=turn)
    energy = SelfContact(both, positions, distance=1e-3, pressure=pressure, reach=3e-3)
    q = np.concatenate([positions.ravel(), np.zeros(len(both.edges))])
    force = -summed(energy, energy.gradient(q))[: positions.size].reshape(-1, 3)
    assert np.abs(force.sum(axis=0)).max() < 1e-12 * np.abs(force).sum()  # action and reaction
    upper = np.arange(len(positions)) >= len(positions) // 2
    inner = upper & (np.abs(positions[:, :2] - 0.04).max(axis=1) < 0.028)
    found = force[inner, 2].sum() / both.vertex_areas[inner].sum()
    assert found == pytest.approx(pressure, rel=0.25)


def test_there_is_no_force_beyond_the_distance_nor_within_a_flat_specimen():
    energy, q, _ = touching(gap=1.6e-3)
    assert energy.value(q) == 0.0
    assert not energy.gradient(q).any() and not energy.hessian(q, True).any()
    for edge in (16e-3, 3e-3):
        mesh = make_specimen(Rig(), edge=edge, topology=1).mesh
        distance = contact_distance(mesh)
        contact = SelfContact(mesh, flat(mesh), distance=distance, pressure=1.0, reach=distance)
        assert contact.value(flat(mesh).ravel()) == 0.0


def test_steps_through_the_cloth_are_refused():
    both, positions = two_sheets(gap=0.5e-3, turn=0.3)
    energy = SelfContact(both, positions, distance=1e-3, pressure=1.0, reach=1e-3)
    fall = np.zeros_like(positions)
    fall[len(positions) // 2 :, 2] = -0.5e-3
    q, fall = positions.ravel(), fall.ravel()
    assert energy.allows(q, q + 0.7 * fall)
    assert not energy.allows(q, q + 0.9 * fall)  # less than a fifth of the way is left
    assert not energy.allows(q, q + 3.0 * fall)  # free of intersections again, but beyond
    assert len(self_intersections((q + 3.0 * fall).reshape(-1, 3), both.faces)) == 0


# Equilibria


def test_cloth_rests_on_cloth():
    """A slack sheet between two held ends, 5 mm above a held one on which it comes to lie."""
    mesh, positions = two_sheets(gap=5e-3)
    upper = np.arange(len(positions)) >= len(positions) // 2
    x = positions[:, 0] / 0.08
    held = ~upper | (x == 0) | (x == 1)
    positions[upper, 0] *= 0.94
    positions[upper, 2] += 12e-3 * np.sin(np.pi * x[upper])
    contact = SelfContact(mesh, positions, distance=1e-3, pressure=20 * WEIGHT, reach=0.02)
    assert not contact.value(positions.ravel())
    scene = Scene(mesh=mesh, held=held)
    start = scene.state(positions)
    found = find_equilibrium(scene, SOFT, start, extra=[contact], options=OPTIONS)
    state = found.state
    assert found.converged, found.message
    assert found.outcome.positive_definite and found.outcome.residual < OPTIONS.residual
    assert contact.is_complete(state.positions.ravel())
    assert len(self_intersections(state.positions, mesh.faces)) == 0
    lying = upper & (state.positions[:, 2] < 1e-3)
    assert lying.sum() >= 9  # at least a row
    # Carried well within the distance, by a pressure a few times its own weight per area.
    assert 0.3e-3 < state.positions[lying, 2].min() < 0.95e-3


def test_a_sheet_that_has_fallen_through_itself_is_brought_out():
    """A strip held flat over 60 mm whose free 60 mm are folded back above the held part."""
    mesh, held = strip(length=0.06, width=0.03, edge=5e-3, clamp=0.06, diagonals="random",
                       jitter=0.1, seed=1)
    scene = Scene(mesh=mesh, held=held)
    start = scene.state(folded(mesh, radius=8e-3, at=0.0))
    through = find_equilibrium(scene, SOFT, start, options=OPTIONS)
    assert through.converged
    assert len(self_intersections(through.state.positions, mesh.faces)) > 0  # the case is one
    first, second = (find_equilibrium(scene, SOFT, start, options=OPTIONS, self_contact=True)
                     for _ in range(2))
    assert first.converged and first.touches, first.message
    assert first.outcome.positive_definite and first.outcome.residual < OPTIONS.residual
    assert first.outcome.iterations > through.outcome.iterations
    assert len(self_intersections(first.state.positions, mesh.faces)) == 0
    assert first.state.q.tobytes() == second.state.q.tobytes()
    # Found again from where it touches itself, it stays there.
    again = find_equilibrium(scene, SOFT, first.state, options=OPTIONS, self_contact=True,
                             touching=True)
    assert again.converged and again.touches and again.outcome.iterations < 10
    assert np.abs(again.state.positions - first.state.positions).max() < 1e-5
    # The steps of a search with contact that fails are counted with those of the next one.
    failed = find_equilibrium(scene, SOFT, start, options=NewtonOptions(max_iterations=2),
                              self_contact=True, touching=True)
    assert not failed.converged and failed.outcome.iterations == 4


def test_self_contact_changes_nothing_without_intersections():
    specimen = make_specimen(Rig(), edge=0.016, topology=2)
    mesh, held = specimen.mesh, specimen.held
    scene = Scene(mesh=mesh, held=held)
    start = scene.state(flat(mesh) * [1, 1, 0] + 1e-3 * np.sin(40 * flat(mesh)[:, :1]) *
                        [0, 0, 1] * ~held[:, None])
    fabric = Fabric(np.full(3, 60e-6))
    plain, free = (find_equilibrium(scene, fabric, start, options=OPTIONS, self_contact=c)
                   for c in (False, True))
    assert plain.converged and not free.touches
    assert free.state.q.tobytes() == plain.state.q.tobytes()
    assert free.outcome.iterations == plain.outcome.iterations


def test_untangling_moves_little_and_only_free_vertices(tangled):
    start, mesh = tangled
    held = mesh.rest[:, 0] < 0.03
    positions = untangled(mesh, held, start)
    assert len(self_intersections(positions, mesh.faces)) == 0
    moved = np.linalg.norm(positions - start, axis=1)
    assert not moved[held].any() and moved.max() < 0.015
    assert untangled(mesh, np.ones(len(held), dtype=bool), start) is None


def test_cloth_that_cannot_be_untangled_fails_with_the_reason():
    """Two held sheets that cross, and one free vertex to move."""
    mesh, positions = two_sheets(gap=0.0)
    half = len(positions) // 2
    positions[half:, 2] = positions[half:, 0] - 0.0417
    held = np.ones(len(positions), dtype=bool)
    held[0] = False
    scene = Scene(mesh=mesh, held=held)
    found = find_equilibrium(scene, SOFT, scene.state(positions), options=OPTIONS,
                             self_contact=True)
    assert found.status is Status.SELF_CONTACT
    count = len(self_intersections(found.state.positions, mesh.faces))
    assert f"in {count} places" in found.message
