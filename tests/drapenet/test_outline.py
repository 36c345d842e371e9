"""Outlines of drapes by azimuth."""

import numpy as np
import pytest

from drapenet.report.drape import resimulate_outline
from drapenet.views.directions import AZIMUTHS
from drapenet.views.outline import DrapeOutline, contour, outline_of_curve, silhouettes
from sim.draping import drape
from sim.material import MICRO, Fabric
from sim.measures import drape_coefficient
from sim.mesh import Mesh
from sim.rig import DISC_RIG, SQUARE_RIG, Rig
from sim.scene import make_specimen
from sim.start import LOWERED

ANGLE = np.linspace(0, 2 * np.pi, 400, endpoint=False)


def test_the_radius_of_a_curve_runs_from_azimuth_zero() -> None:
    radius = 0.12 + 0.01 * np.cos(2 * (ANGLE - 0.4))
    curve = radius[:, None] * np.column_stack([np.cos(ANGLE), np.sin(ANGLE)])
    azimuth = (np.arange(AZIMUTHS) + 0.5) * 2 * np.pi / AZIMUTHS
    outline = outline_of_curve(curve, zero=0.4)
    np.testing.assert_allclose(outline.radius, 0.12 + 0.01 * np.cos(2 * azimuth), atol=1e-4)


def test_a_flat_specimen_covers_all_of_its_area() -> None:
    for rig in (DISC_RIG, SQUARE_RIG, Rig((0.17, 0.25), 0.09)):
        x, y = (np.array(rig.sides) / 2)[:, None] / np.maximum(
            np.abs([np.cos(ANGLE), np.sin(ANGLE)]), 1e-12)
        radius = np.full(len(ANGLE), 0.15) if rig.specimen == "disc" else np.minimum(x, y)
        curve = radius[:, None] * np.column_stack([np.cos(ANGLE), np.sin(ANGLE)])
        assert outline_of_curve(curve).coefficient(rig) == pytest.approx(1.0, abs=0.01)


def test_half_an_outline_has_no_drape_coefficient() -> None:
    radius = np.where(np.arange(AZIMUTHS) < AZIMUTHS * 0.45, 0.12, np.nan)
    assert np.isnan(DrapeOutline(radius).coefficient(DISC_RIG))


def test_a_low_hem_looks_smaller_to_a_camera() -> None:
    """A cone whose hem is 50 mm below the plate: 6 mm smaller from 1 m (similar triangles)."""
    mesh = make_specimen(DISC_RIG, edge=8e-3).mesh
    radius = np.linalg.norm(mesh.rest, axis=1)
    slope = 0.05 / radius.max()
    cone = np.column_stack([mesh.rest, -slope * radius])
    parallel, near = silhouettes(cone, mesh.edges, np.array([np.inf, 1.0]), zero=0.0)
    np.testing.assert_allclose(near, parallel / 1.05, rtol=1e-3)
    assert (parallel - near).mean() == pytest.approx(7.1e-3, abs=1e-3)


def test_an_outline_from_above_is_that_of_the_contour(skirted) -> None:
    """From any height down to the lowest, against all edges; also where the hem is tucked under."""
    mesh, heights = Mesh(skirted.rest, skirted.faces), np.array([np.inf, 1.0, 0.5, 0.4])
    depth = skirted.positions[:, 2:] / skirted.positions[:, 2].min()
    tucked = skirted.positions * np.where([True, True, False], 1 - 0.5 * depth**3, 1.0)
    for positions in (skirted.positions, tucked):
        edges = contour(positions, mesh, 0.4)
        np.testing.assert_array_equal(*(silhouettes(positions, used, heights, zero=0.2)
                                        for used in (edges, mesh.edges)))
        hem = mesh.edges[mesh.edge_faces[:, 1] < 0]
        assert len(hem) <= len(edges) < 0.4 * len(mesh.edges)
    of_hem = silhouettes(tucked, hem, heights, zero=0.2)
    assert (silhouettes(tucked, edges, heights, zero=0.2) - of_hem).mean() > 2e-3


def test_lowered_cloth_is_shown_beside_a_photograph_whose_perspective_is_corrected() -> None:
    fabric = Fabric(np.array([30, 20, 25]) * MICRO, np.zeros(3))
    seen = drape(fabric, rig=DISC_RIG, edge=9e-3, start=LOWERED, seed=0)
    radius, = silhouettes(seen.positions, seen.mesh.edges, np.array([1.0]), zero=0.3)
    photograph = DrapeOutline(radius, 1.0)
    found = resimulate_outline(fabric, photograph, DISC_RIG, edge=9e-3, drapes=1)
    np.testing.assert_array_equal(found.drape.positions, seen.positions)
    coefficient = drape_coefficient(seen.positions, seen.faces, DISC_RIG)
    assert photograph.coefficient(DISC_RIG) < coefficient - 0.05
    assert photograph.corrected(DISC_RIG).coefficient(DISC_RIG) == pytest.approx(
        coefficient, abs=0.015)
    unknown = DrapeOutline(radius, np.nan)
    assert unknown.corrected(DISC_RIG) is unknown
    assert found.overlap > 0.95 and not found.warnings(coefficient)
    for captured, count in ((found.coefficient + 0.14, 0), (found.coefficient - 0.16, 1),
                            (np.nan, 0)):
        assert [one.code for one in found.warnings(captured)] == ["coefficient_differs"] * count
