"""Outlines of drapes seen from above, and what is known of real ones."""

import numpy as np
import pytest

from data.dataset.off_axis import silhouette
from experiments.estimation.outlines_real import PARALLEL, features, radii_of
from sim.rig import Rig
from sim.scene import make_specimen


def test_the_outline_of_a_flat_square_is_the_square():
    mesh = make_specimen(Rig(), edge=0.006, grading=1).mesh
    flat = np.column_stack([mesh.rest, np.zeros(len(mesh.rest))])
    azimuth = 2 * np.pi * np.arange(360) / 360
    expected = 0.15 / np.maximum(np.abs(np.cos(azimuth)), np.abs(np.sin(azimuth)))
    # A hem 50 mm below the plate's plane looks 1/1.05 as large from 1 m.
    for depth, height, factor in ((0.0, PARALLEL, 1.0), (0.05, 1.0, 1.05)):
        seen = silhouette(flat - [0, 0, depth], mesh.edges, np.zeros(2), height, azimuths=360)
        assert np.allclose(seen, expected / factor, rtol=1e-9)


def test_the_mean_radius_of_an_outline_is_its_coefficient():
    azimuths = 2 * np.pi * np.arange(170) / 170
    radii = radii_of(0.12 * np.column_stack([np.cos(azimuths), np.sin(azimuths)]))
    found = features(radii[None])[0]
    assert found[0] == pytest.approx((0.12**2 - 0.09**2) / (0.15**2 - 0.09**2), rel=1e-6)
    assert found[1] == 0
