"""The total energy: frames, patterns, stages of convexity, and what is kept between calls."""

import numpy as np
import pytest

from sim.energies.fold_limit import LIMIT_START, FoldLimit
from sim.energies.midedge import MidEdgeBending
from sim.equilibrium import build_potential
from sim.laws import Laws
from sim.material import Fabric
from sim.mesh.specimens import make_specimen
from sim.scene import Rig, Scene, State


class Twisting:
    """½ k zeta² of every edge that moves: an energy of rotations that knows nothing of frames."""

    def __init__(self, mesh, active, *, fabric):
        self.dofs = 3 * len(mesh.rest) + np.unique(mesh.face_edges[active])[:, None]

    def value(self, q):
        return 5e-6 * float((q[self.dofs] ** 2).sum())

    def gradient(self, q):
        return 1e-5 * q[self.dofs]

    def hessian(self, q, convexity):
        return np.full((len(self.dofs), 1, 1), 1e-5)

    def allows(self, old, new):
        return True


def patch(mesh, active, *, fabric):
    """Bending of half the specimen: next to the other half, clamped edges that nothing holds."""
    return MidEdgeBending(mesh, active & (mesh.rest[mesh.faces].mean(axis=1)[:, 0] > 0.02),
                          fabric=fabric)


class Stiffened(MidEdgeBending):
    """A law that changes the Hessian by the unknowns, and does not know of frames."""

    def hessian(self, q, convexity):
        return 2.0 * super().hessian(q, convexity)


def crumpled_potential(size=4e-3, **laws):
    """A potential, its free unknowns at a crumpled shape, and random numbers."""
    specimen = make_specimen(Rig(), edge=0.03, grading=1)
    mesh, held = specimen.mesh, specimen.held
    rng = np.random.default_rng(0)
    positions = np.column_stack([mesh.rest, np.zeros(len(mesh.rest))])
    positions += rng.normal(0, size, positions.shape) * ~held[:, None]
    scene = Scene(mesh=mesh, held=held, obstacles=Rig().obstacles)
    state = State(positions, rng.normal(0, 0.2, len(mesh.edges)))
    potential = build_potential(scene, Fabric(np.full(3, 2e-5)), state, laws=Laws(**laws))
    return potential, potential.free_part(state.unknowns), rng


@pytest.fixture
def crumpled():
    return crumpled_potential()


def matrix_of(potential, y, convexity):
    pattern, data = potential.hessian(y, convexity)
    return pattern.symmetric(data).toarray()


def by_unknowns(potential, y):
    """The exact Hessian (n, n) by the unknowns themselves, summed from the energies' own."""
    rows = potential.free_part(np.arange(len(potential.full(y))))
    total = np.zeros((len(potential.full(y)) + 1,) * 2)
    for energy in potential.energies:
        blocks = energy.hessian(potential.full(y), 0.0)
        if blocks is not None:
            np.add.at(total, (energy.dofs[:, :, None], energy.dofs[:, None, :]), blocks)
    return total[np.ix_(rows, rows)]


def smallest_eigenvalue(potential, y, convexity):
    scale = 1 / np.sqrt(potential.regularisation)
    matrix = matrix_of(potential, y, convexity) * scale * scale[:, None]
    return np.linalg.eigvalsh(matrix)[0]


@pytest.mark.parametrize("case", ["usual", "folded", "other energy of rotations", "hinges", "patch",
                                  "patch beside", "patch on hinges", "no triangle", "stiffened"])
def test_a_step_in_frames_is_that_of_the_unknowns(case):
    """Newton's step by the Hessian in frames and by the one of the unknowns."""
    laws = {
        "other energy of rotations": {"others": (Twisting,)},
        "hinges": {"bending": "hinge"},
        "patch": {"bending": patch},
        "patch beside": {"others": (patch,)},
        "patch on hinges": {"bending": "hinge", "others": (patch,)},
        "no triangle": {"bending": "hinge", "others": (
            lambda mesh, active, fabric: MidEdgeBending(mesh, active & False, fabric=fabric),)},
        "stiffened": {"bending": Stiffened},
    }
    potential, y, rng = crumpled_potential(12e-3 if case == "folded" else 4e-3,
                                           **laws.get(case, {}))
    limit = next(e for e in potential.energies if isinstance(e, FoldLimit))
    assert (np.abs(limit.angles(potential.full(y))) > LIMIT_START).any() == (case == "folded")
    gradient = rng.standard_normal(len(y)) * potential.regularisation
    inside = np.linalg.solve(matrix_of(potential, y, 0.0), potential.into_frames(y, gradient))
    step = potential.out_of_frames(y, inside)
    expected = np.linalg.solve(by_unknowns(potential, y), gradient)
    scale = potential.length_scale
    assert np.allclose(step / scale, expected / scale, rtol=0,
                       atol=1e-7 * np.abs(expected / scale).max())
    assert np.allclose(inside @ potential.into_frames(y, gradient), step @ gradient, rtol=1e-9)


def test_in_frames_a_hinge_does_not_couple_its_far_corners(crumpled):
    """What the frames are for. A fold that feels its limit couples them, and has a place then."""
    potential, y, _ = crumpled
    bending = next(e for e in potential.energies if isinstance(e, MidEdgeBending))
    first = bending.frames.dofs[:, [6, 9]]  # one coordinate of each far corner
    row = np.full(len(potential.full(y)), -1)
    row[potential.free_part(np.arange(len(row)))] = np.arange(len(y))
    pairs = row[first][(row[first] >= 0).all(axis=1)]
    folded, there, _ = crumpled_potential(12e-3)
    for case, at, expected in ((potential, y, 0.0), (folded, there, 1.0)):
        pattern, data = case.hessian(at, 0.0)
        matrix = pattern.symmetric(np.ones_like(data))
        assert np.mean(matrix[pairs[:, 0], pairs[:, 1]]) == expected


def test_a_far_corner_does_not_move_the_angle_next_to_it(crumpled):
    """By central differences: in frames, phi of a triangle is a matter of its own unknowns."""
    potential, y, rng = crumpled
    bending = next(e for e in potential.energies if isinstance(e, MidEdgeBending))
    row = np.full(len(potential.full(y)), -1)
    row[potential.free_part(np.arange(len(row)))] = np.arange(len(y))
    checked = 0
    for t in rng.permutation(len(bending.dofs))[:20]:
        move = rng.standard_normal(len(y)) * potential.length_scale
        own = row[bending.framed_dofs[t]]
        move[own[own >= 0]] = 0.0
        step = 1e-4 * potential.out_of_frames(y, move)
        ahead, behind = (bending.curvatures(potential.full(y + s * step))[t] for s in (1, -1))
        loose = y + 1e-4 * move, y - 1e-4 * move  # the same move of the unknowns themselves
        other = np.subtract(*(bending.curvatures(potential.full(z))[t] for z in loose))
        if np.abs(other).max() > 0:
            checked += 1
            assert np.abs(ahead - behind).max() < 1e-4 * np.abs(other).max()
    assert checked > 10


def test_hessian_does_not_depend_on_what_was_asked_before(crumpled):
    potential, y, rng = crumpled
    other = y + rng.normal(0, 1e-3, len(y)) * potential.length_scale
    fresh = {c: potential.hessian(y, c)[1].copy() for c in (0.0, 0.3, 0.5, 0.8, 1.0)}
    inside = potential.into_frames(y, y)
    for convexity in (0.8, 1.0, 0.3, 0.0, 0.5):
        potential.hessian(other, convexity)
        assert not np.array_equal(potential.into_frames(other, y), inside)
        assert np.array_equal(potential.hessian(y, convexity)[1], fresh[convexity])
        assert np.array_equal(potential.into_frames(y, y), inside)


def test_the_membrane_becomes_convex_before_the_rest(crumpled):
    potential, y, _ = crumpled
    exact, half, full = (potential.hessian(y, c)[1] for c in (0.0, 0.5, 1.0))
    membrane = potential.energies[0]
    change = np.zeros((len(potential.full(y)),) * 2)
    np.add.at(change, (membrane.dofs[:, :, None], membrane.dofs[:, None, :]),
              membrane.hessian(potential.full(y), 1.0) - membrane.hessian(potential.full(y), 0.0))
    rows = potential.free_part(np.arange(len(change)))
    assert np.allclose(matrix_of(potential, y, 0.5) - matrix_of(potential, y, 0.0),
                       change[np.ix_(rows, rows)], rtol=1e-9, atol=1e-9)
    assert np.allclose(potential.hessian(y, 0.25)[1], (exact + half) / 2, rtol=1e-12, atol=1e-12)
    assert np.allclose(potential.hessian(y, 0.75)[1], (half + full) / 2, rtol=1e-12, atol=1e-12)
    eigenvalues = [smallest_eigenvalue(potential, y, c) for c in (0.0, 0.5, 1.0)]
    assert eigenvalues[0] < eigenvalues[1] < 0 or eigenvalues[0] < 0 <= eigenvalues[1]
    assert eigenvalues[2] > -1e-9
