"""Outlines of drapes seen from above, and what is known of real ones."""

import numpy as np
import pytest

from experiments.estimation.outlines_real import features, radii_of
from sim.measures import shadow_radius
from sim.mesh import Mesh
from sim.rig import Rig
from sim.scene import make_specimen


def test_shadow_of_a_flat_square_is_the_square():
    mesh = make_specimen(Rig(), edge=0.006, grading=1).mesh
    flat = np.column_stack([mesh.rest, np.zeros(len(mesh.rest))])
    azimuth = 2 * np.pi * np.arange(360) / 360
    expected = 0.15 / np.maximum(np.abs(np.cos(azimuth)), np.abs(np.sin(azimuth)))
    assert np.allclose(shadow_radius(flat, mesh), expected, rtol=1e-9)
    # A hem 50 mm below the plate's plane looks 1/1.05 as large from 1 m.
    lower = flat - [0, 0, 0.05]
    assert np.allclose(shadow_radius(lower, mesh, height=1.0), expected / 1.05, rtol=1e-9)


def test_shadow_of_cloth_folded_under_is_its_outermost_part():
    """A band whose hem runs around the axis twice, once inside and once outside."""
    angle = 2 * np.pi * np.arange(60) / 60
    rings = [radius * np.column_stack([np.cos(angle), np.sin(angle)]) for radius in (0.1, 0.2)]
    inner = np.arange(60)
    outer, after = inner + 60, np.roll(inner, -1)
    faces = np.concatenate([np.column_stack([inner, outer, after + 60]),
                            np.column_stack([inner, after + 60, after])])
    mesh = Mesh(np.concatenate(rings), faces)
    # Draped with the circles exchanged, so that the rest's border is inside.
    positions = np.column_stack([np.concatenate(rings[::-1]), np.zeros(120)])
    radius = shadow_radius(positions, mesh, points=60)
    assert np.allclose(radius, 0.2)


def test_the_mean_radius_of_an_outline_is_its_coefficient():
    azimuths = 2 * np.pi * np.arange(170) / 170
    radii = radii_of(0.12 * np.column_stack([np.cos(azimuths), np.sin(azimuths)]))
    found = features(radii[None])[0]
    assert found[0] == pytest.approx((0.12**2 - 0.09**2) / (0.15**2 - 0.09**2), rel=1e-6)
    assert found[1] == 0
