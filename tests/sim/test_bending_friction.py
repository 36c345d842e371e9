"""Friction in bent cloth: a weightless strip unbends no further than friction lets it."""

import numpy as np
import pytest
from scipy.optimize import brentq

from common.errors import InputError
from sim.energies.bending_friction import BendingFriction
from sim.energies.midedge import MidEdgeBending
from sim.energies.natural_curvature import NaturallyCurved
from sim.equilibrium import find_equilibrium
from sim.laws import Laws
from sim.material import Fabric
from sim.mesh import strip
from sim.newton import NewtonOptions
from sim.scene import Scene
from sim.state import State

ALPHA, BENT = 30e-6, 15.0  # N·m, 1/m: a torque of 4.5e-4 N
FABRIC = Fabric(np.full(3, ALPHA))
OPTIONS = NewtonOptions(residual=1e-4, step=1e-6)


@pytest.fixture(scope="module")
def arc() -> tuple[Scene, State]:
    """A strip at rest in a circular arc, level where it is clamped."""
    mesh, held = strip(length=0.06, width=0.012, edge=0.003, clamp=0.006)
    scene = Scene(mesh=mesh, held=held, gravity=0.0)
    flat = scene.state(np.column_stack([mesh.rest, np.zeros(len(mesh.rest))]))
    found = find_equilibrium(
        scene, FABRIC, flat, laws=Laws(bending=NaturallyCurved((BENT, 0.0, 0.0))),
        options=OPTIONS)
    assert found.converged
    return scene, found.state


@pytest.mark.parametrize("torque", [1e-4, 3e-4, 6e-4])
def test_strip_unbends_until_friction_holds_its_torque(
    arc: tuple[Scene, State], torque: float
) -> None:
    scene, bent = arc
    build_up = 0.5
    origin = MidEdgeBending(scene.mesh, scene.active, fabric=FABRIC).curvatures(bent.q)
    laws = Laws(bending=BendingFriction(torque, origin, build_up))
    found = find_equilibrium(scene, FABRIC, bent, laws=laws, options=OPTIONS)
    assert found.converged
    # alpha kappa against the torque of friction
    kappa = brentq(lambda k: ALPHA * k - torque * (BENT - k) / np.hypot(BENT - k, build_up),
                   0.0, BENT)
    tip = found.state.positions[np.isclose(scene.mesh.rest[:, 0], 0.06)].mean(axis=0)
    assert tip[2] == pytest.approx(-(1 - np.cos(kappa * 0.06)) / kappa, rel=2e-2)
    # 6e-4 N hold more than the bent strip has; 1e-4 N let it go to a fifth.
    assert (kappa > 0.9 * BENT) == (torque > ALPHA * BENT)


def test_strip_that_friction_holds_flat_hangs_like_a_stiffer_one() -> None:
    """From flat, friction carries part of the weight: less bend than without."""
    mesh, held = strip(length=0.03, width=0.012, edge=0.003, clamp=0.006)
    scene = Scene(mesh=mesh, held=held)
    flat = scene.state(np.column_stack([mesh.rest, np.zeros(len(mesh.rest))]))
    drops = []
    for torque in (0.0, 5e-5, 2e-4):
        laws = Laws(bending=BendingFriction(torque))
        found = find_equilibrium(scene, FABRIC, flat, laws=laws)
        assert found.converged
        drops.append(-found.state.positions[:, 2].min())
    assert drops[0] > 1.02 * drops[1] > 1.1 * drops[2] > 0


def test_a_strip_curls_until_friction_holds_its_natural_curvature(
    arc: tuple[Scene, State]
) -> None:
    """alpha (S0 - kappa) against the torque of friction from flat."""
    scene, _ = arc
    torque, build_up = 2e-4, 0.5
    laws = Laws(bending=BendingFriction(torque, build_up=build_up, curvature=(BENT, 0.0, 0.0)))
    flat = scene.state(np.column_stack([scene.mesh.rest, np.zeros(len(scene.mesh.rest))]))
    found = find_equilibrium(scene, FABRIC, flat, laws=laws, options=OPTIONS)
    assert found.converged
    kappa = brentq(lambda k: ALPHA * (BENT - k) - torque * k / np.hypot(k, build_up), 0.0, BENT)
    tip = found.state.positions[np.isclose(scene.mesh.rest[:, 0], 0.06)].mean(axis=0)
    assert tip[2] == pytest.approx(-(1 - np.cos(kappa * 0.06)) / kappa, rel=2e-2)


@pytest.mark.parametrize(("wrong", "word"), [
    ({"torque": -1e-4}, "friction of"), ({"torque": 1e-4, "build_up": 0.0}, "friction of"),
    ({"torque": np.nan}, "friction of"), ({"torque": 1e-4, "curvature": (1.0, 2.0)}, "curvature=")])
def test_friction_that_makes_no_sense_is_refused(wrong: dict, word: str) -> None:
    with pytest.raises(InputError, match=word):
        BendingFriction(**wrong)


def test_an_origin_belongs_to_one_mesh(arc: tuple[Scene, State]) -> None:
    with pytest.raises(InputError, match=r"origin has shape \(5, 3\)"):
        BendingFriction(1e-4, np.zeros((5, 3)))(arc[0].mesh, arc[0].active, fabric=FABRIC)
