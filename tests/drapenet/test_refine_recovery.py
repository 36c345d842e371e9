"""Refinements of fabrics that are known, on coarse meshes."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from data.cameras import CameraRig
from data.fabrics import fabric_from_theta, to_theta
from data.prior import load_prior
from data.prior.gaussian import GaussianPrior
from data.render import render_views
from drapenet.canonical import square_turn
from drapenet.refine import problem as problems
from drapenet.refine import views as views_refinement
from drapenet.refine.attraction import Springs
from drapenet.refine.depth import DepthViews
from drapenet.refine.held import springs_to_vertices
from drapenet.refine.optimisers import Limits, Status, minimise
from drapenet.refine.problem import ALPHA_RANGE, DrapeProblem
from drapenet.refine.registered import VertexPositions
from drapenet.refine.uncertainty import laplace
from drapenet.refine.views import refine_views
from sim.drape import DrapeResult, drape
from sim.material import MICRO
from sim.newton import NewtonOptions
from sim.scene import Rig
from sim.sensitivity import follow, sensitivities
from sim.sensitivity.tangent import possible_contact

THETA = to_theta(np.array([120.0, 90.0, 70.0]) * MICRO, np.array([-240.0, -180.0, -140.0]) * 1e-9)
AWAY = THETA + np.array([0.3, -0.2, 0.2, 5e-4, -5e-4, 5e-4])

TIGHT = NewtonOptions(residual=1e-8, step=1e-8)


@pytest.fixture(scope="module")
def shape() -> DrapeResult:
    result = drape(fabric_from_theta(THETA), edge=8e-3, seed=1)
    assert result.converged
    return result


@pytest.fixture(scope="module")
def away(shape: DrapeResult) -> DrapeResult:
    return follow(shape, fabric_from_theta(AWAY))


def test_a_registered_drape_gives_its_moduli(shape: DrapeResult, away: DrapeResult) -> None:
    origin = shape.at(shape.positions)
    problem = DrapeProblem(away, AWAY, VertexPositions(shape.positions), origin=origin)
    found = minimise(problem, limits=Limits(evaluations=15, target=1e-4))
    assert found.evaluations <= 10 and problem.solves == found.evaluations - 1
    assert np.abs(np.expm1(problem.best.theta[:3] - THETA[:3])).max() < 0.01
    assert np.abs(problem.best.theta[3:] / THETA[3:] - 1).max() < 0.05


def test_the_gradient_is_that_of_the_value(shape: DrapeResult, away: DrapeResult) -> None:
    problem = DrapeProblem(away, AWAY, VertexPositions(shape.positions), membrane=True,
                           prior=GaussianPrior(THETA, np.diag([0.1] * 3 + [1e-6] * 3), 7))
    problem.value(problem.start)
    residuals, jacobian = problem.linearised(problem.start)
    gradient = jacobian.T @ residuals
    for k in (0, 4, 6):
        step = np.zeros(7)
        step[k] = 1e-3
        difference = (problem.value(problem.start + step)
                      - problem.value(problem.start - step)) / 2e-3
        assert gradient[k] == pytest.approx(difference, rel=2e-2)


def test_a_failed_simulation_is_a_rejected_step_and_is_recorded(
    shape: DrapeResult, away: DrapeResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = []

    def fragile(*args: object, **more: object) -> DrapeResult:
        made.append(follow(*args, **more))
        return replace(made[0], status=made[0].status.SADDLE) if len(made) == 1 else made[-1]

    monkeypatch.setattr(problems, "follow", fragile)
    problem = DrapeProblem(away, AWAY, VertexPositions(shape.positions))
    found = minimise(problem, limits=Limits(evaluations=4))
    assert len(problem.failures) == 1
    assert found.value < found.trace[0].value


def test_moduli_outside_the_bounds_are_drawn_in(shape: DrapeResult) -> None:
    far = THETA.copy()
    far[:3] = math.log(1e-3)
    problem = DrapeProblem(shape, far, VertexPositions(shape.positions))
    theta, _, _ = problem.split(problem.start)
    assert np.exp(theta[:3]) == pytest.approx(ALPHA_RANGE[1])
    assert problem.value(problem.start) > 0 and problem.solves == 1


def test_inadmissible_moduli_have_no_value_and_cost_nothing(shape: DrapeResult) -> None:
    problem = DrapeProblem(shape, THETA, VertexPositions(shape.positions))
    assert problem.value(problem.start) == 0 and problem.solves == 0
    stiff_and_soft = problem.start + np.array([2.0, -3.0, -3.0, 0, 0, 0])
    assert problem.value(stiff_and_soft) == math.inf and problem.solves == 0


def test_laplace_is_the_covariance_of_least_squares() -> None:
    rng = np.random.default_rng(0)
    matrix, scale = rng.standard_normal((40, 7)), np.array([1.0] * 3 + [2e-3] * 3 + [0.05])
    residuals = 2.0 * rng.standard_normal(40)
    problem = SimpleNamespace(
        linearised=lambda x: (residuals, matrix), measurements=40.0, scale=scale,
        names=tuple("abcdefg"))
    found = laplace(problem, SimpleNamespace(x=np.zeros(7)))
    reduced = residuals @ residuals / 33
    expected = reduced * np.linalg.inv(matrix.T @ matrix) * np.outer(scale, scale)
    assert found.reduced_chi2 == pytest.approx(reduced)
    assert found.covariance == pytest.approx(expected)
    matrix[:, 4] = 0.0  # nothing depends on it
    lost = laplace(problem, SimpleNamespace(x=np.zeros(7)))
    assert np.isinf(lost.theta[4]) and np.isfinite(np.delete(lost.theta, 4)).all()


def test_springs_have_exact_derivatives() -> None:
    rng = np.random.default_rng(2)
    normals = rng.standard_normal((5, 3))
    springs = Springs(np.array([0, 2, 3, 5, 6]), rng.standard_normal((5, 3)), normals,
                      rng.uniform(1, 2, 5))
    q, move = rng.standard_normal((2, 21))
    step = 1e-6
    slope = (springs.value(q + step * move) - springs.value(q - step * move)) / (2 * step)
    assert (springs.gradient(q) * move[springs.dofs]).sum() == pytest.approx(slope)
    bend = (springs.gradient(q + step * move) - springs.gradient(q - step * move)) / (2 * step)
    hessian = np.einsum("nij,nj->ni", springs.hessian(q), move[springs.dofs])
    assert hessian == pytest.approx(bend)
    assert np.array_equal(springs.hessian(q, convex=True), springs.hessian(q))


def test_held_cloth_has_the_derivatives_of_its_equilibria(
    shape: DrapeResult, away: DrapeResult
) -> None:
    springs = [springs_to_vertices(shape)]
    held = follow(away, fabric_from_theta(AWAY), extra=springs)
    assert held.converged
    gap, free = (np.linalg.norm(d.positions - shape.positions, axis=1).mean()
                 for d in (held, away))
    assert gap < 0.5 * free
    found = sensitivities(held)
    for k, size in ((1, 1e-4), (3, 1e-7)):
        step = np.zeros(6)
        step[k] = size
        plus, minus = (
            follow(held, fabric_from_theta(AWAY + sign * step), extra=springs, options=TIGHT)
            for sign in (1, -1))
        difference = (plus.positions - minus.positions) / (2 * size)
        error = np.linalg.norm(found.positions[k] - difference) / np.linalg.norm(difference)
        assert error < 1e-2


@pytest.mark.slow
def test_held_cloth_that_touches_itself_feels_it() -> None:
    alpha = np.array([0.8, 0.88, 0.72]) * MICRO
    theta = np.concatenate([np.log(alpha), np.full(3, -2e-3)])
    soft = drape(fabric_from_theta(theta), edge=5e-3, seed=1, start="fold")
    assert soft.converged and soft.touches
    springs = [springs_to_vertices(soft)]
    same = follow(soft.at(soft.positions), soft.fabric, extra=springs)
    assert np.abs(same.positions - soft.positions).max() < 1e-6  # springs stand idle
    other = theta + np.array([0.2, 0.1, 0.0, 0.0, 0.0, 0.0])
    held = follow(soft, fabric_from_theta(other), extra=springs, options=TIGHT)
    assert held.converged and possible_contact(held).value(held.state.q) > 0
    found = sensitivities(held)
    assert found.ok
    step = np.array([1e-4, 0, 0, 0, 0, 0])
    plus, minus = (
        follow(held, fabric_from_theta(other + sign * step), extra=springs, options=TIGHT)
        for sign in (1, -1))
    difference = (plus.positions - minus.positions) / 2e-4
    error = np.linalg.norm(found.positions[0] - difference) / np.linalg.norm(difference)
    assert error < 1e-2


def test_the_sides_of_a_square_are_seen(shape: DrapeResult) -> None:
    camera = CameraRig.load().nominal()
    for turn in (0.2, 1.3, 2.5):
        views = render_views(shape.positions, shape.faces, camera, turn)
        objective = DepthViews(views, camera, shape.faces)
        found = square_turn(objective.points(objective.start)[0], Rig())
        gap = (found - turn + math.pi / 4) % (math.pi / 2) - math.pi / 4
        assert abs(gap) < math.radians(6)


@pytest.mark.slow
def test_views_of_another_mesh_and_folds_give_the_moduli() -> None:
    truth = drape(fabric_from_theta(THETA), edge=4e-3, start="fold", seed=5)
    camera = CameraRig.load().nominal()
    views = render_views(truth.positions, truth.faces, camera, 1.0)
    prior = load_prior("gaussian")
    values = []
    found = refine_views(views, camera, prior.mean, turns=[1.02], edge=3e-3, seed=2,
                         prior=prior,
                         progress=lambda _, value: values.append(value))
    assert found.drape.edge == found.best.drape.edge == 3e-3
    assert found.best.value <= found.start_value
    assert found.status is not Status.INTERRUPTED and found.uncertainty is not None
    gap, first = (np.abs(theta[:3] - THETA[:3]) for theta in (found.best.theta, prior.mean))
    assert np.median(gap) < 0.4 * np.median(first)
    assert (found.uncertainty.theta[:3] < 0.3).all()
    assert len(values) >= found.simulations // 2


@pytest.mark.slow
def test_an_interrupted_refinement_hands_back_the_best_so_far(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    truth = drape(fabric_from_theta(THETA), edge=6e-3, seed=5)
    camera = CameraRig.load().nominal()
    views = render_views(truth.positions, truth.faces, camera, 1.0)

    def stop(simulations: int, value: float) -> None:
        if simulations >= 6 and math.isfinite(value):
            raise KeyboardInterrupt

    monkeypatch.setattr(views_refinement, "COARSE", 8e-3)
    found = refine_views(views, camera, AWAY, turns=[1.0], edge=7e-3, progress=stop)
    assert found.status is Status.INTERRUPTED
    assert found.best.value <= found.start_value
    # The objective knows the mesh of the drape that is handed back.
    assert found.drape.edge == 8e-3
    seen = found.objective.render(found.drape.positions, found.best.nuisance)
    assert np.median(np.abs(seen - views)[(seen > 0) & (views > 0)]) < 2e-3
