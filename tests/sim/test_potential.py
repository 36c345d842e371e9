"""The total energy: stages of convexity, and what is kept between calls."""

import numpy as np
import pytest

from sim.equilibrium import build_potential
from sim.material import Fabric
from sim.mesh import draped_square
from sim.scene import Rig, Scene, State


@pytest.fixture
def crumpled():
    mesh, held, _ = draped_square(size=0.3, plate_radius=0.05, resolution=12)
    rng = np.random.default_rng(0)
    positions = np.column_stack([mesh.rest, np.zeros(len(mesh.rest))])
    positions += rng.normal(0, 4e-3, positions.shape) * ~held[:, None]
    scene = Scene(mesh=mesh, held=held, obstacles=Rig().obstacles)
    state = State(positions, rng.normal(0, 0.2, len(mesh.edges)))
    potential = build_potential(scene, Fabric(np.full(3, 2e-5)), state)
    q = state.unknowns
    return potential, potential.free_part(q), rng


def smallest_eigenvalue(potential, y, convexity):
    data = potential.hessian(y, convexity)
    scale = 1 / np.sqrt(potential.regularisation)
    matrix = potential.pattern.symmetric(data).toarray() * scale * scale[:, None]
    return np.linalg.eigvalsh(matrix)[0]


def test_hessian_does_not_depend_on_what_was_asked_before(crumpled):
    potential, y, rng = crumpled
    other = y + rng.normal(0, 1e-3, len(y)) * potential.length_scale
    fresh = {c: potential.hessian(y, c).copy() for c in (0.0, 0.3, 0.5, 0.8, 1.0)}
    for convexity in (0.8, 1.0, 0.3, 0.0, 0.5):
        potential.hessian(other, convexity)
        assert np.array_equal(potential.hessian(y, convexity), fresh[convexity])


def test_the_membrane_becomes_convex_before_the_rest(crumpled):
    potential, y, _ = crumpled
    exact, half, full = (potential.hessian(y, c) for c in (0.0, 0.5, 1.0))
    blocks = [energy.hessian(potential.full(y), float(k == 0))
              for k, energy in enumerate(potential.energies)]
    assert np.allclose(half, potential.pattern.assemble(blocks), rtol=1e-12, atol=1e-12)
    assert np.allclose(potential.hessian(y, 0.25), (exact + half) / 2, rtol=1e-12, atol=1e-12)
    assert np.allclose(potential.hessian(y, 0.75), (half + full) / 2, rtol=1e-12, atol=1e-12)
    eigenvalues = [smallest_eigenvalue(potential, y, c) for c in (0.0, 0.5, 1.0)]
    assert eigenvalues[0] < eigenvalues[1] < 0 or eigenvalues[0] < 0 <= eigenvalues[1]
    assert eigenvalues[2] > -1e-9
