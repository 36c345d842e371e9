"""Self-intersections of cloth, their removal, and the parameters of self-contact."""

import numpy as np

from sim.energies.self_contact import SelfContact, import_ipctk
from sim.mesh import Mesh, adjacency, smooth
from sim.scene import Scene

DISTANCE = 1e-3
"""Distance of two sheets of cloth, m, below which contact acts, about two thicknesses."""
PRESSURE = 20.0
"""Pressure between two sheets at half that distance, as a multiple of the cloth's weight."""
_MAX_SHARE_OF_HEIGHT = 0.5  # limit of the distance on fine meshes, in heights of a triangle
_REACH = 3.0  # pairs within this multiple of the distance are part of the Hessian's pattern
_MAX_UNTANGLING_ROUNDS = 60


def self_intersections(positions: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Self-intersections (N, 3) of cloth at finite positions (V, 3) with faces (F, 3): the two
    vertices of an edge and the face that it passes through.

    Exact, by floating-point predicates with certified signs. Edges that share a vertex with the
    face do not count; an edge that only touches a face does.
    """
    ipctk = import_ipctk()
    edges = ipctk.edges(faces)
    boxes = ipctk.LBVH()
    boxes.build(np.asfortranarray(positions), edges, faces)
    near = [(pair.edge_id, pair.face_id) for pair in boxes.detect_edge_face_candidates()]
    edge, face = np.array(near, dtype=np.int64).reshape(-1, 2).T
    apart = (edges[edge][:, :, None] != faces[face][:, None, :]).all(axis=(1, 2))
    edge, face = edge[apart], face[apart]
    corners = positions[np.concatenate([edges[edge], faces[face]], axis=1)]
    crossing = np.array([ipctk.is_edge_intersecting_triangle(*five) for five in corners], bool)
    found = np.column_stack([edges[edge], face])[crossing]
    return found[np.lexsort(found.T)]


def untangled(mesh: Mesh, held: np.ndarray, positions: np.ndarray) -> np.ndarray | None:
    """Positions (V, 3), m, near the given ones without intersections; None if none are found.

    Vertices around each intersection move repeatedly half-way to the mean of their neighbours, in
    a neighbourhood and number that grow with the rounds. Those ``held`` (V,) are fixed.
    """
    vertices, adjacent, x = len(positions), adjacency(mesh), positions.copy()
    for step in range(_MAX_UNTANGLING_ROUNDS):
        crossing = self_intersections(x, mesh.faces)
        if len(crossing) == 0:
            return x
        around = np.zeros(vertices, dtype=bool)
        around[crossing[:, :2]] = around[mesh.faces[crossing[:, 2]]] = True
        for _ in range(1 + step // 6):
            around |= adjacent @ around > 0
        moving = around & ~held
        for _ in range(2 + step // 4):
            smooth(x, moving, adjacent)
    return None


def contact_near(scene: Scene, positions: np.ndarray, *, density: float) -> SelfContact:
    """Self-contact of a cloth of ``density``, kg/m², near positions (V, 3), m; its energy is zero
    for most drapes."""
    distance = contact_distance(scene.mesh)
    return SelfContact(scene.mesh, positions, distance=distance,
                       pressure=PRESSURE * density * scene.gravity, reach=_REACH * distance)


def contact_distance(mesh: Mesh) -> float:
    """Distance, m, below which contact acts on ``mesh``; none acts in a flat specimen."""
    corners = mesh.rest[mesh.faces]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    return float(min(DISTANCE, _MAX_SHARE_OF_HEIGHT * (2 * mesh.areas / longest).min()))
