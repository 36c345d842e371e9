"""Derivatives by the rest shape: forwards along given moves, backwards to every vertex.

Contact of the cloth with itself counts with areas of the rest shape, which decide how near two
sheets come under a force, not how large it is. This is left out, forwards and backwards.
"""

from dataclasses import replace

import numpy as np
import torch

from sim import reference
from sim.cloth import Cloth
from sim.scene import Rig
from sim.sensitivity.parameters import forces
from sim.sensitivity.tangent import Tangent

_STEP = 1e-5  # of the mean edge, in central differences


def moves_with_rest(tangent: Tangent, moves: np.ndarray) -> np.ndarray:
    """(K, V, 3) how the equilibrium moves while its rest points move by ``moves`` (K, V, 2).

    Held vertices stay in place. By central differences of the forces, for any laws.
    """
    scene, cloth = tangent.cloth.scene, tangent.cloth
    mesh = scene.mesh
    edges = mesh.rest[mesh.edges]
    edge = np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1).mean()

    def forces_at(rest: np.ndarray) -> np.ndarray:
        moved = Cloth(replace(scene, mesh=mesh.with_rest(rest)), cloth.fabric, laws=cloth.laws)
        return forces(moved.potential.energies, tangent.q, moved.potential.unknowns)

    result = np.zeros((len(moves), *tangent.positions.shape))
    for k, move in enumerate(moves):
        step = _STEP * edge / np.abs(move).max()
        push = forces_at(mesh.rest + step * move) - forces_at(mesh.rest - step * move)
        result[k] = -tangent.response(push / (2 * step))[: tangent.coordinates].reshape(-1, 3)
    return result


def moves_with_offset(tangent: Tangent, rig: Rig) -> np.ndarray:
    """(2, V, 3) how a drape moves with the offset of the specimen from the plate, m per m.

    The offset along warp and weft, as in :func:`sim.drape.drape`. Under the plate and next to it
    the mesh stays and the cloth slides through it; outwards the mesh follows the cloth more and
    more. Vertices thus move as the surface does, but not as points of the cloth.
    """
    scene = tangent.cloth.scene
    radius = np.linalg.norm(scene.mesh.rest, axis=1)
    width = rig.specimen_size / 2 - rig.plate_radius
    share = np.clip((radius - rig.plate_radius) / width, 0.0, 1.0)
    share[scene.held] = 0.0
    return moves_with_rest(tangent, share[:, None] * np.eye(2)[:, None])


def pull_on_rest(tangent: Tangent, weights: np.ndarray) -> np.ndarray:
    """(V, 2) derivatives by the rest points of the energy's gradient times ``weights`` (U,).

    By automatic differentiation of :mod:`sim.reference`. NaN where there is an energy without a
    twin there, that is, for other laws than the default.
    """
    cloth, mesh = tangent.cloth, tangent.cloth.scene.mesh
    if not reference.covers(cloth):
        return np.full_like(mesh.rest, np.nan)
    with torch.enable_grad():  # which is off where this is part of a backward pass
        cloths = reference.cloths_of([cloth])
        rest = cloths.rest.requires_grad_()
        x, n = torch.from_numpy(tangent.q.reshape(1, -1, 3)).split(
            [len(mesh.rest), len(mesh.edges)], dim=1)
        move = torch.zeros_like(x, requires_grad=True)
        turn = torch.zeros(1, len(mesh.edges), dtype=x.dtype, requires_grad=True)
        there = reference.moved(cloths.topology, x, n, move, turn)
        total = reference.energy(cloths, x + move, there)
        gradients = torch.autograd.grad(total.sum(), (move, turn), create_graph=True)
        along, around = np.split(weights, [tangent.coordinates])
        pull = ((gradients[0] * torch.from_numpy(along).view_as(move)).sum()
                + (gradients[1] * torch.from_numpy(around)).sum())
        return torch.autograd.grad(pull, rest)[0][0].numpy()
