"""Cloth lowered over its plate: any tester, number of folds, and failure as data."""

import numpy as np
import pytest
from scipy.special import j0

from sim.cloth import Cloth, Laws
from sim.draping import drape
from sim.energies.external import Gravity
from sim.energies.membrane import Corotational
from sim.material import Fabric
from sim.measures import fold_count
from sim.mesh import Mesh, strip
from sim.rig import DISC_RIG, GRAVITY, Rig
from sim.scene import Scene, make_specimen
from sim.solver.dynamics import Inertia, Motion
from sim.solver.newton import Status

SOFT = Fabric(np.full(3, 20e-6))


@pytest.mark.parametrize("rig", [Rig(0.2, 0.06, "disc"), Rig(0.4, 0.2, "square")],
                         ids=lambda rig: rig.name)
def test_small_and_large_specimens_are_lowered(rig):
    result = drape(SOFT, rig=rig, edge=10e-3, start="lowered", seed=1)
    assert result.converged, result.message
    assert result.positions[:, 2].min() < -0.2 * (rig.specimen_size - rig.plate_diameter)


@pytest.mark.slow
def test_lowered_discs_have_more_folds_than_discs_from_rings():
    """Their numbers scatter by 0.6 and 1.5."""
    folds = {}
    for start, count in (("lowered", 3), ("ring", 12)):
        drapes = [drape(SOFT, rig=DISC_RIG, edge=6e-3, start=start, seed=seed)
                  for seed in range(count)]
        assert all(one.converged for one in drapes)
        folds[start] = np.mean([fold_count(one.positions, one.rest, DISC_RIG) for one in drapes])
    assert folds["lowered"] > folds["ring"] + 0.5


def test_a_time_step_that_fails_is_a_status():
    class Broken(Gravity):
        """A weight without a value."""

        def value(self, q: np.ndarray) -> float:
            return np.nan

    def law(mesh, active, *, fabric):
        return Broken(mesh, density=fabric.density, gravity=GRAVITY)

    result = drape(SOFT, edge=0.012, laws=Laws(others=(law,)))
    assert result.status is Status.NOT_FINITE and set(result.coarse) == {Status.NOT_FINITE}


LIMP = Fabric(np.full(3, 0.5e-6))
LENGTH = 0.3  # m


def moving(scene: Scene, fabric: Fabric, laws: Laws | None = None) -> tuple[Cloth, Inertia]:
    """The cloth of ``scene`` with its inertia, and that inertia."""
    inertia = Inertia(scene.mesh, density=fabric.density)
    return Cloth(scene, fabric, laws=laws or Laws(), extra=[inertia]), inertia


def test_cloth_without_support_falls_with_the_known_error_of_the_step():
    """Velocities are exact; positions are g t h/2 too low in steps of h, whatever the viscosity."""
    mesh, _ = strip(length=0.06, width=0.03, edge=0.01, clamp=0.0)
    scene = Scene(mesh, np.zeros(len(mesh.rest), dtype=bool))
    cloth, inertia = moving(scene, LIMP)
    motion = Motion.at_rest(scene.state(np.column_stack([mesh.rest, np.zeros(len(mesh.rest))])))
    for _ in range(10):
        motion, _ = motion.advanced(cloth.potential, inertia, 0.02, relaxation=0.05)
    assert motion.time == pytest.approx(0.2)
    fall = GRAVITY * (0.2**2 / 2 + 0.2 * 0.02 / 2)
    assert np.allclose(motion.state.positions[:, 2], -fall, atol=1e-6)
    assert np.allclose(motion.velocities, [0, 0, -GRAVITY * 0.2], atol=1e-5)


@pytest.mark.parametrize("relaxation", [0.01, 0.05])
def test_a_hanging_strip_swings_and_is_damped_as_stated(relaxation):
    """Lowest frequency of a heavy chain: half the first zero of J0, times sqrt(g/L). Amplitudes
    fall by exp(-tau w²/2 t), the viscosity of the stiffness that gravity gives. ``relaxation`` is
    tau in periods."""
    mesh, held = strip(length=LENGTH, width=0.01, edge=0.01, clamp=0.0)
    scene = Scene(mesh, held)
    cloth, inertia = moving(scene, LIMP, Laws(membrane=Corotational(5e3)))
    down, across = mesh.rest.T
    mode = j0(2.4048 * np.sqrt(1 - down / LENGTH))
    motion = Motion.at_rest(scene.state(np.column_stack([2e-3 * mode, across, -down])))
    frequency = 2.4048 / 2 * np.sqrt(GRAVITY / LENGTH)
    period, swing = 2 * np.pi / frequency, []
    for _ in range(220):
        motion, _ = motion.advanced(cloth.potential, inertia, 0.005 * period,
                                    relaxation=relaxation * period)
        swing.append(inertia.masses * mode @ motion.state.positions[:, 0])
    swing = np.array(swing)
    before = np.flatnonzero(np.diff(np.sign(swing)) != 0)
    crossings = before + np.abs(swing[before] / np.diff(swing)[before])
    assert np.diff(crossings) == pytest.approx(100, rel=0.03)
    first, second = np.abs(swing[50:150]).max(), np.abs(swing[150:]).max()
    rate = np.log(first / second) / (period / 2)
    assert rate == pytest.approx(relaxation * period * frequency**2 / 2, rel=0.1)


def test_the_energy_of_falling_cloth_only_decreases():
    specimen = make_specimen(Rig(), edge=0.016)
    mesh: Mesh = specimen.mesh
    scene = Scene(mesh, specimen.held, Rig().obstacles)
    cloth, inertia = moving(scene, Fabric(np.full(3, 30e-6)))
    bumps = np.random.default_rng(0).normal(0, 1e-4, len(mesh.rest)) * ~specimen.held
    motion = Motion.at_rest(scene.state(np.column_stack([mesh.rest, bumps])))
    energies = []
    for _ in range(30):
        q = motion.state.q
        kinetic = 0.5 * inertia.masses @ (motion.velocities**2).sum(axis=1)
        energies.append(kinetic + cloth.potential.value(q) - inertia.value(q))
        motion, _ = motion.advanced(cloth.potential, inertia, 0.01, relaxation=0.02)
    assert motion.state.positions[:, 2].min() < -0.05
    assert (np.diff(energies) < 0).all()
