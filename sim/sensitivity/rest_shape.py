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
from sim.scene import Rig, Scene
from sim.sensitivity.tangent import Tangent

_STEP = 1e-5  # of the mean edge, in central differences


def moves_with_rest(tangent: Tangent, moves: np.ndarray) -> np.ndarray:
    """(K, V, 3) how the equilibrium moves while its rest points move by ``moves`` (K, V, 2). Held
    vertices stay in place. By central differences of the forces, for any laws."""
    scene, result = tangent.cloth.scene, np.zeros((len(moves), *tangent.positions.shape))
    for k, move in enumerate(moves):
        step = difference_step(tangent, move)
        meshes = (scene.mesh.with_rest(scene.mesh.rest + s * move) for s in (step, -step))
        ahead, behind = (forces_in(replace(scene, mesh=mesh), tangent) for mesh in meshes)
        push = (ahead - behind) / (2 * step)
        result[k] = -tangent.response(push)[: tangent.coordinates].reshape(-1, 3)
    return result


def moves_with_offset(tangent: Tangent, rig: Rig) -> np.ndarray:
    """(2, V, 3) how a drape moves with the offset of the specimen from the plate, m per m.

    The offset along warp and weft, as in :func:`sim.drape.drape`. On the plate the mesh stays and
    the cloth slides through it; towards the border the mesh follows the cloth more and more.
    Vertices thus move as the surface does, but not as points of the cloth.
    """
    share, _ = share_of_border(tangent, rig)
    return moves_with_rest(tangent, share[:, None] * np.eye(2)[:, None])


def share_of_border(tangent: Tangent, rig: Rig) -> tuple[np.ndarray, np.ndarray]:
    """Share (V,) of the border's moves that the mesh takes, and (V, 2) m from the centre."""
    mesh = tangent.cloth.scene.mesh
    centre = mesh.areas @ mesh.rest[mesh.faces].mean(axis=1) / mesh.areas.sum()
    share = share_of_offset(mesh.rest, rig, centre)
    return np.where(tangent.cloth.scene.held, 0.0, share), mesh.rest - centre


def difference_step(tangent: Tangent, move: np.ndarray) -> float:
    """The share of a ``move`` (V, 2), m, of the rest points by which central differences step."""
    return _STEP * tangent.cloth.scene.mesh.edge_lengths.mean() / np.abs(move).max()


def forces_in(scene: Scene, tangent: Tangent) -> np.ndarray:
    """(U,) the energy's gradient at the state of ``tangent`` in another scene."""
    potential = Cloth(scene, tangent.cloth.fabric, laws=tangent.cloth.laws).potential
    return forces(potential.energies, tangent.q, potential.unknowns)


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
