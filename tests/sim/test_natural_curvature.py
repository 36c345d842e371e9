"""Cloth with a natural curvature: derivatives, and the arc in which a weightless strip rests."""

import numpy as np
import pytest

from common.errors import InputError
from sim.cloth import Laws
from sim.energies.midedge import MidEdgeBending
from sim.energies.plate_variants import NaturallyCurved
from sim.equilibrium import find_equilibrium
from sim.material import Fabric
from sim.mesh import Mesh, strip
from sim.scene import Scene
from sim.solver.newton import NewtonOptions
from sim.solver.state import State, moved

FABRIC = Fabric(np.array([30e-6, 22e-6, 18e-6]), np.array([-60e-9, -40e-9, -30e-9]))
CURVATURE = (12.0, -7.0, 4.0)


@pytest.fixture
def bent() -> tuple[Mesh, np.ndarray, np.ndarray]:
    mesh, held = strip(length=0.03, width=0.02, edge=0.005, clamp=0.005, jitter=0.2, seed=1)
    rng = np.random.default_rng(0)
    x, y = mesh.rest.T
    positions = np.column_stack([x, y, -20 * x**2 + 8 * x * y]) + rng.normal(0, 2e-4, (len(x), 3))
    turns = np.concatenate([np.zeros(positions.size), rng.normal(0, 0.05, len(mesh.edges))])
    return (mesh, ~held[mesh.faces].all(axis=1),
            moved(State.at(mesh, positions).q, mesh.edges, turns))


def gathered(energy: object, parts: np.ndarray, size: int) -> np.ndarray:
    return np.bincount(energy.dofs.ravel() + 1, parts.ravel(), minlength=size + 1)[1:]


def test_derivatives_match_central_differences(bent: tuple) -> None:
    mesh, active, q = bent
    energy = NaturallyCurved(CURVATURE)(mesh, active, fabric=FABRIC)
    size = 3 * len(mesh.rest) + len(mesh.edges)
    direction = np.random.default_rng(1).standard_normal(size) * 1e-3
    slope = gathered(energy, energy.gradient(q), size) @ direction
    bend = np.einsum("ni,nij,nj->", direction[energy.dofs], energy.hessian(q),
                     direction[energy.dofs])
    values = [energy.value(moved(q, mesh.edges, h * direction)) for h in (-1e-3, 0, 1e-3)]
    assert (values[2] - values[0]) / 2e-3 == pytest.approx(slope, rel=1e-5)
    assert (values[2] - 2 * values[1] + values[0]) / 1e-6 == pytest.approx(bend, rel=1e-5)


def test_the_convex_hessian_is_that_of_the_plain_law(bent: tuple) -> None:
    mesh, active, q = bent
    energy = NaturallyCurved(CURVATURE)(mesh, active, fabric=FABRIC)
    plain = MidEdgeBending(mesh, active, fabric=FABRIC)
    np.testing.assert_array_equal(energy.hessian(q, True), plain.hessian(q, True))


def test_another_fabric_has_its_own_moment(bent: tuple) -> None:
    mesh, active, q = bent
    stiffer = Fabric(2 * FABRIC.alpha, 2 * FABRIC.beta)
    law = NaturallyCurved(CURVATURE)
    changed = law(mesh, active, fabric=FABRIC).with_fabric(stiffer)
    np.testing.assert_array_equal(changed.gradient(q),
                                  law(mesh, active, fabric=stiffer).gradient(q))


def test_weightless_strip_rests_in_an_arc() -> None:
    """Clamped level, it follows a circle of the natural curvature, downwards."""
    mesh, held = strip(length=0.06, width=0.012, edge=0.003, clamp=0.006)
    kappa = 15.0
    scene = Scene(mesh=mesh, held=held, gravity=0.0)
    found = find_equilibrium(
        scene, Fabric(np.full(3, 30e-6)),
        scene.state(np.column_stack([mesh.rest, np.zeros(len(mesh.rest))])),
        laws=Laws(bending=NaturallyCurved((kappa, 0.0, 0.0))),
        options=NewtonOptions(residual=1e-4, step=1e-6))
    assert found.converged
    tip = found.state.positions[np.isclose(mesh.rest[:, 0], 0.06)].mean(axis=0)
    assert tip[0] == pytest.approx(np.sin(kappa * 0.06) / kappa, rel=3e-3)
    assert tip[2] == pytest.approx(-(1 - np.cos(kappa * 0.06)) / kappa, rel=2e-2)


@pytest.mark.parametrize("curvature", [(1.0, 0.0), (np.nan, 0.0, 0.0), 15.0])
def test_a_curvature_has_three_finite_numbers(curvature: object) -> None:
    with pytest.raises(InputError, match="three finite numbers"):
        NaturallyCurved(curvature)
