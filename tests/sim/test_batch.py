"""Drapes made by worker processes are those made one by one; a failure spoils its own only."""

import os
import signal

import numpy as np
import pytest

from common.errors import InputError
from sim.batch import drape_batch
from sim.drape import drape
from sim.laws import Laws
from sim.material import Fabric
from sim.mesh.specimens import TOPOLOGIES, coarse_to_fine
from sim.solver.newton import NewtonOptions, Status

FABRICS = [Fabric(np.array(a) * 1e-6, -1.5e-3 * np.array(a) * 1e-6)
           for a in ([60, 40, 30], [150, 150, 150], [120, 90, 100])]
SAME = [0, TOPOLOGIES, 2 * TOPOLOGIES]  # seeds of one topology and different starts
EDGE = 0.014
TIGHT = NewtonOptions(residual=1e-7, step=1e-6, max_iterations=300)
ABSURD = Fabric(np.full(3, 30e-6))
object.__setattr__(ABSURD, "alpha", np.full(3, 1e300))  # its energy overflows


def test_a_narrow_overhang_leaves_out_coarse_meshes():
    offsets = [(0.078, 0.0), (0.0, 0.0)]
    made = drape_batch(FABRICS[:2], edge=0.006, offsets=offsets, seeds=SAME[:2], workers=1)
    assert [len(r.coarse) for r in made] == [0, len(coarse_to_fine(0.006)) - 1]
    assert all(result.converged for result in made)


@pytest.mark.parametrize(("arguments", "word"), [
    ({"starts": ["sine"]}, "start has 1 entries for 3 fabrics"),
    ({"seeds": [0, 1, -2]}, "seed=-2"), ({"starts": "flat"}, "flat"),
    ({"offsets": [(0, np.nan)] * 3}, "finite"), ({"workers": 0}, "workers=0"),
    ({"edge": 1e-6, "workers": 1}, "edge=0.001 mm"), ({"rig": "square"}, "rig='square'"),
])
def test_mistakes_are_named(arguments, word):
    with pytest.raises(InputError, match=word):
        drape_batch(FABRICS, **({"edge": EDGE} | arguments))


def test_worker_processes_make_the_same_drapes():
    fabrics = [*FABRICS[:2], ABSURD]
    edges = [EDGE, 0.02, EDGE]
    made = drape_batch(fabrics, edge=edges, seeds=SAME, starts=["fold"] * 3, options=TIGHT,
                       workers=2)
    for seed, fabric, edge, result in zip(SAME, fabrics, edges, made, strict=True):
        alone = drape(fabric, edge=edge, seed=seed, start="fold", options=TIGHT)
        assert result.fabric == fabric and result.edge == edge
        assert result.status is alone.status and result.message == alone.message
        if fabric is not ABSURD:
            assert np.abs(result.positions - alone.positions).max() < 1e-8
    assert made[2].status is Status.NOT_FINITE


def test_no_fabrics_no_drapes():
    assert drape_batch([]) == []


def killed(mesh, active, *, fabric):
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_worker_that_is_killed_is_reported():
    with pytest.raises(InputError, match="was killed"):
        drape_batch(FABRICS, edge=EDGE, workers=2, laws=Laws(others=(killed,)))
