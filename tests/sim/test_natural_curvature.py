"""Cloth with a natural curvature: derivatives, and the arc in which a weightless strip rests."""

import numpy as np
import pytest

from common.errors import InputError
from sim.energies.midedge import MidEdgeBending
from sim.energies.natural_curvature import NaturallyCurved
from sim.equilibrium import find_equilibrium
from sim.laws import Laws
from sim.material import Fabric
from sim.mesh import Mesh, strip
from sim.newton import NewtonOptions, Status
from sim.scene import Scene, State

FABRIC = Fabric(np.array([30e-6, 22e-6, 18e-6]), np.array([-60e-9, -40e-9, -30e-9]))
CURVATURE = (12.0, -7.0, 4.0)


@pytest.fixture
def bent() -> tuple[Mesh, np.ndarray, np.ndarray]:
    mesh, held = strip(length=0.03, width=0.02, edge=0.005, clamp=0.005, jitter=0.2, seed=1)
    rng = np.random.default_rng(0)
    x, y = mesh.rest.T
    positions = np.column_stack([x, y, -20 * x**2 + 8 * x * y]) + rng.normal(0, 2e-4, (len(x), 3))
    q = np.concatenate([positions.ravel(), rng.normal(0, 0.05, len(mesh.edges))])
    return mesh, ~held[mesh.faces].all(axis=1), q


def gathered(energy: object, parts: np.ndarray, size: int) -> np.ndarray:
    return np.bincount(energy.dofs.ravel() + 1, parts.ravel(), minlength=size + 1)[1:]


def test_derivatives_match_central_differences(bent: tuple) -> None:
    mesh, active, q = bent
    energy = NaturallyCurved(CURVATURE)(mesh, active, fabric=FABRIC)
    direction = np.random.default_rng(1).standard_normal(len(q)) * 1e-3
    slope = gathered(energy, energy.gradient(q), len(q)) @ direction
    local = np.where(energy.dofs >= 0, direction[energy.dofs], 0.0)
    curved = gathered(energy, np.einsum("nij,nj->ni", energy.hessian(q, 0.0), local), len(q))
    h = 1e-4
    ahead, behind = q + h * direction, q - h * direction
    by_value = (energy.value(ahead) - energy.value(behind)) / (2 * h)
    by_gradient = gathered(energy, energy.gradient(ahead) - energy.gradient(behind), len(q))
    assert by_value == pytest.approx(slope, rel=1e-6)
    np.testing.assert_allclose(by_gradient / (2 * h), curved, atol=1e-6 * np.abs(curved).max())


def test_hessian_is_linear_in_convexity_and_ends_at_the_plain_law(bent: tuple) -> None:
    mesh, active, q = bent
    energy = NaturallyCurved(CURVATURE)(mesh, active, fabric=FABRIC)
    exact, convex, between = (energy.hessian(q, c) for c in (0.0, 1.0, 0.3))
    np.testing.assert_allclose(between, 0.7 * exact + 0.3 * convex, atol=1e-9 * exact.max())
    plain = MidEdgeBending(mesh, active, fabric=FABRIC)
    np.testing.assert_array_equal(convex, plain.hessian(q, 1.0))


def test_weightless_strip_rests_in_an_arc() -> None:
    """Clamped level, it follows a circle of the natural curvature, downwards."""
    mesh, held = strip(length=0.06, width=0.012, edge=0.003, clamp=0.006)
    kappa = 15.0
    state, result = find_equilibrium(
        Scene(mesh=mesh, held=held, gravity=1e-5), Fabric(np.full(3, 30e-6)),
        State.at(mesh, np.column_stack([mesh.rest, np.zeros(len(mesh.rest))])),
        laws=Laws(bending=NaturallyCurved((kappa, 0.0, 0.0))),
        options=NewtonOptions(residual=1e2, step=1e-6))
    assert result.status is Status.CONVERGED
    tip = state.positions[np.isclose(mesh.rest[:, 0], 0.06)].mean(axis=0)
    assert tip[0] == pytest.approx(np.sin(kappa * 0.06) / kappa, rel=3e-3)
    assert tip[2] == pytest.approx(-(1 - np.cos(kappa * 0.06)) / kappa, rel=2e-2)


@pytest.mark.parametrize("curvature", [(1.0, 0.0), (np.nan, 0.0, 0.0), 15.0])
def test_a_curvature_has_three_finite_numbers(curvature: object) -> None:
    with pytest.raises(InputError, match="three finite numbers"):
        NaturallyCurved(curvature)
