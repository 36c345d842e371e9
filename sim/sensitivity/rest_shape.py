"""Derivatives by the rest shape, along given moves. That of the areas in self-contact, which
affect the distance of two sheets under a force, not the force, is neglected."""

from dataclasses import replace

import numpy as np

from common.types import RestPoints
from sim.cloth import Cloth
from sim.mesh.specimen import share_of_offset
from sim.rig import Rig
from sim.scene import Scene
from sim.sensitivity.tangent import Tangent
from sim.solver.potential import forces

_STEP = 1e-5  # of the mean edge, in central differences


def moves_with_rest(tangent: Tangent, moves: np.ndarray) -> np.ndarray:
    """Moves (K, V, 3) of the equilibrium as its rest points move by ``moves`` (K, V, 2), m, but not
    held vertices. By central differences of the forces, for any laws."""
    scene, result = tangent.cloth.scene, np.zeros((len(moves), *tangent.positions.shape))
    for k, move in enumerate(moves):
        step = difference_step(tangent, move)
        meshes = (scene.mesh.with_rest(scene.mesh.rest + s * move) for s in (step, -step))
        ahead, behind = (forces_in(replace(scene, mesh=mesh), tangent) for mesh in meshes)
        force = (ahead - behind) / (2 * step)
        result[k] = -tangent.response(force)[: tangent.coordinates].reshape(-1, 3)
    return result


def moves_with_offset(tangent: Tangent, rig: Rig) -> np.ndarray:
    """Derivatives (2, V, 3) of a drape by the offset of the specimen from the plate, along warp and
    weft, m per m. On the plate the mesh is fixed and the cloth slides through it; towards the
    border the mesh increasingly follows the cloth."""
    share, _ = share_of_border(tangent, rig)
    return moves_with_rest(tangent, share[:, None] * np.eye(2)[:, None])


def share_of_border(tangent: Tangent, rig: Rig) -> tuple[np.ndarray, np.ndarray]:
    """Share (V,) of the border's move that a vertex takes, and its offset (V, 2), m, from the
    specimen's centre."""
    mesh = tangent.cloth.scene.mesh
    centre = mesh.areas @ mesh.rest[mesh.faces].mean(axis=1) / mesh.areas.sum()
    share = share_of_offset(mesh.rest, rig, centre)
    return np.where(tangent.cloth.scene.held, 0.0, share), mesh.rest - centre


def difference_step(tangent: Tangent, move: RestPoints) -> float:
    """Step of central differences as a fraction of a ``move`` of the rest points."""
    return _STEP * tangent.cloth.scene.mesh.edge_lengths.mean() / np.abs(move).max()


def forces_in(scene: Scene, tangent: Tangent) -> np.ndarray:
    """Gradient (U,) of the energy at the state of ``tangent`` in another scene."""
    potential = Cloth(scene, tangent.cloth.fabric, laws=tangent.cloth.laws).potential
    return forces(potential.energies, tangent.q, potential.unknowns)
