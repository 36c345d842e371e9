"""Hysteresis in the virtual pure-bending test, natural curvature at rest, and derivatives."""

import numpy as np
import pytest
from scipy.optimize import brentq

from common.errors import InputError
from experiments.physics.laboratory import kes_fabric
from sim.cloth import Laws
from sim.energies.bending_variants import (
    BUILD_UP,
    Hysteresis,
    HystereticBending,
)
from sim.equilibrium import find_equilibrium
from sim.material import KES_CURVATURE, Fabric, torque
from sim.mesh import Mesh, strip
from sim.scene import Scene
from sim.solver.newton import NewtonOptions

TWILL = Fabric(np.array([30e-6, 20e-6, 14e-6]), np.array([-66e-9, -40e-9, -21e-9]))
ANGLES = {0: 0.0, 1: np.pi / 4, 2: np.pi / 2}
UP = np.arange(1.0, 251.0)  # KES-FB2 bends to 2.5 cm⁻¹
DOWN = np.arange(249.0, -1.0, -1.0)


STEP = 1e-3  # 1/m, of the differences of the energy


def pure_bending(fabric, law, curvatures, *, angle: float = 0.0) -> np.ndarray:
    """Torques per width (K,), N, of cloth bent to ``curvatures`` (K,), 1/m, one after the other.

    The torque is the derivative of the energy of a cylinder by the curvature, without stresses.
    Hysteresis follows every curvature in turn, so that they should be close to each other.
    """
    flat, _ = strip(length=0.01, width=0.01, edge=5e-4, clamp=0.0)
    along, across = flat.rest.T
    cos, sin = np.cos(angle), np.sin(angle)
    mesh = Mesh(np.column_stack([cos * along - sin * across, sin * along + cos * across]),
                flat.faces)
    energy = law(mesh, np.ones(len(mesh.faces), dtype=bool), fabric=fabric)

    def bent(curvature: float) -> np.ndarray:
        """The cylinder's positions and edge normals."""
        turn = curvature * along
        middle = turn[mesh.edges].mean(axis=1)
        reach, drop = along * np.sinc(turn / np.pi), along * np.sinc(turn / 2 / np.pi) * np.sin(
            turn / 2)
        positions = np.column_stack([reach, across, -drop])
        normals = np.column_stack([np.sin(middle), np.zeros(len(middle)), np.cos(middle)])
        return np.concatenate([positions.ravel(), normals.ravel()])

    torques = []
    for curvature in curvatures:
        ends = [energy.value(bent(curvature + sign * STEP)) for sign in (1, -1)]
        torques.append((ends[0] - ends[1]) / (2 * STEP * mesh.areas.sum()))
        if isinstance(energy, HystereticBending):
            energy = energy.with_origin(energy.origin_at(bent(curvature)))
    return np.array(torques)


def cycle(fabric: Fabric, law: Hysteresis, direction: int) -> tuple[np.ndarray, np.ndarray]:
    """Torques, N, at 1 to 250 1/m, and at 249 to 0 1/m on the way back."""
    torques = pure_bending(fabric, law, [*UP, *DOWN], angle=ANGLES[direction])
    return torques[: len(UP)], torques[len(UP):]


@pytest.mark.parametrize(("direction", "share"), [(0, 0.05), (1, 0.2), (2, 0.37)])
def test_fabric_of_moduli_is_loaded_and_unloaded_as_stated(share, direction):
    law = Hysteresis(share)
    loading, unloading = cycle(TWILL, law, direction)
    stated = torque(UP, TWILL.alpha[direction], TWILL.beta[direction])
    assert np.allclose(loading, stated, rtol=1e-2)
    friction = share * stated[UP == KES_CURVATURE][0]
    assert law.friction(TWILL)[direction] == pytest.approx(friction, rel=1e-2)
    # Beyond the build-up of the way back, the difference is 2HB; it is read at 1 cm⁻¹.
    saturated = np.searchsorted(-DOWN, -KES_CURVATURE)
    assert stated[UP == KES_CURVATURE][0] - unloading[saturated] == pytest.approx(
        2 * friction, rel=1e-2)


@pytest.mark.parametrize("direction", ANGLES)
def test_fabric_of_kes_has_its_b_2hb_and_residual_curvature(direction):
    b, two_hb = np.array([9e-6, 6e-6, 5e-6]), np.array([4.5e-4, 2.4e-4, 1.2e-4])
    fabric, law = kes_fabric(b, two_hb)
    loading, unloading = cycle(fabric, law, direction)
    between = (UP >= 50) & (UP <= 150)
    slope, intercept = np.polyfit(UP[between], loading[between], 1)
    assert slope == pytest.approx(b[direction], rel=1e-2)
    assert intercept == pytest.approx(two_hb[direction] / 2, rel=1e-2)
    at = np.searchsorted(-DOWN, -KES_CURVATURE)
    gap = loading[UP == KES_CURVATURE][0] - unloading[at]
    assert gap == pytest.approx(two_hb[direction], rel=1e-2)
    # B kappa - HB = 0
    residual = brentq(lambda k: np.interp(k, DOWN[::-1], unloading[::-1]), 1.0, 200.0)
    assert residual == pytest.approx(two_hb[direction] / 2 / b[direction], rel=1e-2)


def test_a_closed_cycle_loses_energy_and_a_reversal_inside_the_build_up_does_not():
    law = Hysteresis(0.2)
    path = np.concatenate([UP, DOWN, UP])
    torques = pure_bending(TWILL, law, path)
    loop = slice(len(UP) - 1, None)
    assert np.trapezoid(torques[loop], path[loop]) > 0.5 * 250 * law.friction(TWILL)[0]
    small = 0.1 * BUILD_UP * KES_CURVATURE
    first, _, again = pure_bending(TWILL, law, [80.0, 80.0 - small, 80.0])
    assert again == pytest.approx(first, rel=1e-6)


def test_friction_of_yarns_that_differ_has_a_plate_form():
    """Where the bias has too little friction for a plate, it has just enough."""
    fabric = Fabric(np.array([40e-6, 10.5e-6, 2e-6]))
    form = _energy(Hysteresis(0.3), fabric).variant
    assert form.p_xx * form.p_yy > form.p_mixed**2 and form.p_xy > 0


def test_a_weightless_strip_rests_in_an_arc_of_its_natural_curvature():
    """Clamped level, it follows a circle of the natural curvature, downwards."""
    mesh, held = strip(length=0.06, width=0.012, edge=0.003, clamp=0.006)
    kappa = 15.0
    scene = Scene(mesh=mesh, held=held, gravity=0.0)
    found = find_equilibrium(
        scene, Fabric(np.full(3, 30e-6)),
        scene.state(np.column_stack([mesh.rest, np.zeros(len(mesh.rest))])),
        laws=Laws(bending=Hysteresis(curvature=(kappa, 0.0, 0.0))),
        options=NewtonOptions(residual=1e-4, step=1e-6))
    assert found.converged
    tip = found.state.positions[np.isclose(mesh.rest[:, 0], 0.06)].mean(axis=0)
    assert tip[0] == pytest.approx(np.sin(kappa * 0.06) / kappa, rel=3e-3)
    assert tip[2] == pytest.approx(-(1 - np.cos(kappa * 0.06)) / kappa, rel=2e-2)


@pytest.mark.parametrize(("wrong", "word"), [
    ({"share": -0.1}, "hysteresis share"), ({"share": 0.6}, "hysteresis share"),
    ({"share": (0.1, 0.2)}, "hysteresis share"), ({"share": np.nan}, "hysteresis share"),
    ({"curvature": (1.0, 2.0)}, "curvature="), ({"curvature": (np.nan, 0, 0)}, "curvature=")])
def test_hysteresis_that_no_fabric_has_is_refused(wrong, word):
    with pytest.raises(InputError, match=word):
        Hysteresis(**wrong)


def test_an_origin_belongs_to_one_mesh():
    with pytest.raises(InputError, match=r"origin has shape \(5, 3\)"):
        _energy(Hysteresis(0.1, origin=np.zeros((5, 3))))


def _energy(law: Hysteresis, fabric: Fabric = TWILL):
    mesh, held = strip(length=0.03, width=0.012, edge=0.003, clamp=0.006)
    return law(mesh, ~held[mesh.faces].all(axis=1), fabric=fabric)
