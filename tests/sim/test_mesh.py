"""Specimen meshes: counted, covered, conforming."""

import numpy as np
import pytest

from common.errors import InputError
from sim.mesh import Mesh, draped_square, grid_faces, strip

RADIUS = 0.05


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("resolution", [16, 26, 51])
def test_plate_is_held_exactly(resolution, seed):
    offset = tuple(np.random.default_rng(seed).normal(0, 3e-3, 2))
    mesh, held, _ = draped_square(
        size=0.3, plate_radius=RADIUS, resolution=resolution, offset=offset, seed=seed
    )
    radius = np.linalg.norm(mesh.rest, axis=1)
    assert np.array_equal(held, radius < RADIUS + 1e-9)
    inside, outside = radius < RADIUS - 1e-9, radius > RADIUS + 1e-9
    straddling = inside[mesh.faces].any(axis=1) & outside[mesh.faces].any(axis=1)
    assert not straddling.any()
    # The held triangles fill the polygon through the rim's vertices.
    rim = np.flatnonzero(held & ~inside)
    angles = np.sort(np.arctan2(*mesh.rest[rim].T))
    gaps = np.diff(np.append(angles, angles[0] + 2 * np.pi))
    polygon = 0.5 * RADIUS**2 * np.sin(gaps).sum()
    assert mesh.areas[held[mesh.faces].all(axis=1)].sum() == pytest.approx(polygon, rel=1e-9)
    assert polygon == pytest.approx(np.pi * RADIUS**2, rel=2.5e-2 * (26 / resolution) ** 2)


@pytest.mark.parametrize("seed", range(5))
def test_triangles_are_upright_and_not_slivers(seed):
    mesh, _, _ = draped_square(size=0.3, plate_radius=RADIUS, resolution=51, seed=seed)
    assert mesh.areas.min() > 0
    corners = mesh.rest[mesh.faces]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    quality = 4 * np.sqrt(3) * mesh.areas / (sides**2).sum(axis=1)  # 1 when equilateral
    assert quality.min() > 0.25
    assert mesh.areas.sum() == pytest.approx(0.3**2, rel=1e-12)
    assert mesh.vertex_areas.sum() == pytest.approx(0.3**2, rel=1e-12)


def test_offset_moves_the_specimen_not_the_plate():
    mesh, _, _ = draped_square(size=0.3, plate_radius=RADIUS, resolution=21, offset=(0.01, -0.02))
    assert np.allclose(mesh.rest.min(0), [-0.14, -0.17])
    assert np.allclose(mesh.rest.max(0), [0.16, 0.13])


def test_edge_tables_agree_with_the_faces():
    mesh, _ = strip(length=0.04, width=0.03, edge=0.01, clamp=0.01, diagonals="random")
    vertices, faces, edges = len(mesh.rest), len(mesh.faces), len(mesh.edges)
    assert vertices - edges + faces == 1  # Euler's formula for a disc
    for face in range(faces):
        for corner in range(3):
            ends = set(mesh.faces[face]) - {mesh.faces[face, corner]}
            edge = mesh.face_edges[face, corner]
            assert set(mesh.edges[edge]) == ends
            assert face in mesh.edge_faces[edge]
            across = mesh.neighbours[face, corner]
            if across < 0:
                assert mesh.edge_faces[edge, 1] == -1
            else:
                (other,) = set(mesh.edge_faces[edge]) - {face}
                assert set(mesh.faces[other]) == ends | {across}


def test_diagonals_give_the_faces_back():
    mesh, _, cells = draped_square(size=0.3, plate_radius=RADIUS, resolution=21, seed=4)
    assert np.array_equal(grid_faces(cells), mesh.faces)
    assert cells.any() and not cells.all()


def test_same_seed_same_mesh_other_seed_other_mesh():
    first, second, other = (
        draped_square(size=0.3, plate_radius=RADIUS, resolution=21, seed=s)[0] for s in (1, 1, 2)
    )
    assert np.array_equal(first.rest, second.rest)
    assert not np.array_equal(first.rest, other.rest)


@pytest.mark.parametrize(
    ("change", "word"),
    [({"resolution": 5}, "resolution=5"), ({"offset": (0.1, 0.0)}, "offset"),
     ({"diagonals": "wavy"}, "wavy")],
)
def test_impossible_meshes_are_refused(change, word):
    arguments = {"size": 0.3, "plate_radius": RADIUS, "resolution": 21} | change
    with pytest.raises(InputError, match=word):
        draped_square(**arguments)


def test_three_triangles_on_an_edge_are_no_surface():
    with pytest.raises(InputError, match="three triangles"):
        _ = Mesh(rest=np.zeros((5, 2)), faces=np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]])).edges
