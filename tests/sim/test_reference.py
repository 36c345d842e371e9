"""The plain PyTorch energies against the fast kernels: values, gradients, invariances."""

import energies_by_autograd as reference
import numpy as np
import pytest
import torch

from sim.cloth import Cloth, Laws
from sim.energies.fold_barrier import is_bent
from sim.energies.membrane import Corotational
from sim.material import Fabric
from sim.rig import DISC_RIG, Rig
from sim.scene import Scene, make_specimen
from sim.solver.state import moved

FABRICS = [Fabric([98.8e-6, 23.5e-6, 21.2e-6], [-247e-9, -58.8e-9, -53e-9]),
           Fabric([20e-6, 30e-6, 10e-6], [40e-9, 10e-9, 5e-9], density=0.2)]


def crumpled(rig: Rig, size: float, turn: float, number: int = 0) -> tuple[Cloth, np.ndarray]:
    """One of two cloths, and a state (3V + 3E,)."""
    rng = np.random.default_rng(number)
    offset = [(0.0, 0.0), (4e-3, -2e-3)][number]
    specimen = make_specimen(rig, edge=0.012, topology=2, offset=offset)
    scene = Scene(mesh=specimen.mesh, held=specimen.held, obstacles=rig.obstacles)
    cloth = Cloth(scene, FABRICS[number], laws=Laws(membrane=Corotational(300.0, 0.2)))
    rest = specimen.mesh.rest
    radius = np.linalg.norm(rest, axis=1)
    inwards = np.minimum(1, (rig.plate_radius - 1e-4) / np.maximum(radius, 1e-9))
    hanging = radius > rig.plate_radius  # some of it against the cylinder's side
    shape = np.column_stack([np.where(hanging, inwards, 1)[:, None] * rest,
                             -np.maximum(radius - rig.plate_radius, 0)])
    shape += rng.normal(0, size, shape.shape) * ~specimen.held[:, None]
    steps = np.concatenate([np.zeros(shape.size), rng.normal(0, turn, len(specimen.mesh.edges))])
    steps[shape.size:] *= ~scene.held_edges
    return cloth, moved(scene.state(shape).q, specimen.mesh.edges, steps)


def split(cloth: Cloth, q: np.ndarray) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Positions, normals and rest points."""
    mesh = cloth.scene.mesh
    x, n = torch.from_numpy(q).view(-1, 3).split([len(mesh.rest), len(mesh.edges)])
    return x, n, torch.from_numpy(mesh.rest)


@pytest.mark.parametrize("number", [0, 1])
@pytest.mark.parametrize("rig", [Rig(), DISC_RIG], ids=lambda rig: rig.name)
@pytest.mark.parametrize("folded", [False, True])
def test_values_and_gradients_are_those_of_the_kernels(rig, folded, number):
    cloth, q = crumpled(rig, *((9e-3, 0.0) if folded else (1e-3, 0.05)), number)
    assert is_bent(cloth.bending.angles(q), cloth.bending.pole).any() == folded
    assert cloth.obstacles[0].value(q) > 0
    model, (x, n, rest) = reference.ReferenceEnergy(cloth), split(cloth, q)
    move = torch.zeros_like(x, requires_grad=True)
    turn = torch.zeros(len(n), dtype=x.dtype, requires_grad=True)
    total = model.energy(x + move, reference.moved(model.edges, x, n, move, turn), rest)
    by_move, by_turn = torch.autograd.grad(total, (move, turn))
    assert float(total.detach()) == pytest.approx(cloth.potential.value(q), rel=1e-13)
    expected = cloth.potential.gradient(q)
    found = cloth.potential.free_unknowns(np.concatenate([by_move.ravel(), by_turn]))
    assert np.abs(found - expected).max() < 1e-12 * np.abs(expected).max()


def test_steps_carry_normals_as_the_simulator_does():
    cloth, q = crumpled(Rig(), 1.5e-3, 0.1)
    edges = cloth.scene.mesh.edges
    x, n, _ = split(cloth, q)
    step = np.random.default_rng(1).normal(0, 2e-3, 3 * len(x) + len(edges))
    step[3 * len(x):] *= 100
    move, turn = torch.from_numpy(step).split([3 * len(x), len(edges)])
    found = reference.moved(torch.from_numpy(edges), x, n, move.view_as(x), turn)
    expected = moved(q, edges, step)[3 * len(x):].reshape(-1, 3)
    assert np.abs(found.numpy() - expected).max() < 1e-12
    there = (x + move.view_as(x))[edges]
    along = torch.nn.functional.normalize(there[:, 1] - there[:, 0], dim=1)
    assert (found * along).sum(1).abs().max() < 1e-13
    assert (found.norm(dim=1) - 1).abs().max() < 1e-13
