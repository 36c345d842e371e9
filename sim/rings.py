"""Disc specimens on a round plate, meshed with rings of vertices that follow rim and border."""

import numpy as np
from scipy.spatial import Delaunay

from common.errors import InputError
from sim.mesh import Mesh, check_resolution


def draped_disc(
    *,
    diameter: float,
    plate_radius: float,
    resolution: int,
    offset: tuple[float, float] = (0.0, 0.0),
    perturbed: bool = True,
    jitter: float = 0.15,
    seed: int = 0,
) -> tuple[Mesh, np.ndarray]:
    """A disc specimen: ring k has 6k vertices, one ring is the plate's rim, the last the border.

    Args:
        diameter, plate_radius: m.
        resolution: vertices along a diameter, within :data:`sim.mesh.RESOLUTIONS`.
        offset: specimen's centre relative to the plate's axis, m; rings beyond the rim drift
            towards it.
        perturbed: turn every ring at random and move its vertices, along the ring and across it,
            by up to ``jitter`` of the spacing; rim and border stay circles. Otherwise the mesh
            has the symmetry of a hexagon, and ``jitter`` and ``seed`` are not used.

    Returns:
        The mesh (origin of ``rest`` on the plate's axis) and the mask (V,) bool of the vertices
        on the plate.

    Raises:
        InputError: too few or many vertices, or the plate does not lie within the specimen.
    """
    check_resolution(resolution)
    spacing = diameter / (resolution - 1)
    overhang = diameter / 2 - plate_radius
    if overhang - np.hypot(*offset) < 1.5 * spacing:
        raise InputError(f"the specimen's overhang is too narrow for {resolution} vertices across; "
                         "reduce the offset or refine")
    inner, outer = max(2, round(plate_radius / spacing)), max(2, round(overhang / spacing))
    number = np.arange(inner + outer + 1)
    ring = np.repeat(number, np.maximum(6 * number, 1))
    first = np.concatenate([[0], 1 + 3 * number[:-1] * (number[:-1] + 1)])
    phase = (np.arange(len(ring)) - first[ring]) / np.maximum(6 * ring, 1)
    place = ring.astype(float)
    if perturbed:
        rng = np.random.default_rng(seed)
        phase += rng.random(len(number))[ring]
        phase += rng.uniform(-jitter, jitter, len(ring)) / np.maximum(6 * ring, 1)
        kept = np.isin(ring, (0, inner, inner + outer))
        place += np.where(kept, 0.0, rng.uniform(-jitter, jitter, len(ring)))
    beyond = np.maximum(place - inner, 0.0) / outer
    radius = plate_radius * np.minimum(place / inner, 1.0) + overhang * beyond
    angle = 2 * np.pi * phase
    rest = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rest += beyond[:, None] * np.asarray(offset)
    faces = _upright(rest, Delaunay(rest).simplices) if perturbed else _hexagonal(inner + outer)
    return Mesh(rest=rest, faces=faces), ring <= inner


def _hexagonal(rings: int) -> np.ndarray:
    """Faces (6 rings², 3) between the centre and rings of 6, 12, 18... vertices."""
    faces = []
    for k in range(rings):
        inner, outer = (0 if k == 0 else 1 + 3 * k * (k - 1)), 1 + 3 * k * (k + 1)
        for side in range(6):
            j = np.arange(k + 1)
            a = inner + (side * k + j) % max(6 * k, 1)
            b = outer + side * (k + 1) + j
            c = outer + (side * (k + 1) + j + 1) % (6 * (k + 1))
            faces.append(np.stack([a, b, c], axis=1))
            faces.append(np.stack([a[:-1], c[:-1], a[1:]], axis=1))
    return np.concatenate(faces)


def _upright(rest: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Faces (F, 3) turned counter-clockwise."""
    faces = faces.astype(np.int64)
    down = Mesh(rest=rest, faces=faces).areas < 0
    faces[down] = faces[down][:, [0, 2, 1]]
    return faces
