"""Derivatives by the rest shape: forwards along given moves, backwards to every vertex.

Contact of the cloth with itself counts with areas of the rest shape, which decide how near two
sheets come under a force, not how large it is. This is left out, forwards and backwards.
"""

from dataclasses import replace

import numpy as np
import torch

from sim import reference
from sim.cloth import Cloth
from sim.mesh.specimens import share_of_offset
from sim.potential import forces
from sim.scene import Rig
from sim.sensitivity.tangent import Tangent

_STEP = 1e-5  # of the mean edge, in central differences


def moves_with_rest(tangent: Tangent, moves: np.ndarray) -> np.ndarray:
    """(K, V, 3) how the equilibrium moves while its rest points move by ``moves`` (K, V, 2). Held
    vertices stay in place. By central differences of the forces, for any laws."""
    result = np.zeros((len(moves), *tangent.positions.shape))
    for k, move in enumerate(moves):
        step = _step(tangent, move)
        push = _forces_at(tangent, step * move) - _forces_at(tangent, -step * move)
        result[k] = -tangent.response(push / (2 * step))[: tangent.coordinates].reshape(-1, 3)
    return result


def moves_with_offset(tangent: Tangent, rig: Rig) -> np.ndarray:
    """(2, V, 3) how a drape moves with the offset of the specimen from the plate, m per m.

    The offset along warp and weft, as in :func:`sim.drape.drape`. On the plate the mesh stays and
    the cloth slides through it; towards the border the mesh follows the cloth more and more.
    Vertices thus move as the surface does, but not as points of the cloth.
    """
    share, _ = _of_border(tangent, rig)
    return moves_with_rest(tangent, share[:, None] * np.eye(2)[:, None])


def moves_with_size(tangent: Tangent, rig: Rig) -> np.ndarray:
    """(2, V, 3) how a drape moves with the specimen's size, m per m, and its cut, m per rad; the
    mesh moves as for :func:`moves_with_offset`."""
    share, from_centre = _of_border(tangent, rig)
    turned = np.column_stack([-from_centre[:, 1], from_centre[:, 0]])
    return moves_with_rest(
        tangent, share[:, None] * np.stack([from_centre / rig.specimen_size, turned]))


def moves_with_plate(tangent: Tangent, rig: Rig) -> np.ndarray:
    """(V, 3) how a drape moves with the diameter of the plate of ``rig``, m per m. The vertices on
    the plate move with it, and the others less and less towards the border."""
    scene = tangent.cloth.scene
    move = (1 - _of_border(tangent, rig)[0])[:, None] * scene.mesh.rest / rig.plate_diameter
    step = _step(tangent, move)
    ahead, behind = (
        _forces_at(tangent, s * move, replace(rig, plate_diameter=rig.plate_diameter + s))
        for s in (step, -step))
    carried = np.zeros(tangent.cloth.potential.unknowns)
    carried[: tangent.coordinates].reshape(-1, 3)[scene.held, :2] = move[scene.held]
    push = (ahead - behind) / (2 * step) + tangent.force_of(carried)
    return (carried - tangent.response(push))[: tangent.coordinates].reshape(-1, 3)


def _of_border(tangent: Tangent, rig: Rig) -> tuple[np.ndarray, np.ndarray]:
    """Share (V,) of the border's moves that the mesh takes, and (V, 2) m from the centre."""
    mesh = tangent.cloth.scene.mesh
    centre = mesh.areas @ mesh.rest[mesh.faces].mean(axis=1) / mesh.areas.sum()
    share = share_of_offset(mesh.rest, rig, centre)
    return np.where(tangent.cloth.scene.held, 0.0, share), mesh.rest - centre


def _step(tangent: Tangent, move: np.ndarray) -> float:
    """By how much of a ``move`` of the rest points forces are compared."""
    return _STEP * tangent.cloth.scene.mesh.edge_lengths.mean() / np.abs(move).max()


def _forces_at(tangent: Tangent, move: np.ndarray, rig: Rig | None = None) -> np.ndarray:
    """(U,) the energy's gradient with rest points moved by ``move`` (V, 2), on another ``rig``."""
    cloth = tangent.cloth
    mesh = cloth.scene.mesh
    obstacles = rig.obstacles if rig else cloth.scene.obstacles
    scene = replace(cloth.scene, mesh=mesh.with_rest(mesh.rest + move), obstacles=obstacles)
    moved = Cloth(scene, cloth.fabric, laws=cloth.laws).potential
    return forces(moved.energies, tangent.q, moved.unknowns)


def pull_on_rest(tangent: Tangent, weights: np.ndarray) -> np.ndarray:
    """(V, 2) derivatives by the rest points of the energy's gradient times ``weights`` (U,), by
    automatic differentiation of :mod:`sim.reference`; NaN for laws that have no twin there."""
    cloth, mesh = tangent.cloth, tangent.cloth.scene.mesh
    if not reference.covers(cloth):
        return np.full_like(mesh.rest, np.nan)
    with torch.enable_grad():  # which is off where this is part of a backward pass
        twin = reference.Twin(cloth)
        x, n = torch.from_numpy(tangent.q.reshape(-1, 3)).split([len(mesh.rest), len(mesh.edges)])
        rest = torch.tensor(mesh.rest, requires_grad=True)
        move = torch.zeros_like(x, requires_grad=True)
        turn = torch.zeros(len(n), dtype=x.dtype, requires_grad=True)
        total = twin.energy(x + move, reference.moved(twin.edges, x, n, move, turn), rest)
        gradients = torch.autograd.grad(total, (move, turn), create_graph=True)
        along, around = np.split(weights, [tangent.coordinates])
        pull = ((gradients[0] * torch.from_numpy(along).view_as(move)).sum()
                + (gradients[1] * torch.from_numpy(around)).sum())
        return torch.autograd.grad(pull, rest)[0].numpy()
