"""Cantilevers: the elastica, and moduli from strips."""

import numpy as np
import pytest
from cylinders import (
    LevelSides,
    TiedRows,
    cylinder_moduli,
    cylinder_torque,
    free_modulus,
    guided,
    tabulated_law,
)
from elastica_curves import LAWS, WEIGHT, curves_of
from scipy.integrate import solve_bvp

from common.errors import InputError
from sim.cantilever import (
    aspect_ratio,
    elastica,
    fabric_of_gamma,
    gamma_of_aspect_ratio,
    hang,
    heavy_elastica,
)
from sim.cantilever.elastica import curvature_of_torque, softening_law, strip_shape
from sim.cantilever.moduli import (
    Bezier,
    correct,
    fit_bezier,
    fit_degree,
    match,
)
from sim.cantilever.strip import simulate_strips
from sim.cloth import Laws
from sim.energies import bending_law
from sim.energies.bending_variants import Hysteresis
from sim.energies.membrane import Corotational
from sim.material import DIRECTIONS, Fabric, gravity_length, torque
from sim.mesh import strip
from sim.solver.state import State, moved

JITTERED = {"diagonals": "random", "jitter": 0.2, "seed": 2}
PLAIN = [{"diagonals": kind, "seed": 1} for kind in ("alternating", "equal", "random")]


def deviation(gamma: float, *, slope: float = 0.0, **options) -> float:
    hung = hang(fabric_of_gamma(gamma, 0.09), slope=slope, **options)
    assert hung.converged
    return aspect_ratio(hung.curve[-1]) / aspect_ratio(elastica(gamma, slope=slope)[-1]) - 1


@pytest.mark.parametrize(("gamma", "tolerance", "options"), [
    (1, 0.001, JITTERED), *((10, 0.001, one) for one in (JITTERED, *PLAIN)),
    (100, 0.003, PLAIN[1]),
    (20, 0.01, {"slope": 0.5, "width": 0.01, "edge": 0.0025})])
def test_strip_matches_the_heavy_elastica(gamma, tolerance, options):
    """90 × 30 mm, edges of 3 mm, on four triangulations, and on a ramp."""
    assert abs(deviation(gamma, **options)) < tolerance


def test_error_falls_with_the_square_of_the_spacing():
    """With a membrane so stiff that the weight's stretch does not show."""
    laws = Laws(membrane=Corotational(stiffness=5000.0))
    coarse, fine = (abs(deviation(100, width=0.015, edge=edge, laws=laws))
                    for edge in (3e-3, 1.5e-3))
    assert 1.6 < np.log2(coarse / fine) < 2.6


def collocated(gamma: float, soft: float) -> np.ndarray:
    """Free end (2,) of the strip of length 1 and torque kappa - soft kappa², by collocation."""
    kappa = np.linspace(0, 200, 200_001)
    moment = torque(kappa, 1.0, -soft)
    layer = 1 / np.sqrt(1 + gamma)  # at the clamp, in which the strip turns downwards

    def slopes(s: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.stack([np.interp(y[1], moment, kappa), -gamma * (1 - s) * np.cos(y[0])])

    s = np.unique(np.r_[np.linspace(0, min(1, 10 * layer), 200), np.linspace(0, 1, 200)])
    fall = np.exp(-s / layer)
    guess = np.pi / 2 * gamma / (gamma + 10) * np.stack([1 - fall, fall / layer])
    solution = solve_bvp(slopes, lambda clamp, tip: np.array([clamp[0], tip[1]]), s, guess,
                         tol=1e-7, max_nodes=100_000)
    assert solution.success
    at = np.linspace(0, 1, 40_001)
    angle = solution.sol(at)[0]
    return np.trapezoid(np.stack([np.cos(angle), np.sin(angle)]), at)


@pytest.mark.parametrize(("gamma", "soft"), [
    (0.1, 0.0), (1000, 0.0), (20, 0.05), (80, 0.03), (50, -0.1), (300, 0.2)])
def test_the_elastica_against_collocation(gamma, soft):
    """The same boundary-value problem by another method, with the law from its table."""
    ratio = aspect_ratio(elastica(gamma, softening=soft)[-1])
    assert ratio == pytest.approx(aspect_ratio(collocated(gamma, soft)), rel=1e-6)
    if soft == 0:
        assert gamma_of_aspect_ratio(ratio) == pytest.approx(gamma, rel=1e-6)


def test_the_elastica_tends_to_the_beam_of_small_deflections():
    assert aspect_ratio(elastica(1e-3)[-1]) == pytest.approx(1e-3 / 8, rel=1e-5)


def test_a_tabulated_law_bends_as_the_law_does():
    kappa = np.linspace(0, 60, 20_001)
    law = tabulated_law(kappa, torque(kappa, 2.0, -0.06))
    exact = heavy_elastica(2.0, -0.06, weight=160.0, length=1.0)
    assert np.abs(strip_shape(law, weight=160.0, length=1.0) - exact).max() < 1e-6


@pytest.mark.parametrize("soft", [-0.1, 0.0, 1e-9, 0.03, 0.3])
def test_curvature_of_torque_inverts_the_law(soft):
    for kappa in (0.0, 1e-3, 1.0, 5.0, 20.0):
        found = curvature_of_torque(float(torque(kappa, 2.0, -soft)), softening_law(2.0, -soft))
        assert found == pytest.approx(kappa, rel=1e-12)


def test_a_sloping_clamp_starts_the_elastica_at_its_slope():
    shape = elastica(5.0, slope=np.radians(30))
    assert np.degrees(np.arctan2(*shape[1][::-1])) == pytest.approx(30, abs=0.1)
    assert aspect_ratio(shape[-1]) > np.tan(np.radians(30))


def test_what_cannot_be_solved_is_refused():
    with pytest.raises(InputError, match="too soft"):
        strip_shape(softening_law(1e-9, 0.0), weight=1.0, length=1.0)
    with pytest.raises(InputError, match="must increase"):
        tabulated_law(np.array([0.0, 1.0, 2.0]), np.array([0.0, 2.0, 1.0]))


@pytest.mark.parametrize("ratio", [-4e-3, 4e-3])
def test_non_linear_strip_matches_the_non_linear_elastica(ratio):
    fabric = fabric_of_gamma(50.0, 0.09)
    fabric = Fabric(fabric.alpha, ratio * fabric.alpha)
    hung = hang(fabric, width=0.01, edge=0.002)
    assert hung.converged
    exact = aspect_ratio(heavy_elastica(fabric.alpha[0], fabric.beta[0], weight=0.3 * 9.81,
                                        length=0.09)[-1])
    linear = aspect_ratio(elastica(50.0)[-1])
    assert abs(aspect_ratio(hung.curve[-1]) / exact - 1) < 0.01
    assert abs(exact / linear - 1) > 0.1  # or the strip would not distinguish the laws


ORTHOTROPIC = Fabric(alpha=[60e-6, 20e-6, 15e-6], beta=[-120e-9, -60e-9, -30e-9])


@pytest.mark.parametrize("angle", [0.0, 22.5, 45.0, 67.5, 90.0])
def test_cylinder_moduli_are_those_of_the_plate_law(angle):
    """Torque of a cylinder: the derivative of the energy per area by its curvature."""
    phi = np.radians(angle)
    direction = np.array([np.cos(phi) ** 2, np.sin(phi) ** 2, np.cos(phi) * np.sin(phi)])
    law = bending_law.constants(ORTHOTROPIC)
    alpha, beta = cylinder_moduli(ORTHOTROPIC, phi)
    for kappa in (1.0, 50.0) if angle % 45 else (1.0, 50.0, 400.0):
        h = 1e-4 * kappa
        bent = np.outer([kappa + h, kappa - h], direction)
        energies = bending_law.respond(bent, np.zeros_like(bent), law, bending_law.PLAIN)[0]
        assert torque(kappa, alpha, beta) == pytest.approx(
            (energies[0] - energies[1]) / (2 * h), rel=1e-6
        )
        assert cylinder_torque(ORTHOTROPIC, phi, np.array([kappa]))[0] == pytest.approx(
            torque(kappa, alpha, beta), rel=1e-12
        )


@pytest.mark.parametrize("angle", [22.5, 45.0, 90.0])
def test_guided_strips_follow_the_law_at_any_angle(angle):
    fabric = Fabric(ORTHOTROPIC.alpha)
    phi = np.radians(angle)
    hung = hang(fabric, angle=phi, width=0.0072, edge=0.0018,
                laws=guided(Laws(), 4))
    assert hung.converged
    alpha, _ = cylinder_moduli(fabric, phi)
    found = 0.3 * 9.81 * 0.09**3 / gamma_of_aspect_ratio(aspect_ratio(hung.curve[-1]))
    assert found == pytest.approx(alpha, rel=0.02)
    assert abs(hung.twist) < 1e-4


@pytest.mark.parametrize(("sign", "skew"), [(1, 0.0), (1, 0.5), (-1, 0.5)])
def test_narrow_free_strips_tend_to_the_plates_compliance(sign, skew):
    """Off the yarns a free strip twists, and is far softer than a cylinder; if bending is coupled
    with twist, more along one diagonal than along the other.

    The clamp hinders the twist over a length of about the width, hence the extrapolation.
    """
    fabric, phi, gravity = Fabric(ORTHOTROPIC.alpha), sign * np.pi / 4, 9.81e-3
    wide, narrow = (
        hang(fabric, angle=phi, width=width, edge=0.0025, across=4, gravity=gravity,
             laws=Laws(Hysteresis(skew=skew), Corotational(1.0)))
        for width in (0.009, 0.0045)
    )
    moduli = [0.3 * gravity * 0.09**3 / gamma_of_aspect_ratio(aspect_ratio(hung.curve[-1]))
              for hung in (wide, narrow)]
    assert 2 * moduli[1] - moduli[0] == pytest.approx(
        free_modulus(fabric, phi, skew), rel=0.02)
    assert cylinder_moduli(fabric, phi)[0] > 3 * moduli[1]
    assert abs(narrow.twist) > 1e-3
    for angle in (0.0, 0.3, np.pi / 4):  # a strip of an isotropic fabric is a cylinder
        assert free_modulus(Fabric(np.full(3, 2e-5)), angle) == pytest.approx(2e-5, rel=1e-12)


def test_guide_is_a_quadratic_form_that_cylinders_do_not_feel():
    mesh, _ = strip(length=0.02, width=0.015, edge=0.005, clamp=0.01)
    rng = np.random.default_rng(0)
    x, y = mesh.rest.T
    level = State.at(mesh, np.column_stack([np.sin(x), y, np.cos(x)])).q
    for law in (TiedRows, LevelSides):
        guide = law(mesh, np.ones(len(mesh.faces), bool), fabric=Fabric([1e-6] * 3), across=3)
        assert guide.value(level) < 1e-30
        step = rng.standard_normal(3 * len(mesh.rest) + len(mesh.edges)) * 1e-3
        q = moved(level, mesh.edges, 0.1 * step)
        ahead, behind = (guide.value(moved(q, mesh.edges, h * step)) for h in (1e-3, -1e-3))
        slope = (guide.gradient(q) * step[guide.dofs]).sum()
        assert (ahead - behind) / 2e-3 == pytest.approx(slope, rel=1e-5)
        bend = np.einsum("ni,nij,nj->", step[guide.dofs], guide.hessian(level), step[guide.dofs])
        ahead = guide.value(moved(level, mesh.edges, 1e-4 * step))
        assert 2 * ahead / 1e-8 == pytest.approx(bend, rel=1e-3)


def test_a_bezier_arc_has_the_length_and_curvature_of_a_circle():
    """Curvature, length and derivatives of a cubic that is a quarter circle to 3e-4."""
    k = 4 / 3 * (np.sqrt(2) - 1)
    arc = Bezier(np.array([[0, 0], [k, 0], [1, 1 - k], [1, 1]]) * 0.05)
    assert arc.length == pytest.approx(0.05 * np.pi / 2, rel=1e-3)
    (x, y), (xx, yy) = arc.at(np.linspace(0, 1, 9), 1).T, arc.at(np.linspace(0, 1, 9), 2).T
    assert (x * yy - y * xx) / np.hypot(x, y) ** 3 == pytest.approx(np.full(9, 20.0), rel=0.03)
    assert np.linalg.norm(arc.sample(9) - [0, 0.05], axis=1) == pytest.approx(0.05, rel=1e-3)
    t, h = np.array([0.3, 0.6]), 1e-6
    assert np.allclose((arc.at(t + h) - arc.at(t - h)) / (2 * h), arc.at(t, 1), rtol=1e-6)
    assert np.allclose((arc.at(t + h, 1) - arc.at(t - h, 1)) / (2 * h), arc.at(t, 2), rtol=1e-6)


def test_a_fit_finds_the_bezier_it_was_made_of_and_no_noise():
    control = np.array([[0, 0], [0.02, 0], [0.04, 0.01], [0.05, 0.03], [0.05, 0.05]])
    points = Bezier(control).at(np.linspace(0, 1, 60) ** 1.3)
    fitted, distance = fit_degree(points, 4)
    assert distance < 5e-6 and np.abs(fitted.control - control).max() < 1e-3
    assert fitted.at(np.zeros(1), 1)[0, 1] == 0.0  # leaves the clamp in its direction
    curve = curves_of(20e-6, -50e-9)[1]
    noisy = curve + np.random.default_rng(0).normal(0, 3e-4, curve.shape)
    clean, degree = (len(fit_bezier(points).control) - 1 for points in (curve, noisy))
    assert degree <= 5 < clean
    assert 2e-4 < fit_degree(noisy, degree)[1] < 4e-4


@pytest.mark.parametrize(("alpha", "beta"), LAWS)
def test_moduli_of_elastica_curves_are_those_of_their_law(alpha, beta):
    moduli = match(curves_of(alpha, beta), weight=WEIGHT)
    assert moduli.alpha == pytest.approx(alpha, rel=1e-4)
    assert moduli.beta == pytest.approx(beta, rel=1e-3)
    if alpha == LAWS[0][0]:  # on a ramp too
        on_ramp = match(curves_of(alpha, beta, slope=0.4), weight=WEIGHT, slope=0.4)
        assert on_ramp.alpha == pytest.approx(alpha, rel=1e-3)


def test_the_table_is_accurate_with_noise():
    alpha, beta = LAWS[0]
    rng = np.random.default_rng(1)
    noisy = [curve + rng.normal(0, 3e-4, curve.shape) * (np.arange(81) > 0)[:, None]
             for curve in curves_of(alpha, beta)]
    found = match(noisy, weight=WEIGHT)
    assert found.alpha == pytest.approx(alpha, rel=0.08)
    assert found.beta == pytest.approx(beta, rel=0.35)


def test_curves_that_no_strip_has_are_refused():
    with pytest.raises(InputError, match="hanging strip"):
        match(curves_of(*LAWS[0])[:1], weight=WEIGHT, slope=np.radians(89))


def test_density_scales_the_moduli():
    light, heavy = (match(curves_of(*LAWS[0]), weight=w) for w in (WEIGHT / 2, WEIGHT))
    assert heavy.alpha == pytest.approx(2 * light.alpha, rel=1e-6)
    assert heavy.beta == pytest.approx(2 * light.beta, rel=1e-5)


FABRIC = Fabric(alpha=[30e-6, 18e-6, 20e-6], beta=[-60e-9, -45e-9, -30e-9])


LENGTHS = {direction: [x * gravity_length(alpha, 0.3) for x in (1.5, 2.5)]
           for direction, alpha in zip(DIRECTIONS, FABRIC.alpha, strict=True)}


@pytest.mark.slow
def test_three_free_strips_give_six_moduli():
    """Simulated on one triangulation, corrected on another."""
    strips = simulate_strips(FABRIC, LENGTHS, cells=24, seed=5)
    found = {name: match(curves, weight=WEIGHT) for name, curves in strips.items()}
    corrected = correct(strips, found, density=0.3)
    # A free bias strip hangs lower than a cylinder.
    assert found["bias"].alpha < 0.98 * FABRIC.alpha[1]
    assert np.abs(corrected.alpha / FABRIC.alpha - 1).max() < 0.02
    assert np.abs(corrected.beta / FABRIC.beta - 1).max() < 0.10


def test_guided_simulated_strips_are_read():
    strips = simulate_strips(FABRIC, {"weft": LENGTHS["weft"]}, cells=24, width=None, across=3,
                             laws=guided(Laws(), 3))
    found = match(strips["weft"], weight=WEIGHT)
    assert found.alpha == pytest.approx(FABRIC.alpha[2], rel=0.02)
    assert found.beta == pytest.approx(FABRIC.beta[2], rel=0.1)
