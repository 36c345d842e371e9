"""Drapes that cost nothing, importable by worker processes."""

import os
import signal
import time
from types import SimpleNamespace

import numpy as np

from sim.cloth import Laws
from sim.mesh.specimen import TOPOLOGIES
from sim.scene import make_specimen

FAIL_SEED_MODULUS = 5  # the fake solver fails where the seed is a multiple


def cone(fabric, *, rig, edge, start, seed, offset, laws=None):
    """Cloth that slopes down from the plate, the steeper the softer; some fail, by their seed."""
    mesh = make_specimen(rig, edge=edge, topology=seed % TOPOLOGIES, offset=offset).mesh
    reach = np.maximum(np.linalg.norm(mesh.rest, axis=1) - rig.plate_radius, 0)
    slope = 1 / (1 + fabric.alpha.mean() / 20e-6)
    positions = np.column_stack([mesh.rest, -slope * reach])
    failed = seed % FAIL_SEED_MODULUS == 0
    return SimpleNamespace(
        status="max_iterations" if failed else "converged",
        converged=not failed,
        message="the fake gave up" if failed else "",
        positions=positions, rest=mesh.rest, faces=mesh.faces,
        outcome=SimpleNamespace(residual=0.5 if failed else 1e-5), iterations=seed % 50,
        laws=laws or Laws(),
    )


def lending_cone(fabric, *, rig, start=None, borrowed=None, **settings):
    """The same, that also starts from another drape: its sag is a tenth of the lender's more."""
    result = cone(fabric, rig=rig, start=start, **settings)
    if borrowed is not None:
        rest, positions = borrowed
        assert np.ptp(rest, axis=0).max() < 1.02 * rig.specimen_size
        result.positions[:, 2] *= 1 - 0.1 * positions[:, 2].min() / rig.specimen_size
    return result


def slow_lending_cone(fabric, **settings):
    """That one, slowly enough to be interrupted."""
    time.sleep(float(os.environ["DRAPE_TEST_PAUSE"]))
    return lending_cone(fabric, **settings)


def tangled(fabric, **settings):
    """The same, its first corner pulled through the cloth opposite to it, with every second."""
    result = cone(fabric, **settings)
    if settings["start"] == "fold":
        first, last = result.rest.sum(axis=1).argmin(), result.rest.sum(axis=1).argmax()
        result.positions[first] = result.positions[last] + [-0.03, -0.03, 0.05]
    return result


def overflowing(fabric, **settings):
    """A solver with a numerical accident."""
    raise FloatingPointError("overflow in the bending energy")


def exploding(fabric, **settings):
    """A solver whose drape, so it says, is metres wide."""
    result = cone(fabric, **settings)
    result.positions = result.positions * 10
    result.status, result.converged = "converged", True
    return result


def killed(fabric, **settings):
    """A solver whose process the system ends, as it does when memory runs out."""
    os.kill(os.getpid(), signal.SIGKILL)
