"""A skirt that hangs from a ring."""

import numpy as np
import pytest

from sim.draping import FINE_OPTIONS
from sim.equilibrium import find_equilibrium
from sim.material import MICRO, Fabric
from sim.rig import GRAVITY
from sim.skirt import SKIRT, skirt
from sim.solver.potential import forces


def test_the_ring_carries_the_weight_of_a_skirt():
    fabric = Fabric(np.full(3, 100 * MICRO))
    worn = skirt(fabric, edge=25e-3, seed=1)
    scene = worn.cloth.scene
    mesh, held = scene.mesh, scene.held
    assert scene.obstacles == ()
    # A polygon with the circle's area.
    assert np.allclose(np.linalg.norm(mesh.rest[held], axis=1), SKIRT.plate_radius, rtol=5e-3)
    found = find_equilibrium(scene, fabric, worn.state, options=FINE_OPTIONS)
    cloth, size = found.cloth, found.cloth.potential.unknowns
    elastic = forces([cloth.membrane, cloth.bending], found.state.q, size)
    vertical = elastic[2 : 3 * len(held) : 3]
    assert abs(vertical.sum()) < 1e-6 * abs(vertical[held].sum())
    # Of the annulus, without the share of the vertices in the ring.
    area = np.pi * (SKIRT.reach**2 - SKIRT.plate_radius**2) - mesh.vertex_areas[held].sum()
    assert vertical[held].sum() == pytest.approx(fabric.density * GRAVITY * area, rel=0.02)
    assert -1.01 * SKIRT.overhang < found.state.positions[:, 2].min() < -0.6 * SKIRT.overhang
