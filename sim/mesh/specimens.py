"""Meshes of a rig's specimen: edge length, offset from the plate, held vertices."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from common.errors import InputError
from sim.material import Fabric
from sim.mesh.graded import Outline, graded_mesh
from sim.mesh.topology import Mesh
from sim.rig import GRAVITY, Rig

TOPOLOGIES = 8
"""Number of random triangulations of one size; drapes share them."""
GRADING = 4.0
"""Edge length at the hem over edge length at the rim."""
MAX_EDGE = 0.020
"""Maximum edge length, m, so that coarse meshes resolve the folds of a start."""
DEFAULT_EDGES = (2e-3, 2.5e-3, 3e-3, 4e-3)  # m, see :func:`default_edge`
EDGES_PER_LENGTH = 6.5
_REFINEMENT = 2.5  # ratio of edge lengths of successive meshes of a drape
MAX_COARSE_EDGE = 0.013
"""Maximum edge length at the rim, m, of the first mesh of a drape."""
MAX_BORROWED_EDGE = 0.008
"""The same for a warm start from another drape, whose folds must be resolved."""
EDGE_RANGE = (5e-4, 5e-2)
"""Edge lengths at the rim, m; limited by memory and time, and by the shape of the plate."""
MAX_SHARED_OFFSET = 0.2
"""Maximum offset, in widths of the overhang, for which a base mesh is deformed. Beyond it,
triangles on the narrow side would lose more than a fifth of their width: a new mesh is made."""
_MIN_EDGES_ACROSS = 2.0  # between rim and border
_SIZE_STEP = 5e-3  # m; sizes of base meshes are multiples of it
_MAX_SCALING = 0.03  # maximum relative change of a base mesh's size, or of its plate's


@dataclass(frozen=True, eq=False)
class Specimen:
    """A rig's specimen, meshed.

    Attributes:
        mesh: origin of ``rest`` on the plate's axis, without a plate at the specimen's centre.
        held: (V,) bool, vertices that the rig holds.
    """

    mesh: Mesh
    held: np.ndarray


def make_specimen(
    rig: Rig, *, edge: float, topology: int = 0, offset: tuple[float, float] = (0.0, 0.0),
    grading: float = GRADING
) -> Specimen:
    """Mesh the specimen of ``rig``.

    Specimens of similar size, and those with an offset up to :data:`MAX_SHARED_OFFSET`, share the
    faces of a base mesh with other points: those on the plate move with the plate, those on the
    border with the border, others in proportion.

    Args:
        edge: edge length at the plate's rim, m, within :data:`EDGE_RANGE`. Without a plate, of all
            edges.
        topology: index of one of the :data:`TOPOLOGIES` random triangulations.
        offset: specimen's centre from the plate's axis, m.
        grading: edge length at the hem over ``edge``, at least 1. Lengths grow by 10 % per edge, up
            to :data:`MAX_EDGE`; on the plate, where triangles store no energy, they grow faster.
    """
    _check(rig, edge, topology, offset, grading)
    overhang = (rig.specimen_size - rig.plate_diameter) / 2
    # In the axes of the sides, which may differ from warp and weft.
    along_sides = np.asarray(offset, dtype=float) @ rig.sides
    shared = np.hypot(*along_sides) <= MAX_SHARED_OFFSET * overhang
    base = _base_rig(rig)
    specimen = _base_specimen(base, float(edge), int(topology),
                              (0.0, 0.0) if shared else tuple(along_sides.tolist()), float(grading))
    if rig == base and not (shared and along_sides.any()):
        return specimen
    rest = specimen.mesh.rest
    share = share_of_offset(rest, base, (0, 0) if shared else along_sides)
    share = np.where(specimen.held, 0.0, share)
    if rig.has_plate:
        plate = rig.plate_diameter / base.plate_diameter
        border = rig.specimen_size / base.specimen_size
        rest = rest * (plate + (border - plate) * share)[:, None]
    if shared:
        rest = rest + share[:, None] * along_sides
    return Specimen(specimen.mesh.with_rest(rest @ rig.sides.T), specimen.held)


def _base_rig(rig: Rig) -> Rig:
    """The rig whose meshes are used for ``rig``: of rounded sizes, cut along the yarns."""
    if not rig.has_plate:
        return rig
    sizes = np.array([rig.specimen_size, rig.plate_diameter])
    rounded = np.round(_SIZE_STEP * np.round(sizes / _SIZE_STEP), 6)
    near = (np.abs(rounded - sizes) <= _MAX_SCALING * sizes).all()
    return Rig(*(rounded if near else sizes).tolist(), specimen=rig.specimen)


def _check(
    rig: Rig, edge: float, topology: int, offset: tuple[float, float], grading: float
) -> None:
    check_edge(edge)
    if not 1 <= grading < np.inf:
        raise InputError(f"grading={grading:g}: edges at the hem must not be shorter than at the "
                         "rim; give 1 or more")
    if topology not in range(TOPOLOGIES):
        raise InputError(f"topology={topology} must be a whole number from 0 to {TOPOLOGIES - 1}")
    if not rig.has_plate and np.any(offset):
        raise InputError(f"rig {rig.name} has no plate for an offset to refer to")
    longest = longest_edge(rig, offset)
    if not edge <= longest:
        raise InputError(f"an overhang of {1e3 * _MIN_EDGES_ACROSS * longest:.3g} mm at its "
                         f"narrowest is too narrow for edges of {1e3 * edge:.3g} mm, which need "
                         f"{1e3 * _MIN_EDGES_ACROSS * edge:.3g} mm; reduce the offset or refine")


def longest_edge(rig: Rig, offset: tuple[float, float]) -> float:
    """Maximum edge length at the rim, m, for the narrowest overhang of a specimen."""
    if not rig.has_plate:
        return np.inf
    shift = np.hypot(*offset) if rig.specimen == "disc" else np.abs(offset).max()
    return ((rig.specimen_size - rig.plate_diameter) / 2 - shift) / _MIN_EDGES_ACROSS


def check_edge(edge: float) -> None:
    """InputError for an edge length at the rim, m, outside :data:`EDGE_RANGE`."""
    least, most = EDGE_RANGE
    if not least <= edge <= most:
        raise InputError(f"edge={1e3 * edge:g} mm at the rim must lie between {1e3 * least:g} and "
                         f"{1e3 * most:g} mm")


@lru_cache(maxsize=128)
def _base_specimen(
    rig: Rig, edge: float, topology: int, centre: tuple[float, float], grading: float
) -> Specimen:
    """A specimen around ``centre``, triangulated for that offset."""
    largest = max(edge, min(grading * edge, MAX_EDGE))
    mesh, count = graded_mesh(Outline(rig, centre, edge, largest), np.random.default_rng(topology))
    if rig.has_plate:
        return Specimen(mesh, np.arange(len(mesh.rest)) < count)
    corners = np.array([[-0.5, 0.5], [0.5, 0.5]]) * rig.specimen_size
    return Specimen(mesh, (mesh.rest[:, None] == corners).all(axis=2).any(axis=1))


def share_of_offset(
    rest: np.ndarray, rig: Rig, centre: np.ndarray | tuple[float, float] = (0.0, 0.0)
) -> np.ndarray:
    """Share (V,) of a change of offset by which points (V, 2), m, of a specimen around ``centre``
    move: zero on the plate, one on the border, proportional between them."""
    to_plate, to_border = rig.to_plate(rest), np.maximum(rig.to_border(rest, centre), 0.0)
    return to_plate / np.maximum(to_plate + to_border, 1e-12)


def default_edge(fabric: Fabric, rig: Rig) -> float:
    """Default edge length at the rim, m, for a fabric: 2, 2.5, 3 or 4 mm.

    The largest of which :data:`EDGES_PER_LENGTH` fit into the bending length (alpha/rho g)^⅓ of the
    softest direction, because softer cloth has narrower folds. The few values let drapes share
    meshes. Without a plate, the edge length of such a mesh at the hem: 8 to 16 mm.
    """
    length = np.cbrt(fabric.alpha.min() / (fabric.density * GRAVITY))
    fits = [edge for edge in DEFAULT_EDGES if EDGES_PER_LENGTH * edge <= length]
    edge = max(fits, default=min(DEFAULT_EDGES))
    return edge if rig.has_plate else GRADING * edge


def coarse_to_fine(edge: float, coarsest: float = MAX_COARSE_EDGE) -> list[float]:
    """Edge lengths at the rim, m, of a drape's meshes, each 2.5 times shorter than the previous;
    all but the last are at most ``coarsest``. InputError for an edge outside :data:`EDGE_RANGE`."""
    check_edge(edge)
    levels = [edge]
    while _REFINEMENT * levels[0] <= coarsest:
        levels.insert(0, _REFINEMENT * levels[0])
    return levels
