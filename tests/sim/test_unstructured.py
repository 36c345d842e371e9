"""Unstructured meshes: well-shaped, conforming, without a preferred direction, reproducible."""

import numpy as np
import pytest

from common.errors import InputError
from sim.mesh import Mesh
from sim.unstructured import unstructured_disc, unstructured_square, unstructured_strip

RADIUS = {"square": 0.05, "disc": 0.09}


def specimen(shape: str, edge: float, seed: int = 0) -> tuple[Mesh, np.ndarray]:
    offset = tuple(np.random.default_rng(seed).normal(0, 3e-3, 2))
    settings = {"edge": edge, "plate_radius": RADIUS[shape], "offset": offset, "seed": seed}
    if shape == "disc":
        return unstructured_disc(diameter=0.3, **settings)
    return unstructured_square(size=0.3, **settings)


def smallest_angle(mesh: Mesh) -> float:
    """Degrees."""
    corners = mesh.rest[mesh.faces]
    along, back = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    cosine = (along * back).sum(-1) / np.linalg.norm(along, axis=-1) / np.linalg.norm(back, axis=-1)
    return float(np.degrees(np.arccos(cosine)).min())


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("edge", [0.02, 0.012, 0.007])
@pytest.mark.parametrize("shape", ["square", "disc"])
def test_triangles_are_well_shaped_and_of_the_size_asked_for(shape, edge, seed):
    mesh, _ = specimen(shape, edge, seed)
    assert smallest_angle(mesh) > 25
    lengths = np.linalg.norm(np.diff(mesh.rest[mesh.edges], axis=1), axis=-1)
    assert lengths.mean() == pytest.approx(edge, rel=0.09)
    assert lengths.max() < 1.6 * edge and lengths.min() > 0.6 * edge
    around = round(np.pi * 0.3 / edge)
    area = 0.15**2 * around / 2 * np.sin(2 * np.pi / around) if shape == "disc" else 0.3**2
    assert mesh.areas.min() > 0 and mesh.areas.sum() == pytest.approx(area, rel=1e-9)


@pytest.mark.parametrize("shape", ["square", "disc"])
def test_mesh_follows_the_rim(shape):
    mesh, held = specimen(shape, 0.01, seed=4)
    radius = np.linalg.norm(mesh.rest, axis=1)
    inside, outside = radius < RADIUS[shape] - 1e-9, radius > RADIUS[shape] + 1e-9
    assert np.array_equal(held, ~outside)
    assert not (inside[mesh.faces].any(axis=1) & outside[mesh.faces].any(axis=1)).any()
    rim = held & ~inside
    angle = 2 * np.pi / rim.sum()
    polygon = rim.sum() / 2 * RADIUS[shape] ** 2 * np.sin(angle)
    assert mesh.areas[held[mesh.faces].all(axis=1)].sum() == pytest.approx(polygon, rel=1e-9)


def test_edges_have_no_preferred_direction():
    mesh, _ = specimen("square", 0.007, seed=1)
    steps = np.diff(mesh.rest[mesh.edges], axis=1)[:, 0]
    middle = np.linalg.norm(mesh.rest[mesh.edges].mean(axis=1), axis=1)
    angle = np.arctan2(steps[:, 1], steps[:, 0])[(middle > 0.06) & (middle < 0.13)]
    # 1 for a triangular lattice or a grid, respectively.
    assert abs(np.exp(6j * angle).mean()) < 0.2 and abs(np.exp(4j * angle).mean()) < 0.1


@pytest.mark.parametrize("edge", [0.01, 0.005])
def test_strip_has_its_clamp_on_a_line(edge):
    mesh, held = unstructured_strip(length=0.09, width=0.03, edge=edge, clamp=0.02, seed=3)
    assert smallest_angle(mesh) > 25
    assert mesh.areas.sum() == pytest.approx(0.11 * 0.03, rel=1e-9)
    assert np.array_equal(held, mesh.rest[:, 0] < 1e-9)
    assert mesh.areas[held[mesh.faces].all(axis=1)].sum() == pytest.approx(0.02 * 0.03, rel=1e-9)
    assert np.isclose(mesh.rest[:, 0], 0.09).sum() == round(0.03 / edge) + 1


def test_same_seed_same_mesh_other_seed_other_mesh():
    first, second, other = (specimen("disc", 0.015)[0], specimen("disc", 0.015)[0],
                            unstructured_disc(diameter=0.3, edge=0.015, plate_radius=0.09, seed=9))
    assert np.array_equal(first.rest, second.rest) and np.array_equal(first.faces, second.faces)
    assert other[0].rest.shape != first.rest.shape or not np.allclose(other[0].rest, first.rest)


def test_edges_longer_than_the_overhang_are_refused():
    with pytest.raises(InputError, match="too long"):
        unstructured_disc(diameter=0.2, edge=0.03, plate_radius=0.095)
