"""The mesh of a rig's specimen: how fine, where the specimen lies, which vertices are held."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from common.errors import InputError
from sim.material import Fabric
from sim.mesh.graded import Outline, graded_mesh
from sim.mesh.topology import Mesh
from sim.scene import GRAVITY, Rig

TOPOLOGIES = 8
"""Meshes of one size, alike but for their random numbers; drapes share them."""
GRADING = 4.0
"""Edges at the hem over edges at the rim."""
LONGEST = 0.020
"""Length, m, to which edges grow at most, so that coarse meshes hold the folds of a start."""
DEFAULT_EDGES = (2e-3, 2.5e-3, 3e-3, 4e-3)  # m, see :func:`default_edge`
EDGES_PER_LENGTH = 6.5
_STEP = 2.5  # of the edges' length from one mesh of a drape to the next
COARSEST = 0.013
"""Longest edges at the rim, m, that a drape is started on."""
BORROWED_COARSEST = 0.008
"""The same for a borrowed drape, whose folds have to survive."""
EDGES = (5e-4, 5e-2)
"""Lengths of edges at the rim, m: least, for memory and time; most, for a plate of its shape."""
SHARED_OFFSET = 0.2
"""Largest offset, in widths of the overhang, that moves a base mesh; beyond it, triangles on the
narrow side would lose more than a fifth of their width, and a mesh is made for the offset."""
_ROOM = 2.0  # edges between rim and border, at least
_SIZES = 5e-3  # m: a mesh is made for whole multiples of it
_STRETCH = 0.03  # largest change of such a mesh's size, or of its plate's, that moves its points


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

    Specimens of nearly one size, and those with an offset up to :data:`SHARED_OFFSET`, share the
    faces of a base mesh and differ in its points: the plate's move with the plate, those of the
    border with the border, others in proportion.

    Args:
        edge: length of the edges at the plate's rim, m, within :data:`EDGES`. Without a plate,
            of all edges.
        topology: which of the :data:`TOPOLOGIES` random meshes.
        offset: specimen's centre from the plate's axis, m.
        grading: edges at the hem over ``edge``, at least 1; they grow by 10 % per edge until
            then, or to :data:`LONGEST`. Edges on the plate grow faster, they store no energy.
    """
    _check(rig, edge, topology, offset, grading)
    overhang = (rig.specimen_size - rig.plate_diameter) / 2
    # In the axes of the sides, from which the warp may be off.
    way = np.asarray(offset, dtype=float) @ rig.sides
    shared = np.hypot(*way) <= SHARED_OFFSET * overhang
    base = _base_rig(rig)
    specimen = _base_specimen(base, float(edge), int(topology),
                              (0.0, 0.0) if shared else tuple(way.tolist()), float(grading))
    if rig == base and not (shared and way.any()):
        return specimen
    rest = specimen.mesh.rest
    share = np.where(specimen.held, 0.0, share_of_offset(rest, base, (0, 0) if shared else way))
    if rig.has_plate:
        plate = rig.plate_diameter / base.plate_diameter
        border = rig.specimen_size / base.specimen_size
        rest = rest * (plate + (border - plate) * share)[:, None]
    if shared:
        rest = rest + share[:, None] * way
    return Specimen(specimen.mesh.with_rest(rest @ rig.sides.T), specimen.held)


def _base_rig(rig: Rig) -> Rig:
    """The rig whose meshes serve ``rig``: of whole sizes, cut along the yarns."""
    if not rig.has_plate:
        return rig
    sizes = np.array([rig.specimen_size, rig.plate_diameter])
    whole = np.round(_SIZES * np.round(sizes / _SIZES), 6)
    near = (np.abs(whole - sizes) <= _STRETCH * sizes).all()
    return Rig(*(whole if near else sizes).tolist(), specimen=rig.specimen)


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
        raise InputError(f"an overhang of {1e3 * _ROOM * longest:.3g} mm at its narrowest is too "
                         f"narrow for edges of {1e3 * edge:.3g} mm, which need "
                         f"{1e3 * _ROOM * edge:.3g} mm; reduce the offset or refine")


def longest_edge(rig: Rig, offset: tuple[float, float]) -> float:
    """Length, m, of edges at the rim above which an overhang is too narrow for a mesh."""
    if not rig.has_plate:
        return np.inf
    way = np.hypot(*offset) if rig.specimen == "disc" else np.abs(offset).max()
    return ((rig.specimen_size - rig.plate_diameter) / 2 - way) / _ROOM


def check_edge(edge: float) -> None:
    """InputError for a length of edges at the rim, m, that no mesh has (:data:`EDGES`)."""
    least, most = EDGES
    if not least <= edge <= most:
        raise InputError(f"edge={1e3 * edge:g} mm at the rim must lie between {1e3 * least:g} and "
                         f"{1e3 * most:g} mm")


@lru_cache(maxsize=128)
def _base_specimen(
    rig: Rig, edge: float, topology: int, centre: tuple[float, float], grading: float
) -> Specimen:
    """A specimen around ``centre``, triangulated for that place."""
    largest = max(edge, min(grading * edge, LONGEST))
    mesh, count = graded_mesh(Outline(rig, centre, edge, largest), np.random.default_rng(topology))
    if rig.has_plate:
        return Specimen(mesh, np.arange(len(mesh.rest)) < count)
    corners = np.array([[-0.5, 0.5], [0.5, 0.5]]) * rig.specimen_size
    return Specimen(mesh, (mesh.rest[:, None] == corners).all(axis=2).any(axis=1))


def share_of_offset(
    rest: np.ndarray, rig: Rig, centre: np.ndarray | tuple[float, float] = (0.0, 0.0)
) -> np.ndarray:
    """Share (V,) of an offset's change that moves points (V, 2) m of a specimen around ``centre``:
    zero on the plate, one on the border, in proportion between them."""
    to_plate, to_border = rig.to_plate(rest), np.maximum(rig.to_border(rest, centre), 0.0)
    return to_plate / np.maximum(to_plate + to_border, 1e-12)


def default_edge(fabric: Fabric, rig: Rig) -> float:
    """Edge length at the rim, m, that suits the fabric: 2, 2.5, 3 or 4 mm.

    The longest that goes :data:`EDGES_PER_LENGTH` times into the bending length (alpha/rho g)^⅓ of
    the softest direction, because softer cloth makes narrower folds; few, so that drapes share
    meshes. Without a plate, what such a mesh has at the hem: 8 to 16 mm.
    """
    length = np.cbrt(fabric.alpha.min() / (fabric.density * GRAVITY))
    fits = [edge for edge in DEFAULT_EDGES if EDGES_PER_LENGTH * edge <= length]
    edge = max(fits, default=min(DEFAULT_EDGES))
    return edge if rig.has_plate else GRADING * edge


def coarse_to_fine(edge: float, coarsest: float = COARSEST) -> list[float]:
    """Edges at the rim, m, of a drape's meshes, each time 2.5 times shorter; none but
    the last is above ``coarsest``. InputError for an edge out of :data:`EDGES`."""
    check_edge(edge)
    levels = [edge]
    while _STEP * levels[0] <= coarsest:
        levels.insert(0, _STEP * levels[0])
    return levels
