"""A full-circle skirt: cloth without a body and seams that hangs from a ring at its waist."""

import numpy as np

from common.types import Metres, Points
from sim.draping import FINE_OPTIONS, Drape, drape
from sim.equilibrium import Equilibrium, find_equilibrium
from sim.material import Fabric
from sim.mesh import Mesh
from sim.rig import Rig
from sim.scene import Scene

SKIRT = Rig((0.86, 0.86), 0.24, "disc")
"""The flat skirt on a plate of its waist: 754 mm around it, and 310 mm long."""


def skirt(fabric: Fabric, *, edge: Metres, seed: int = 0) -> Equilibrium:
    """A skirt, or the last state of a search that failed, with its status.

    The cloth is lowered over a plate of the waist's size; then the plate and the cloth on it are
    taken away, so that the skirt can turn about the ring. ``edge`` is that of the mesh at the
    waist, ``seed`` that of the lowering.
    """
    lowered = drape(fabric, rig=SKIRT, edge=edge, seed=seed)
    if not lowered.converged:
        return lowered
    return settled(*below_waist(lowered), fabric).after(lowered)


def below_waist(lowered: Drape) -> tuple[Scene, Points]:
    """The cloth beyond the plate, held at its inner border alone."""
    faces = lowered.faces[~lowered.held[lowered.faces].all(axis=1)]
    kept, faces = np.unique(faces, return_inverse=True)
    return (Scene(Mesh(lowered.rest[kept], faces.reshape(-1, 3)), lowered.held[kept]),
            lowered.positions[kept])


def hem(scene: Scene) -> np.ndarray:
    """Indices (H,) of the vertices at the hem of a skirt, around it."""
    mesh = scene.mesh
    border = np.unique(mesh.edges[mesh.edge_faces[:, 1] < 0])
    border = border[~scene.held[border]]
    return border[np.argsort(np.arctan2(mesh.rest[border, 1], mesh.rest[border, 0]))]


def settled(scene: Scene, positions: Points, fabric: Fabric) -> Equilibrium:
    """The equilibrium of a ``fabric`` near ``positions`` of a skirt, such as another fabric's: it
    keeps the folds of these."""
    return find_equilibrium(scene, fabric, scene.state(positions), options=FINE_OPTIONS,
                            self_contact=True)
