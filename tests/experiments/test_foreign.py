"""Cloth in Newton's Style3D, if it is installed."""

import numpy as np
import pytest

from experiments.physics import style3d
from sim.draping import drape
from sim.material import MICRO, Fabric


@pytest.mark.slow
@pytest.mark.skipif(not style3d.installed(), reason=f"needs Newton: {style3d.INSTALL}")
def test_style3d_cloth_drops_without_penetrating_the_cylinder():
    shape = drape(Fabric([80 * MICRO] * 3), edge=4e-3, seed=1)
    found = style3d.simulate(shape.scene, shape.positions, density=0.3, modulus=[20 * MICRO] * 3,
                             seconds=0.5)
    held = shape.positions[shape.held]
    assert np.array_equal(found.positions[shape.held], held.astype(np.float32))
    below = found.positions[:, 2] < -2e-3
    assert np.hypot(*found.positions[below, :2].T).min() > shape.rig.plate_radius - 5e-4
    assert found.positions[:, 2].mean() < shape.positions[:, 2].mean() - 1e-3
