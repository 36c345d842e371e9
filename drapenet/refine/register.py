"""Registration of a raw scan to a mesh of the specimen, by trimesh's non-rigid ICP.

The mesh starts as a drape of a plausible fabric, turned to where it fits best, and is bent onto
the scan, more and more freely (Amberg et al. 2007; Larionov et al., section 3.2). A scan without
marks on the cloth says nothing of sliding along the surface: the registered vertices lie on it,
held apart by the stiffness of the registration only.
"""

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from drapenet.refine.captured import CapturedShape
from drapenet.refine.scan import Cloud
from sim.drape import DrapeResult

TURNS = 72  # orientations tried for the start
STEPS = ((10.0, 10.0, 0.3, 8), (3.0, 10.0, 0.3, 8), (1.0, 10.0, 0.3, 8), (0.3, 10.0, 0.3, 8),
         (0.1, 10.0, 0.3, 8))
"""Rounds of the registration: stiffness, weight of the points on the plate, weight of the normals,
iterations; in units of the specimen's half size."""
REACH = 0.2  # of the half size, from which a scanned point says nothing of a vertex
_NEAR = 0.15  # how well a start fits is judged up to this distance, in half sizes


def register(start: DrapeResult, cloud: Cloud) -> tuple[CapturedShape, np.ndarray]:
    """The mesh of ``start`` on the scan ``cloud``; z up, the plate's centre the origin.

    Args:
        start: any drape on the same rig; the nearer in stiffness, the better.

    Returns:
        The registered shape, and the distance (V,), m, of its vertices from the scan.
    """
    import trimesh
    from trimesh.registration import nricp_amberg

    placed = best_start(start, cloud)
    size = start.rig.specimen_size / 2
    held = np.flatnonzero(start.held)
    # The plate's points stay: cloth adheres to it.
    source = trimesh.Trimesh(placed.positions / size, placed.faces, process=False)
    moved = nricp_amberg(
        source, cloud.points / size, source_landmarks=held,
        target_positions=placed.positions[held] / size, steps=STEPS, distance_threshold=REACH,
        use_faces=False) * size
    moved[held] = placed.positions[held]
    shape = CapturedShape(moved, placed.rest, placed.faces, start.rig)
    distance, nearest = cKDTree(cloud.points).query(moved)
    across = np.abs((cloud.normals[nearest] * (moved - cloud.points[nearest])).sum(1))
    return shape, np.where(distance < 2 * np.median(distance) + 1e-3, across, distance)


def best_start(start: DrapeResult, cloud: Cloud) -> DrapeResult:
    """``start`` turned with its specimen, or mirrored too, to lie nearest to ``cloud``."""
    tree = cKDTree(cloud.points)
    reach = _NEAR * start.rig.specimen_size / 2
    best, least = start, np.inf
    for side in (1, -1):
        for turn in np.arange(TURNS) * 2 * np.pi / TURNS:
            c, s = np.cos(turn), np.sin(turn)
            matrix = np.array([[c, s], [-s, c]])
            positions = start.positions * [side, 1, 1]
            positions[:, :2] = positions[:, :2] @ matrix
            distance = tree.query(positions[~start.held], distance_upper_bound=reach)[0]
            misfit = np.minimum(distance, reach).mean()
            if misfit < least:
                faces = start.faces if side == 1 else start.faces[:, ::-1]
                rest = (start.rest * [side, 1]) @ matrix
                least, best = misfit, replace(start, positions=positions, rest=rest, faces=faces)
    return best
