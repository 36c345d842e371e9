"""The plain PyTorch energies against the fast kernels: values, gradients, invariances."""

import numpy as np
import pytest
import torch

from sim import reference
from sim.cloth import Cloth
from sim.laws import Laws
from sim.material import Fabric
from sim.membranes import Corotational
from sim.mesh.specimens import make_specimen
from sim.scene import DISC_RIG, Rig, Scene
from sim.state import moved

FABRICS = [Fabric([98.8e-6, 23.5e-6, 21.2e-6], [-247e-9, -58.8e-9, -53e-9]),
           Fabric([20e-6, 30e-6, 10e-6], [40e-9, 10e-9, 5e-9], density=0.2)]


def crumpled(rig: Rig, size: float, turn: float) -> tuple[list[Cloth], np.ndarray]:
    """Two cloths on one topology with other offsets and fabrics, and a state (2, 3V + 3E) each."""
    rng, cloths, states = np.random.default_rng(0), [], []
    for fabric, offset in zip(FABRICS, [(0.0, 0.0), (4e-3, -2e-3)], strict=True):
        specimen = make_specimen(rig, edge=0.012, topology=2, offset=offset)
        scene = Scene(mesh=specimen.mesh, held=specimen.held, obstacles=rig.obstacles)
        cloth = Cloth(scene, fabric, laws=Laws(membrane=Corotational(300.0, 0.2)))
        rest = specimen.mesh.rest
        radius = np.linalg.norm(rest, axis=1)
        inwards = np.minimum(1, (rig.plate_radius - 1e-4) / np.maximum(radius, 1e-9))
        hanging = radius > rig.plate_radius  # some of it against the cylinder's side
        shape = np.column_stack([np.where(hanging, inwards, 1)[:, None] * rest,
                                 -np.maximum(radius - rig.plate_radius, 0)])
        shape += rng.normal(0, size, shape.shape) * ~specimen.held[:, None]
        steps = np.concatenate([np.zeros(shape.size),
                                rng.normal(0, turn, len(specimen.mesh.edges))])
        steps[shape.size:] *= ~scene.held_edges
        cloths.append(cloth)
        states.append(moved(scene.state(shape).q, specimen.mesh.edges, steps))
    return cloths, np.stack(states)


def split(cloths: list[Cloth], states: np.ndarray) -> tuple[torch.Tensor, torch.Tensor]:
    q = torch.from_numpy(states).view(len(states), -1, 3)
    return q.split([len(cloths[0].scene.mesh.rest), len(cloths[0].scene.mesh.edges)], dim=1)


@pytest.mark.parametrize("rig", [Rig(), DISC_RIG], ids=lambda rig: rig.name)
@pytest.mark.parametrize("folded", [False, True])
def test_values_and_gradients_are_those_of_the_kernels(rig, folded):
    cloths, states = crumpled(rig, *((9e-3, 0.0) if folded else (1e-3, 0.05)))
    assert all(c.bending.is_folded(q) == folded for c, q in zip(cloths, states, strict=True))
    twins = reference.cloths_of(cloths)
    assert all(reference.covers(cloth) for cloth in cloths)
    assert all(c.obstacles[0].value(q) > 0 for c, q in zip(cloths, states, strict=True))
    x, n = split(cloths, states)
    move = torch.zeros_like(x, requires_grad=True)
    turn = torch.zeros(n.shape[:2], dtype=x.dtype, requires_grad=True)
    total = reference.energy(twins, x + move, reference.moved(twins.topology, x, n, move, turn))
    by_move, by_turn = torch.autograd.grad(total.sum(), (move, turn))
    for k, (cloth, q) in enumerate(zip(cloths, states, strict=True)):
        assert float(total[k].detach()) == pytest.approx(cloth.potential.value(q), rel=1e-13)
        both = np.concatenate([by_move[k].ravel().numpy(), by_turn[k].numpy()])
        expected = cloth.potential.gradient(q)
        found = cloth.potential.free_unknowns(both)
        assert np.abs(found - expected).max() < 1e-12 * np.abs(expected).max()


def test_steps_carry_normals_as_the_simulator_does():
    cloths, states = crumpled(Rig(), 1.5e-3, 0.1)
    edges = cloths[0].scene.mesh.edges
    rng = np.random.default_rng(1)
    x, n = split(cloths, states)
    steps = rng.normal(0, 2e-3, (2, 3 * x.shape[1] + len(edges)))
    steps[:, 3 * x.shape[1]:] *= 100
    move = torch.from_numpy(steps[:, : 3 * x.shape[1]]).view_as(x)
    turn = torch.from_numpy(steps[:, 3 * x.shape[1]:].copy())
    found = reference.moved(reference.Topology(cloths[0].scene), x, n, move, turn)
    for k in range(2):
        expected = moved(states[k], edges, steps[k])[3 * x.shape[1]:].reshape(-1, 3)
        assert np.abs(found[k].numpy() - expected).max() < 1e-12
        there = (x[k] + move[k])[edges]
        along = torch.nn.functional.normalize(there[:, 1] - there[:, 0], dim=1)
        assert (found[k] * along).sum(1).abs().max() < 1e-13
        assert (found[k].norm(dim=1) - 1).abs().max() < 1e-13


def test_turns_are_right_handed_about_edges():
    """A step of turns alone, and its derivative at zero: xi u × n."""
    cloths, states = crumpled(Rig(), 1.5e-3, 0.1)
    topology = reference.Topology(cloths[0].scene)
    x, n = split(cloths, states)
    angles = torch.from_numpy(np.random.default_rng(2).normal(0, 1, n.shape[:2]))
    along = torch.nn.functional.normalize(
        x[:, topology.edges[:, 1]] - x[:, topology.edges[:, 0]], dim=2)
    across = torch.linalg.cross(along, n)
    still = torch.zeros_like(x)
    found = reference.moved(topology, x, n, still, angles)
    turned = torch.cos(angles)[..., None] * n + torch.sin(angles)[..., None] * across
    assert (found - turned).abs().max() < 1e-14
    _, slope = torch.func.jvp(lambda turn: reference.moved(topology, x, n, still, turn),
                              (torch.zeros_like(angles),), (angles,))
    assert (slope - angles[..., None] * across).abs().max() < 1e-13


@pytest.mark.parametrize("sign", [1, -1], ids=["moved", "mirrored"])
def test_rigid_motions_and_mirrors_cost_nothing(sign):
    cloths, states = crumpled(Rig(), 1.5e-3, 0.1)
    twins = reference.cloths_of(cloths)
    x, n = split(cloths, states)
    rotation, _ = np.linalg.qr(np.random.default_rng(3).standard_normal((3, 3)))
    rotation = torch.from_numpy(rotation * np.sign(np.linalg.det(rotation)) * sign)

    def inner(x: torch.Tensor, n: torch.Tensor) -> torch.Tensor:
        return reference.energy(twins, x, n) - reference.outer(twins, x)

    shift = torch.tensor([0.1, 0.2, 0.3], dtype=torch.float64)
    there = inner(x @ rotation.T + shift, sign * n @ rotation.T)  # normals are axial vectors
    assert torch.allclose(there, inner(x, n), rtol=1e-11, atol=0)


def test_derivatives_by_the_fabric_through_automatic_differentiation():
    """Of the energy by the membrane's constants and by the moduli's own energies: homogeneity."""
    cloths, states = crumpled(Rig(), 1.5e-3, 0.1)
    twins = reference.cloths_of(cloths)
    x, n = split(cloths, states)
    for name in ("mu", "lam", "weight", "pressure"):
        getattr(twins, name).requires_grad_()
    total = reference.energy(twins, x, n)
    by_mu, by_lam, by_weight, by_pressure = torch.autograd.grad(
        total.sum(), (twins.mu, twins.lam, twins.weight, twins.pressure))
    for k, (cloth, q) in enumerate(zip(cloths, states, strict=True)):
        membrane = (twins.mu * by_mu + twins.lam * by_lam)[k, 0].item()
        assert membrane == pytest.approx(cloth.membrane.value(q), rel=1e-9)
        weight = (twins.weight * by_weight)[k, 0].item()
        assert weight == pytest.approx(cloth.weight.value(q), rel=1e-10)
        contact = (twins.pressure * by_pressure)[k, 0].item()
        assert contact == pytest.approx(sum(o.value(q) for o in cloth.obstacles), rel=1e-10)


def test_other_laws_are_not_covered():
    cloths, _ = crumpled(Rig(), 1.5e-3, 0.1)
    scene, fabric = cloths[0].scene, cloths[0].fabric
    assert not reference.covers(Cloth(scene, fabric, laws=Laws(bending="hinge")))
