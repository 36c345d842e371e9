"""Registration of a scan to a mesh of the specimen: simulated cloth is pulled onto the surface.

A scan without marks on the cloth says nothing of sliding along the surface. The cloth says it
itself: it hardly stretches, so from the plate's rim on every vertex has its place. The specimen is
laid on the surface (:mod:`.guided`), its fabric soft so that it follows the folds, and pulled onto
it more and more, until its strain is as large as in a drape. Trimesh's non-rigid ICP (Amberg et al.
2007), which Larionov et al. use (section 3.2), stretches the mesh instead: its hem ends up to
25 mm from the scanned one (see ``docs/validation.md``).
"""

from dataclasses import dataclass

import numpy as np

from drapenet.refine.attraction import captured_shape, pulled
from drapenet.refine.captured import CapturedShape
from drapenet.refine.fidelity import distances
from drapenet.refine.scan import Cloud, rotation
from sim.laws import Laws
from sim.material import MICRO, REFERENCE_DENSITY, Fabric
from sim.mesh import edges_of
from sim.scene import Rig

SOFT = Fabric(alpha=np.full(3, 2 * MICRO), beta=np.zeros(3), density=REFERENCE_DENSITY)
"""Bends as easily as the softest real fabrics: it irons no fold out."""
FIRMLY = 30.0
"""Last pull, force at 1 mm over the cloth's weight. Nine real scans are met to 0.6 mm, the mesh
strained by 0.6 % as drapes are; 100 leaves 0.4 mm at 1.1 %."""
SLID = 0.05
"""Cloth does not stretch so much by its own weight: a scan whose edges differ by this from their
rest lengths, root mean square, has vertices that slid along the cloth."""


@dataclass(frozen=True)
class Registered:
    """A scan on a mesh of the specimen.

    Attributes:
        shape: the mesh, on the scan.
        distance: (V,) m, of its vertices from the scanned surface.
    """

    shape: CapturedShape
    distance: np.ndarray


def register(
    cloud: Cloud, rig: Rig, *, edge: float, turn: float = 0.0, held: float = 1.0
) -> Registered:
    """A mesh of the specimen on the scan ``cloud``; z up, the plate's centre the origin.

    Args:
        edge: length of the mesh's edges at the plate's rim, m.
        turn: rad, direction of the mesh's first rest axis on the plate. A scan does not tell it.
        held: see :class:`.captured.CapturedShape`.
    """
    back = rotation(turn)  # of rows: from the rig's axes to the rest axes
    # Which side a scanned normal points to is not known.
    points = np.tile(cloud.points, (2, 1)) @ back
    normals = np.concatenate([cloud.normals, -cloud.normals]) @ back
    laid = captured_shape(SOFT, points, normals, rig=rig, edge=edge)
    found = pulled(laid.scene, SOFT, laid.state, points, normals, laws=Laws(), pulls=[FIRMLY])
    shape = CapturedShape(found.state.positions @ back.T, laid.rest, laid.faces, rig, held)
    return Registered(shape, distances(cloud, shape.positions))


def laid_again(shape: CapturedShape, *, edge: float) -> Registered:
    """A registered scan once more, on a mesh of its own, the rest axes where they were."""
    plate = ~shape.hanging
    flat, rest = (points @ [1.0, 1j] for points in (shape.positions[plate, :2], shape.rest[plate]))
    turn = float(np.angle(np.vdot(rest, flat)))
    return register(Cloud.of_mesh(shape.positions, shape.faces), shape.rig, edge=edge, turn=turn,
                    held=shape.held_share)


def edge_strain(shape: CapturedShape) -> float:
    """How much the hanging edges of a registered scan differ from their rest lengths, rms."""
    edges = edges_of(shape.faces)[0]
    edges = edges[shape.hanging[edges].any(axis=1)]
    length, rest = (np.linalg.norm(p[edges[:, 0]] - p[edges[:, 1]], axis=1)
                    for p in (shape.positions, shape.rest))
    return float(np.sqrt(np.mean((length / rest - 1) ** 2)))
