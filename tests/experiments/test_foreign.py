"""Study of drapes of other simulators, with Style3D if installed."""

import numpy as np
import pytest

from data.fabrics.fabrics import from_theta, to_theta
from experiments.papers import optimisers
from experiments.physics import style3d
from sim.drape import drape
from sim.material import MICRO, Fabric
from sim.scene import Scene

THETA = to_theta(np.array([60.0, 40.0, 20.0]) * MICRO, np.array([-120.0, -80.0, -40.0]) * 1e-9)


def test_the_isotropic_mean_is_equal_in_all_directions_and_between_the_moduli():
    alpha, beta = from_theta(optimisers.isotropic_mean(THETA))
    assert np.ptp(alpha) == np.ptp(beta) == 0 and 20 * MICRO < alpha[0] < 60 * MICRO
    assert beta / alpha == pytest.approx(-2e-3)
    again = optimisers.isotropic_mean(to_theta(alpha, beta))
    assert again == pytest.approx(to_theta(alpha, beta))


def test_registration_to_the_same_mesh_is_exact_and_to_another_mesh_close():
    shape = drape(Fabric([60 * MICRO] * 3), edge=8e-3, seed=1)
    same, other = (optimisers.register(shape, shape.positions, shape.fabric, topology, 8e-3)
                   for topology in (1, 2))
    assert np.abs(same.positions - shape.positions).max() < 1e-6
    assert not np.array_equal(other.rest, shape.rest)
    lowest = [one.positions[:, 2].min() for one in (shape, other)]
    assert lowest[0] == pytest.approx(lowest[1], abs=2e-3)
    assert np.abs(other.positions[other.held, 2]).max() == 0


@pytest.mark.slow
def test_a_search_reduces_the_error_of_its_start():
    found = optimisers.case(number=0, target="plate", edge_mm=8.0, seconds=0.0, simulations=5,
                            simulations_free=5, seed=910)
    for way in found["ways"].values():
        assert 0 < way["simulations"] <= 5 and len(way["trace"]) >= 1
    lm = found["ways"]["lm"]
    assert np.mean(np.square(lm["alpha"])) < np.mean(np.square(found["start"]))


@pytest.mark.slow
@pytest.mark.skipif(not style3d.installed(), reason=f"needs Newton: {style3d.INSTALL}")
def test_style3d_cloth_drops_without_penetrating_the_cylinder():
    shape = drape(Fabric([80 * MICRO] * 3), edge=4e-3, seed=1)
    found = style3d.simulate_drape(Scene(shape.mesh, shape.held), shape.positions, shape.rig,
                                   density=0.3, modulus=[20 * MICRO] * 3, seconds=0.5)
    held = shape.positions[shape.held]
    assert np.array_equal(found.positions[shape.held], held.astype(np.float32))
    below = found.positions[:, 2] < -2e-3
    assert np.hypot(*found.positions[below, :2].T).min() > shape.rig.plate_radius - 5e-4
    assert found.positions[:, 2].mean() < shape.positions[:, 2].mean() - 1e-3
