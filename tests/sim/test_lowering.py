"""Cloth lowered over its plate: any tester, number of folds, and failure as data."""

import numpy as np
import pytest

from sim.cloth import Laws
from sim.drape import drape
from sim.energies.external import Gravity
from sim.material import Fabric
from sim.measures import fold_count
from sim.rig import DISC_RIG, GRAVITY, Rig
from sim.solver.newton import Status

SOFT = Fabric(np.full(3, 20e-6))


@pytest.mark.parametrize("rig", [Rig(0.2, 0.06, "disc"), Rig(0.4, 0.2, "square")],
                         ids=lambda rig: rig.name)
def test_small_and_large_specimens_are_lowered(rig: Rig) -> None:
    result = drape(SOFT, rig=rig, edge=8e-3, start="lowered", seed=1)
    assert result.converged, result.message
    assert result.positions[:, 2].min() < -0.2 * (rig.specimen_size - rig.plate_diameter)


@pytest.mark.slow
def test_lowered_discs_have_more_folds_than_discs_from_rings() -> None:
    """Their numbers scatter by 0.6 and 1.5."""
    folds = {}
    for start, count in (("lowered", 3), ("ring", 12)):
        drapes = [drape(SOFT, rig=DISC_RIG, edge=6e-3, start=start, seed=seed)
                  for seed in range(count)]
        assert all(one.converged for one in drapes)
        folds[start] = np.mean([fold_count(one.positions, one.rest, DISC_RIG) for one in drapes])
    assert folds["lowered"] > folds["ring"] + 0.5


def test_a_time_step_that_fails_is_a_status() -> None:
    class Broken(Gravity):
        """A weight without a value."""

        def value(self, q: np.ndarray) -> float:
            return np.nan

    def law(mesh, active, *, fabric):
        return Broken(mesh, density=fabric.density, gravity=GRAVITY)

    result = drape(SOFT, edge=0.012, laws=Laws(others=(law,)))
    assert result.status is Status.NOT_FINITE and result.coarse == (Status.NOT_FINITE,)
