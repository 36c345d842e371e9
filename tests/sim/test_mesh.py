"""Meshes: topology, and specimens that follow the plate's rim, well shaped and of the sizes asked
for, alike under offsets."""

import numpy as np
import pytest
from vectors import angle_between

from common.errors import InputError
from sim.mesh import Mesh, strip
from sim.mesh.specimen import (
    GRADING,
    GROWTH,
    MAX_EDGE,
    MAX_SHARED_OFFSET,
    TOPOLOGIES,
    base_mesh,
)
from sim.rig import DISC_RIG, HUNG_SQUARE, Rig
from sim.scene import Scene, make_specimen

RECTANGLE = Rig.from_name("rectangle170x250_cylinder90")
ON_PLATE = pytest.mark.parametrize("rig", [Rig(), RECTANGLE, DISC_RIG], ids=lambda rig: rig.name)
EDGES = pytest.mark.parametrize("edge", [0.0025, 0.006, 0.012])


def smallest_angles(mesh: Mesh) -> np.ndarray:
    """(F,) degrees."""
    corners = mesh.rest[mesh.faces]
    along, back = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    return np.degrees(angle_between(along, back)).min(axis=1)


def lengths(mesh: Mesh) -> np.ndarray:
    """(E,) m."""
    return np.linalg.norm(np.diff(mesh.rest[mesh.edges], axis=1)[:, 0], axis=1)


def rim_and_border(specimen: Scene) -> tuple[np.ndarray, np.ndarray]:
    """(V,) bool each: held vertices with a free neighbour; vertices of the mesh's border."""
    mesh, held = specimen.mesh, specimen.held
    rim, border = np.zeros((2, len(held)), bool)
    across = mesh.edges[held[mesh.edges].sum(axis=1) == 1]
    rim[across] = True
    border[mesh.edges[mesh.edge_faces[:, 1] < 0]] = True
    return rim & held, border


@EDGES
@ON_PLATE
def test_the_rim_is_a_ring_of_edges_and_holds_the_plate_s_area(rig, edge):
    specimen = make_specimen(rig, edge=edge, topology=3, offset=(3e-3, -2e-3))
    mesh, held = specimen.mesh, specimen.held
    rim, _ = rim_and_border(specimen)
    radius = np.linalg.norm(mesh.rest, axis=1)
    assert np.allclose(radius[rim], radius[rim][0], rtol=1e-12)
    assert radius[held].max() <= radius[rim].max() and radius[~held].min() > radius[rim][0]
    # Round the ring, every two neighbours are joined: the edges between rim vertices that
    # separate held from active triangles are as many as the vertices, each of which has two.
    active = ~held[mesh.faces].all(axis=1)
    sides = np.where(mesh.edge_faces >= 0, active[mesh.edge_faces], False)
    ring = mesh.edges[rim[mesh.edges].all(axis=1) & (sides.sum(axis=1) == 1)]
    assert np.array_equal(np.bincount(ring.ravel(), minlength=len(rim)), 2 * rim)
    assert mesh.areas[~active].sum() == pytest.approx(np.pi * rig.plate_radius**2, rel=1e-12)
    # Beyond it, neither triangles nor edges between vertices of the rim alone.
    assert rim[mesh.faces[active]].sum(axis=1).max() == 2
    assert not (rim[mesh.edges].all(axis=1) & (sides.sum(axis=1) == 2)).any()


@EDGES
@ON_PLATE
def test_triangles_are_conforming_upright_and_well_shaped(rig, edge):
    free = []
    for topology in range(TOPOLOGIES):
        specimen = make_specimen(rig, edge=edge, topology=topology)
        mesh = specimen.mesh
        assert len(mesh.rest) - len(mesh.edges) + len(mesh.faces) == 1  # Euler's formula: a disc
        assert np.array_equal(np.unique(mesh.faces), np.arange(len(mesh.rest)))
        assert mesh.areas.min() > 0
        _, border = rim_and_border(specimen)
        if rig.specimen == "disc":
            assert np.allclose(np.linalg.norm(mesh.rest[border], axis=1), 0.15, atol=2e-9)
            assert mesh.areas.sum() == pytest.approx(rig.specimen_area, rel=2e-2 * (edge / 6e-3)**2)
        else:
            assert np.array_equal(rig.to_border(mesh.rest, (0, 0)) == 0, border)
            assert mesh.areas.sum() == pytest.approx(rig.sides[0] * rig.sides[1], rel=1e-12)
        assert smallest_angles(mesh).min() > 18
        free.append(smallest_angles(mesh)[~specimen.held[mesh.faces].all(axis=1)])
    free = np.concatenate(free)
    assert free.min() > 21 and (free < 30).mean() < 1e-2


@pytest.mark.parametrize("grading", [1.0, GRADING, 4.0])
@ON_PLATE
def test_edges_follow_the_sizes_asked_for(rig, grading):
    edge = 0.003
    specimen = make_specimen(rig, edge=edge, grading=grading)
    mesh = specimen.mesh
    outside = np.linalg.norm(mesh.rest[mesh.edges].mean(axis=1), axis=1) - rig.plate_radius
    wanted = np.minimum(edge + GROWTH * outside, min(grading * edge, MAX_EDGE))
    ratio = (lengths(mesh) / wanted)[outside > 0]
    assert ratio.mean() == pytest.approx(1, abs=0.05)
    assert 0.5 < ratio.min() and ratio.max() < 1.7
    rim, _ = rim_and_border(specimen)
    assert lengths(mesh)[rim[mesh.edges].all(axis=1)].min() == pytest.approx(edge, rel=0.02)
    if grading == GRADING and rig == DISC_RIG:  # the plate has few triangles
        on_plate = specimen.held[mesh.faces].all(axis=1).mean()
        assert on_plate < 0.6 * np.pi * 0.09**2 / rig.specimen_area


def test_edges_have_no_preferred_direction():
    """Means of exp(i n angle) are 1 for lattices of n directions; circles may show a little."""
    mesh = make_specimen(Rig(), edge=0.003).mesh
    steps = np.diff(mesh.rest[mesh.edges], axis=1)[:, 0]
    middles = mesh.rest[mesh.edges].mean(axis=1)
    radius = np.linalg.norm(middles, axis=1)
    beyond = (radius > 0.065) & (radius < 0.13)
    angle = np.arctan2(*steps[beyond].T[::-1])
    outwards = np.arctan2(*middles[beyond].T[::-1])
    for count in (2, 4, 6):
        assert abs(np.exp(1j * count * angle).mean()) < 0.1
        assert abs(np.exp(1j * count * (angle - outwards)).mean()) < (0.45 if count == 6 else 0.1)


@ON_PLATE
def test_offsets_move_the_border_and_keep_the_faces(rig):
    base = make_specimen(rig, edge=0.004, topology=2)
    limit = MAX_SHARED_OFFSET * rig.least_overhang
    offset = 0.999 * limit * np.array([0.6, -0.8])
    moved = make_specimen(rig, edge=0.004, topology=2, offset=tuple(offset))
    assert moved.mesh.faces is base.mesh.faces and np.array_equal(moved.held, base.held)
    step = moved.mesh.rest - base.mesh.rest
    _, border = rim_and_border(base)
    assert np.array_equal(step[base.held], np.zeros((base.held.sum(), 2)))
    assert np.allclose(step[border], offset, atol=1e-8)
    share = step @ offset / (offset @ offset)
    assert np.allclose(step, share[:, None] * offset, atol=1e-12)
    assert share.min() == 0 and share.max() < 1 + 1e-12
    assert moved.mesh.areas.min() > 0 and smallest_angles(moved.mesh).min() > 15
    assert np.array_equal(moved.mesh.edges, Mesh(moved.mesh.rest, moved.mesh.faces).edges)


@pytest.mark.parametrize(("name", "offset", "topologies", "least"), [
    ("square300_cylinder100", (0.078, 0.0), 1, 20),
    ("rectangle400x200_cylinder120", (0.0, 0.0), TOPOLOGIES, 18),
    ("rectangle140x400_cylinder60", (0.0, 0.0), TOPOLOGIES, 18),
    ("rectangle300x180_cylinder140", (0.0, 0.0), TOPOLOGIES, 18)])
def test_narrow_rectangles_and_large_offsets_have_well_shaped_meshes(
        name, offset, topologies, least):
    rig = Rig.from_name(name)
    half = np.array(rig.sides) / 2
    for topology in range(topologies):
        mesh = make_specimen(rig, edge=4e-3, topology=topology, offset=offset).mesh
        assert np.allclose([mesh.rest.min(0), mesh.rest.max(0)], [offset - half, offset + half],
                           atol=1e-12)
        assert smallest_angles(mesh).min() > least
        assert mesh.areas.sum() == pytest.approx(rig.specimen_area, rel=1e-12)


def test_a_rectangle_of_equal_sides_is_a_square_and_of_nearly_equal_ones_nearly_that():
    square = Rig()
    assert Rig((0.3, 0.3), 0.1, "rectangle") == square and square.specimen == "square"
    near = make_specimen(Rig((0.3, 0.3004), 0.1), edge=6e-3)
    mesh = make_specimen(square, edge=6e-3).mesh
    assert near.mesh.faces is mesh.faces
    step = near.mesh.rest - mesh.rest
    assert np.array_equal(step[:, 0], np.zeros(len(step)))
    assert np.ptp(near.mesh.rest[:, 1]) == pytest.approx(0.3004, rel=1e-12)
    assert np.abs(step[:, 1]).max() == pytest.approx(2e-4, rel=1e-9)


def test_a_scaled_rectangle_keeps_its_border_its_plate_and_its_faces():
    """Both sides of 170 mm x 250 mm scaled by factors of their own, cut at an angle and offset."""
    rig, offset = Rig((0.1712, 0.2512), 0.0904, cut=0.02), (2e-3, -1e-3)
    base, specimen = (make_specimen(one, edge=6e-3, topology=1, offset=at)
                      for one, at in ((RECTANGLE, (0, 0)), (rig, offset)))
    assert specimen.mesh.faces is base.mesh.faces
    _, border = rim_and_border(specimen)
    assert np.abs(rig.to_border(specimen.mesh.rest[border], offset)).max() < 1e-9
    assert specimen.mesh.areas.sum() == pytest.approx(0.1712 * 0.2512, rel=1e-9)
    held = specimen.held[specimen.mesh.faces].all(axis=1)
    assert specimen.mesh.areas[held].sum() == pytest.approx(np.pi * 0.0452**2, rel=1e-6)
    along = specimen.mesh.rest[border] @ [np.cos(0.02), np.sin(0.02)]
    assert np.ptp(along) == pytest.approx(0.1712, rel=1e-9)


def test_a_hung_square_has_even_edges_and_two_held_corners():
    specimen = make_specimen(HUNG_SQUARE, edge=0.015, grading=3.0)
    ratio = lengths(specimen.mesh) / 0.015
    assert ratio.mean() == pytest.approx(1, abs=0.05) and 0.5 < ratio.min() < ratio.max() < 1.7
    assert smallest_angles(specimen.mesh).min() > 23
    assert np.array_equal(specimen.mesh.rest[specimen.held], [[0.3, 0.3], [-0.3, 0.3]])


def test_same_topology_same_bytes_other_topology_other_mesh():
    first, other = (make_specimen(Rig(), edge=0.008, topology=t).mesh for t in (1, 2))
    base_mesh.cache_clear()
    again = make_specimen(Rig(), edge=0.008, topology=1).mesh
    assert again is not first
    assert again.rest.tobytes() == first.rest.tobytes()
    assert again.faces.tobytes() == first.faces.tobytes()
    assert other.rest.shape != first.rest.shape or not np.allclose(other.rest, first.rest)


def test_edge_tables_agree_with_the_faces():
    mesh, _ = strip(length=0.04, width=0.03, edge=0.01, clamp=0.01, diagonals="random")
    faces = len(mesh.faces)
    for face in range(faces):
        for corner in range(3):
            ends = set(mesh.faces[face]) - {mesh.faces[face, corner]}
            edge = mesh.face_edges[face, corner]
            assert set(mesh.edges[edge]) == ends
            assert face in mesh.edge_faces[edge]
            (other,) = set(mesh.edge_faces[edge]) - {face}
            sharing = [f for f in range(faces) if ends < set(mesh.faces[f]) and f != face]
            assert sharing == ([other] if other >= 0 else [])


def test_other_rest_points_share_the_topology_and_nothing_else():
    mesh, _ = strip(length=0.04, width=0.03, edge=0.01, clamp=0.01)
    area = mesh.areas.sum()
    wider = mesh.with_rest(mesh.rest * [1.0, 2.0])
    assert wider.edges is mesh.edges and wider.faces is mesh.faces
    assert wider.areas.sum() == pytest.approx(2 * area) and mesh.areas.sum() == area
    assert wider != mesh and len({mesh, wider}) == 2


def test_an_edge_of_three_triangles_is_refused():
    with pytest.raises(InputError, match="three triangles"):
        _ = Mesh(rest=np.zeros((5, 2)), faces=np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]])).edges


def test_strips_keep_their_area_and_the_column_of_the_clamp():
    mesh, held = strip(length=0.04, width=0.03, edge=0.01, clamp=0.02, jitter=0.2, seed=1)
    assert mesh.areas.min() > 0 and mesh.areas.sum() == pytest.approx(0.06 * 0.03, rel=1e-12)
    assert mesh.areas[held[mesh.faces].all(axis=1)].sum() == pytest.approx(0.02 * 0.03, rel=1e-12)
