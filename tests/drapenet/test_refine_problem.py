"""The problem of a refinement and its search, on coarse meshes and fabrics that are known."""

import math
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from data.fabrics.fabrics import THETA_NAMES, fabric_from_theta, to_theta
from data.fabrics.nuisances import Kind, NuisanceConfig, Nuisances
from data.fabrics.prior import GaussianPrior, load_prior
from data.render.cameras import QUARTERS, nominal_camera
from data.render.rays import DepthRenderer
from drapenet.refine import problem as problems
from drapenet.refine.minimise import Limits, minimise
from drapenet.refine.objective import Linearised
from drapenet.refine.positions import RobustPositions
from drapenet.refine.problem import Problem, laplace
from drapenet.refine.search import CapturedViews, search
from drapenet.refine.unknowns import (
    ALPHA_RANGE,
    LAW_NAMES,
    NAMES,
    OFFSET_NAMES,
    SCALE,
    SpecimenPrior,
    Unknowns,
    drape_moves,
)
from drapenet.surface.springs import Springs, plane_springs
from drapenet.views.located import LocatedViews
from sim.draping import Drape, drape, follow
from sim.energies.base import check
from sim.energies.self_contact import contact_near
from sim.material import MICRO
from sim.rig import DISC_RIG, Rig
from sim.sensitivity import Tangent, sensitivities
from sim.solver.newton import NewtonOptions

THETA = to_theta(np.array([120.0, 90.0, 70.0]) * MICRO, np.array([-240.0, -180.0, -140.0]) * 1e-9)
AWAY = THETA + np.array([0.3, -0.2, 0.2, 5e-4, -5e-4, 5e-4])
TIGHT = NewtonOptions(residual=1e-8, step=1e-8, max_iterations=300)
SPREAD = NuisanceConfig({"woven": Kind(membrane=(100.0, 1000.0), shear=(20.0, 200.0), curl=3.0)})


@pytest.fixture(scope="module")
def shape() -> Drape:
    result = drape(fabric_from_theta(THETA), edge=8e-3, seed=1)
    assert result.converged
    return result


@pytest.fixture(scope="module")
def away(shape) -> Drape:
    return follow(shape, fabric_from_theta(AWAY))


def vertex_positions(
    target: np.ndarray, kind: type[RobustPositions] = RobustPositions
) -> RobustPositions:
    """All coordinates of the vertices, each with a standard deviation of 1 mm, far ones too."""
    return kind(target, vertices=np.ones(len(target), dtype=bool), sigma=math.sqrt(3) * 1e-3,
                limit=1e6, independent=3 * len(target))


def positions_problem(shape: Drape, near: Drape, theta: np.ndarray, **more) -> Problem:
    return Problem(near, Unknowns.of(theta), vertex_positions(shape.positions), free=THETA_NAMES,
                   **more)


def differences(near: Drape, theta: np.ndarray, k: int, size: float, springs: list) -> np.ndarray:
    """Derivative (V, 3) of held cloth by one of its moduli, from two equilibria."""
    step = size * np.eye(6)[k]
    plus, minus = (follow(near, fabric_from_theta(theta + side * step), extra=springs,
                          options=TIGHT).positions for side in (1, -1))
    return (plus - minus) / (2 * size)


def apart(found: np.ndarray, expected: np.ndarray) -> float:
    return float(np.linalg.norm(found - expected) / np.linalg.norm(expected))


def test_a_registered_drape_gives_its_moduli(shape):
    problem = positions_problem(shape, shape.at(shape.positions), AWAY)
    outcome = minimise(problem, limits=Limits(evaluations=15))
    assert outcome.evaluations <= 10 and problem.effort.solves == outcome.evaluations
    theta = problem.best.unknowns.theta
    assert np.abs(np.expm1(theta[:3] - THETA[:3])).max() < 0.01
    assert np.abs(theta[3:] / THETA[3:] - 1).max() < 0.05


def test_drapes_move_as_their_derivatives_say():
    # Equal ratios are a crease of the law, so THETA would not do.
    cloth = Unknowns.of(AWAY, Nuisances(300.0, 0.5, 0.0, 1.5, -1.0), warp=0.2)
    values = cloth.values.copy()
    values[[NAMES.index(name) for name in OFFSET_NAMES]] = 2e-3, -1e-3
    cloth = Unknowns(values)
    flat = drape(cloth.fabric, rig=DISC_RIG, edge=8e-3, laws=cloth.laws)
    base = flat.rest

    def settled(one: Unknowns, near: Drape) -> Drape:
        near = near.on(near.mesh.with_rest(one.rest(base, near.rig)))
        return follow(near, one.fabric, laws=one.laws, options=TIGHT)

    here = settled(cloth, flat)
    assert here.converged
    moves, _ = drape_moves(Tangent.of(here), cloth, here.rig, NAMES)
    for k in (1, 5, *(NAMES.index(name) for name in (*LAW_NAMES, *OFFSET_NAMES, "warp"))):
        step = 1e-4 * SCALE[k] * np.eye(len(NAMES))[k]
        ends = [settled(Unknowns(values + side * step), here).positions for side in (1, -1)]
        gap = apart(moves[k], (ends[0] - ends[1]) / (2e-4 * SCALE[k]))
        assert gap < (2e-2 if NAMES[k] in OFFSET_NAMES else 1e-4), NAMES[k]


def test_the_gradient_is_that_of_the_value(shape, away):
    known = SpecimenPrior.of(GaussianPrior(THETA, np.diag([0.1] * 3 + [1e-6] * 3), 7), SPREAD)
    free = (*THETA_NAMES, "membrane", "curl_warp", "offset_warp")
    problem = Problem(away, Unknowns(known.mean).with_theta(AWAY),
                      vertex_positions(shape.positions), free=free, prior=known, error_scale=1.5)
    problem.value(problem.start)
    residuals, jacobian = problem.linearised(problem.start)
    assert 0.5 * residuals @ residuals == pytest.approx(problem.best.value)
    gradient = jacobian.T @ residuals
    for k in (0, 4, 6, 7, 8):
        step = np.zeros(len(free))
        step[k] = 1e-3
        difference = (problem.value(problem.start + step)
                      - problem.value(problem.start - step)) / 2e-3
        assert gradient[k] == pytest.approx(difference, rel=3e-2)


def test_knowledge_is_the_distributions_specimens_are_drawn_from():
    prior = load_prior("gaussian")
    known = SpecimenPrior.of(prior, SPREAD)
    rng = np.random.default_rng(0)
    drawn = [Unknowns.of(theta, SPREAD.sample(rng, rng)) for theta in prior.sample(4000, rng)]
    white = np.array([known.residuals(cloth) for cloth in drawn])[:, : 6 + len(LAW_NAMES)]
    assert np.abs(white.mean(axis=0)).max() < 0.08
    assert np.cov(white.T) == pytest.approx(np.eye(6 + len(LAW_NAMES)), abs=0.08)
    assert not SpecimenPrior.of(prior).root[6:].any()


def test_a_failed_simulation_is_a_rejected_step_and_is_recorded(shape, away, monkeypatch):
    made: list[Drape] = []

    def fragile(*args: object, **more: object) -> Drape:
        made.append(follow(*args, **more))
        return made[1].ended(made[1].status.SADDLE, "failed") if len(made) == 2 else made[-1]

    monkeypatch.setattr(problems, "follow", fragile)
    problem = positions_problem(shape, away, AWAY)
    start_value = problem.value(problem.start)
    outcome = minimise(problem, limits=Limits(evaluations=4))
    assert len(problem.effort.failures) == 1
    assert outcome.value < start_value


def test_moduli_outside_the_bounds_are_drawn_in_and_inadmissible_ones_have_no_value(shape):
    problem = positions_problem(shape, shape, np.array([math.log(1e-3)] * 3 + [-2e-3] * 3))
    cloth, _ = problem.split(problem.start)
    assert np.exp(cloth.theta[:3]) == pytest.approx(ALPHA_RANGE[1])
    problem = positions_problem(shape, shape, THETA)
    stiff_and_soft = problem.start + np.array([2.0, -3.0, -3.0, 0, 0, 0])
    assert problem.value(stiff_and_soft) == math.inf and problem.effort.solves == 0


def test_residuals_count_less_where_the_best_cloth_meets_them_badly(shape):
    problem = positions_problem(shape, shape, THETA)
    problem.value(problem.start)
    rng = np.random.default_rng(0)
    target = shape.positions + 2e-3 * rng.standard_normal(shape.positions.shape)
    noisy = Problem(shape, Unknowns.of(THETA), vertex_positions(target), free=THETA_NAMES)
    for one, scale in ((problem, 1.0), (noisy, 2.0)):
        one.value(one.start)
        one.weigh()
        assert one.error_scale == pytest.approx(scale, rel=0.03)
        assert one.best.value == pytest.approx(one.best.misfit / one.error_scale**2)


def test_laplace_is_the_covariance_of_least_squares():
    rng = np.random.default_rng(0)
    matrix = rng.standard_normal((40, 7))
    scale = np.array([1.0] * 3 + [2e-3] * 3 + [0.05])
    problem = SimpleNamespace(linearised=lambda x: (np.zeros(40), matrix), measurements=40.0,
                              scale=scale, names=tuple("abcdefg"))
    found = laplace(problem, SimpleNamespace(x=np.zeros(7), misfit=66.0))
    expected = np.linalg.inv(matrix.T @ matrix) * np.outer(scale, scale)
    assert found.reduced_chi2 == pytest.approx(2 * 66.0 / 40)
    assert found.covariance == pytest.approx(expected)
    matrix[:, 4] = 0.0  # nothing depends on it
    lost = np.diag(laplace(problem, SimpleNamespace(x=np.zeros(7), misfit=66.0)).theta)
    assert np.isinf(lost[4]) and np.isfinite(np.delete(lost, 4)).all()


def test_springs_have_exact_derivatives(shape):
    check(plane_springs(shape.scene, 1.01 * shape.positions, pull=0.3), shape.state.q,
          shape.mesh.edges)


def test_held_cloth_has_the_derivatives_of_its_equilibria(shape, away):
    springs = [plane_springs(shape.scene, shape.positions, pull=0.6)]
    held = follow(away, fabric_from_theta(AWAY), extra=springs)
    assert held.converged
    gap, free = (np.linalg.norm(d.positions - shape.positions, axis=1).mean()
                 for d in (held, away))
    assert gap < 0.5 * free
    found = sensitivities(held)
    for k, size in ((1, 1e-4), (3, 1e-7)):
        assert apart(found.positions[k], differences(held, AWAY, k, size, springs)) < 1e-2


def test_the_surface_that_holds_cloth_moves_with_the_camera(shape, monkeypatch):
    """Derivatives by an objective's parameter go through the springs as well."""

    class Shifted(RobustPositions):
        nuisances = ("shift",)
        scale = np.full(1, 1e-3)
        deviation = np.ones(1)
        start = np.zeros(1)

        def linearised(self, positions: np.ndarray, nuisance: np.ndarray) -> Linearised:
            found = super().linearised(positions, nuisance)
            return found._replace(by_nuisance=np.zeros((len(found.residuals), 1)))

    def hold(nuisance: np.ndarray) -> Springs:
        aside = np.array([nuisance[0], 0.0, 0.0])
        return plane_springs(shape.scene, shape.positions + aside, pull=3.0)

    monkeypatch.setattr(problems, "follow", partial(follow, options=TIGHT))
    problem = Problem(shape, Unknowns.of(THETA), vertex_positions(shape.positions, Shifted),
                      free=["log_alpha_warp"], springs=hold)
    aside = np.array([0.0, 1.0])
    there = problem.start + 2 * aside
    assert problem.value(there) > problem.value(problem.start)
    problem.value(there)
    residuals, jacobian = problem.linearised(there)
    values = [problem.value(there + step * aside) for step in (1e-2, -1e-2)]
    difference = (values[0] - values[1]) / 2e-2
    assert difference > 1.0
    assert residuals @ jacobian[:, 1] == pytest.approx(difference, rel=1e-3)


@pytest.mark.slow
def test_held_cloth_that_touches_itself_feels_it():
    alpha = np.array([0.8, 0.88, 0.72]) * MICRO
    theta = np.concatenate([np.log(alpha), np.full(3, -2e-3)])
    drapes = (drape(fabric_from_theta(theta), edge=5e-3, seed=seed, start="fold")
              for seed in range(8))
    soft = next(one for one in drapes if one.converged and one.touches)  # rounding decides which
    springs = [plane_springs(soft.scene, soft.positions, pull=0.3)]
    same = follow(soft.at(soft.positions), soft.fabric, extra=springs)
    assert np.abs(same.positions - soft.positions).max() < 1e-6  # springs stand idle
    other = theta + np.array([0.2, 0.1, 0.0, 0.0, 0.0, 0.0])
    held = follow(soft, fabric_from_theta(other), extra=springs, options=TIGHT)
    assert held.converged and contact_near(held.scene, held.positions).value(held.state.q) > 0
    found = sensitivities(held)
    assert found.ok
    assert apart(found.positions[0], differences(held, other, 0, 1e-4, springs)) < 1e-2


@pytest.mark.slow
def test_views_of_another_mesh_and_folds_give_the_moduli():
    truth = drape(fabric_from_theta(THETA), edge=4e-3, start="fold", seed=5)
    camera = nominal_camera()
    views = DepthRenderer(truth.positions, truth.faces).views(camera, 1.0)
    prior = load_prior("gaussian")
    counts = []
    seen = CapturedViews(LocatedViews.exact(views, camera, Rig(), QUARTERS), turn=1.02, edge=3e-3,
                         coarse=3.5e-3)
    found = search(seen, [Unknowns.of(prior.mean)], free=THETA_NAMES, prior=SpecimenPrior.of(prior),
                   progress=counts.append)
    assert found.released.edge == found.best.drape.edge == 3e-3
    assert found.improved
    gap, first = (np.abs(theta[:3] - THETA[:3])
                  for theta in (found.best.unknowns.theta, prior.mean))
    assert np.median(gap) < 0.3 * np.median(first)
    deviation = np.sqrt(np.diag(found.uncertainty.theta)[:3])
    assert (deviation < 0.2).all() and (gap < 4 * deviation).all()
    assert counts == sorted(counts) and found.effort.solves // 2 <= counts[-1]
