"""What a refinement minimises, how it does, and what it gives to an estimate."""

import math
from functools import partial

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from common.configs import read_option
from common.findings import texts
from common.types import Turns
from data.fabrics.fabrics import ClothProperties, fabric_from_theta
from data.render.cameras import QUARTERS, Camera, nominal_camera
from data.render.rays import DepthRenderer
from drapenet.network.checkpoint import read_header
from drapenet.refine import refine
from drapenet.refine.depth import BORDER, EDGE, FOCAL, POSE, DepthViews, DepthWeights, table_names
from drapenet.refine.minimise import Limits, Status, minimise
from drapenet.refine.objective import fit_nuisances, huber, value
from drapenet.refine.positions import Fidelity
from drapenet.refine.problem import Effort, Trial, Uncertainty
from drapenet.refine.search import CapturedViews, SearchResult
from drapenet.refine.unknowns import NAMES, Unknowns
from drapenet.result.estimate import Estimate
from drapenet.surface.springs import surface_positions
from drapenet.views.located import LocatedViews
from sim.draping import Drape, drape
from sim.material import DIRECTIONS, MICRO
from sim.mesh import grid_faces
from sim.rig import Rig

HEADER = read_header()
THETA = np.concatenate([np.log(np.array([60, 40, 30]) * MICRO), np.full(3, -2e-3)])
SPREAD = np.array([0.9, 0.8, 0.9, 1.4e-3, 1.4e-3, 1.4e-3])


def dome(cells: int = 30) -> tuple[np.ndarray, np.ndarray]:
    """A smooth bumpy sheet over the plate, without folds that hide others."""
    side = np.linspace(-0.1, 0.1, cells + 1)
    x, y = (grid.ravel() for grid in np.meshgrid(side, side, indexing="ij"))
    z = -3.0 * (x**2 + y**2) - 0.006 * np.sin(30 * x) * np.cos(25 * y + 0.4)
    return np.column_stack([x, y, z]), grid_faces(np.eye(cells, dtype=bool))


def located(views: np.ndarray, camera: Camera, turns: Turns = QUARTERS) -> LocatedViews:
    return LocatedViews.exact(views, camera, Rig(), turns)


@pytest.fixture(scope="module")
def camera() -> Camera:
    return nominal_camera()


@pytest.fixture(scope="module")
def compared(camera) -> tuple[np.ndarray, DepthViews]:
    positions, faces = dome()
    views = DepthRenderer(positions, faces).views(camera, 0.3)
    return positions, DepthViews(located(views, camera), faces, turn=0.3)


def test_robust_residuals_and_their_derivatives():
    r = np.array([-7.0, -1.5, 0.0, 0.3, 1.9, 2.1, 40.0])
    limit = 2.0
    bent, slope = huber(r, limit)
    step = 1e-6
    differences = (huber(r + step, limit)[0] - huber(r - step, limit)[0]) / (2 * step)
    assert slope == pytest.approx(differences, rel=1e-6, abs=1e-9)
    expected = np.where(np.abs(r) > limit, limit * (np.abs(r) - limit / 2), r**2 / 2)
    assert bent**2 / 2 == pytest.approx(expected)


def test_a_drape_fits_its_own_views(compared):
    positions, objective = compared
    residuals = objective.residuals(positions, objective.start)
    # Views are kept in single precision; the border is smoothed by a fraction of a pixel.
    assert value(residuals) < 0.02 * len(residuals) / 10
    moved = objective.residuals(positions + np.array([0, 0, 5e-3]), objective.start)
    assert value(moved) > 100 * value(residuals)


def test_what_is_compared_is_what_is_rendered(compared, camera):
    positions, objective = compared
    expected = DepthRenderer(positions, objective._faces).views(camera, 0.3)
    rendered = objective.render(positions, objective.start)
    both = (rendered > 0) & (expected > 0)
    assert both.sum() > 0.999 * (expected > 0).sum()
    assert np.abs(rendered - expected)[both].max() < 1e-5


@pytest.mark.parametrize("name", [*POSE, *table_names(4), FOCAL, BORDER])
def test_depth_derivatives_by_pose(compared, name):
    """A step aside of one parameter alone, so that the residuals speak of it."""
    positions, objective = compared
    k = objective.nuisances.index(name)
    there = objective.start.copy()
    step = np.zeros(len(objective.start))
    there[k] += objective.scale[k]
    step[k] = 0.05 * objective.scale[k]
    found = objective.linearised(positions, there)
    gradient = float(found.by_nuisance[:, k] @ found.residuals)
    difference = (value(objective.residuals(positions, there + step))
                  - value(objective.residuals(positions, there - step))) / (2 * step[k])
    # Pixels that come into sight or leave it are not in the derivative.
    size = np.linalg.norm(found.by_nuisance[:, k]) * np.linalg.norm(found.residuals)
    assert abs(gradient - difference) < 0.2 * size
    assert abs(difference) > 0.5 * size


def test_views_of_any_turns_are_compared(camera):
    positions, faces = dome()
    turns = np.array([0.0, 0.9, 2.0])
    views = DepthRenderer(positions, faces).views(camera, 0.3, turns)
    objective = DepthViews(located(views, camera, turns), faces, turn=0.3)
    assert objective.nuisances == (*POSE, "table_1", "table_2", FOCAL, BORDER)
    there = objective.start.copy()
    there[objective.nuisances.index("table_2")] = 0.05
    values = [value(objective.residuals(positions, n)) for n in (objective.start, there)]
    assert values[1] > 10 * values[0]


def test_pixels_count_by_the_area_of_a_cell(camera):
    positions, faces = dome()
    views = DepthRenderer(positions - [0, 0, 2e-4], faces).views(camera, 0.0)
    fine, coarse = (DepthViews(located(views, camera), faces, weights=DepthWeights(
        border_sigma=np.inf).on_mesh(edge)) for edge in (EDGE, 2 * EDGE))
    costs = [value(d.residuals(positions, d.start)) for d in (fine, coarse)]
    assert costs[0] > 0.5
    assert costs[0] == pytest.approx(4 * costs[1])


def test_depth_derivatives_along_moves_of_single_pixels(camera):
    positions, faces = dome()
    views = DepthRenderer(positions, faces).views(camera) + np.float32(0)
    weights = DepthWeights(limit=1.0, border_sigma=np.inf, border_limit=np.inf)
    objective = DepthViews(located(views, camera), faces, weights=weights)
    x, y, _ = positions.T
    moves = np.stack([np.column_stack([np.sin(20 * y), 0 * x, np.cos(15 * x)]), positions])
    found = objective.linearised(positions, objective.start)
    step = 1e-6
    for move, column in zip(moves, found.along(moves).T, strict=True):
        plus, minus = (objective.residuals(positions + sign * step * move, objective.start)
                       for sign in (1, -1))
        assert len(plus) == len(minus) == len(column)
        difference = (plus - minus) / (2 * step)
        close = np.abs(difference - column) < 1e-3 * np.abs(column).max()
        assert close.mean() > 0.99  # the others' rays change to the next triangle


def test_turn_and_pose_are_found_from_one_shape(compared):
    positions, objective = compared
    off = np.array([0.05, 0.01, -0.008, 3e-3, -2e-3, 2e-3, 0, 0, 0, 0.01, 1.0])
    found = fit_nuisances(objective, positions, objective.start + off)
    assert np.abs((found - objective.start) / objective.scale)[:6].max() < 0.15


def test_points_of_the_views_lie_on_the_shape(compared):
    _, objective = compared
    points, normals = objective.points(objective.start)
    x, y, z = points.T
    height = -3.0 * (x**2 + y**2) - 0.006 * np.sin(30 * x) * np.cos(25 * y + 0.4)
    assert np.abs(z - height).max() < 5e-4  # between the vertices the mesh is flat
    assert np.linalg.norm(normals, axis=1) == pytest.approx(1.0)
    assert (normals[:, 2] > 0.3).mean() > 0.99  # seen from above


def test_a_specimen_is_laid_on_a_cone_at_its_own_arc_lengths():
    rig = Rig()
    slope = math.radians(50)
    rng = np.random.default_rng(3)
    arc = rng.uniform(0, 0.18, 60000)
    azimuth = rng.uniform(0, 2 * np.pi, 60000)
    radius = rig.plate_radius + arc * math.cos(slope)
    cone = np.column_stack([radius * np.cos(azimuth), radius * np.sin(azimuth),
                            -arc * math.sin(slope)])
    disc = rng.uniform(0, rig.plate_radius, 20000), rng.uniform(0, 2 * np.pi, 20000)
    top = np.column_stack([disc[0] * np.cos(disc[1]), disc[0] * np.sin(disc[1]), 0 * disc[0]])
    side = np.linspace(-0.15, 0.15, 31)
    rest = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    placed = surface_positions(rest, np.concatenate([cone, top]), rig)
    beyond = np.maximum(np.linalg.norm(rest, axis=1) - rig.plate_radius, 0)
    reach = np.hypot(placed[:, 0], placed[:, 1])
    outside = beyond > 0
    expected = rig.plate_radius + beyond * math.cos(slope)
    assert np.abs(reach - expected)[outside].max() < 3e-3
    assert np.abs(placed[:, 2] + beyond * math.sin(slope))[outside].max() < 3e-3
    assert placed[~outside, :2] == pytest.approx(rest[~outside])


class Linear:
    """Residuals A x - b between bounds."""

    def __init__(self, matrix: np.ndarray, target: np.ndarray, start: np.ndarray) -> None:
        self.matrix, self.target, self.start = matrix, target, start
        self.low, self.high = np.full(len(start), -2.0), np.full(len(start), 2.0)
        self.evaluations = 0

    def value(self, x: np.ndarray) -> float:
        self.evaluations += 1
        residuals, _ = self.linearised(x)
        return 0.5 * float(residuals @ residuals)

    def linearised(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self.matrix @ x - self.target, self.matrix


class Valley(Linear):
    """Rosenbrock's function, without a value beyond a wall."""

    def __init__(self, wall: float = math.inf) -> None:
        super().__init__(np.eye(2), np.zeros(2), np.array([-1.2, 1.0]))
        self.wall = wall

    def value(self, x: np.ndarray) -> float:
        value = super().value(x)
        return value if x[0] < self.wall else math.inf

    def linearised(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return (np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]]),
                np.array([[-20 * x[0], 10.0], [-1.0, 0.0]]))


START_VALUE = 0.5 * (4.4**2 + 2.2**2)


def linear(seed: int) -> Linear:
    rng = np.random.default_rng(seed)
    return Linear(rng.standard_normal((9, 4)), rng.standard_normal(9) * 4, rng.uniform(-1, 1, 4))


@pytest.mark.parametrize("seed", range(3))
def test_bounded_linear_problems_are_solved(seed):
    problem = linear(seed)
    expected = lsq_linear(problem.matrix, problem.target, (-2, 2))
    outcome = minimise(problem, limits=Limits(evaluations=200, step=1e-9, decrease=1e-12))
    assert outcome.value == pytest.approx(expected.cost, rel=1e-6)
    assert np.abs(outcome.x - expected.x).max() < 1e-3


def test_a_bent_valley_is_followed_to_its_end_but_not_through_a_wall_of_failed_simulations():
    problem, walled = Valley(), Valley(wall=0.3)
    outcome = minimise(problem, limits=Limits(2000, step=1e-8, decrease=1e-12))
    assert outcome.status is Status.CONVERGED
    assert outcome.evaluations == problem.evaluations <= 40
    assert np.abs(outcome.x - 1).max() < 1e-2 and outcome.value < 1e-6
    outcome = minimise(walled, limits=Limits(120))
    assert walled.evaluations <= 120
    assert outcome.value < 0.5 * START_VALUE and outcome.x[0] < 0.3
    outcome = minimise(Valley(wall=-2.0))  # no value at the start
    assert outcome.status is Status.FAILED and outcome.value == math.inf


def test_what_nothing_depends_on_keeps_its_value():
    problem = linear(0)
    problem.matrix[:, 2] = 0.0
    outcome = minimise(problem, limits=Limits(evaluations=50, step=1e-9))
    assert outcome.x[2] == pytest.approx(problem.start[2], abs=1e-6)
    assert outcome.status is Status.CONVERGED


def test_the_limit_is_kept_and_every_evaluation_reported():
    problem, reports = Valley(), []
    outcome = minimise(problem, limits=Limits(7, step=1e-12, decrease=1e-15),
                       report=partial(reports.append, None))
    assert problem.evaluations == outcome.evaluations == len(reports) == 7
    assert outcome.status is Status.EXHAUSTED


def test_the_result_is_never_worse_than_the_start():
    class Wrong(Valley):
        def linearised(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            residuals, jacobian = super().linearised(x)
            return residuals, -jacobian

    outcome = minimise(Wrong(), limits=Limits(30))
    assert outcome.value <= START_VALUE and outcome.status is Status.STALLED


def before() -> Estimate:
    deviation = np.array([0.3, 0.2, 0.3, 3e-4, 2e-4, 3e-4])
    samples = THETA + deviation * np.random.default_rng(0).normal(size=(1000, 6))
    cloth = ClothProperties(samples, np.zeros((1000, 2)), np.full(1000, 600.0), np.full(1000, 0.2))
    return Estimate(cloth, DIRECTIONS, 0.15, np.append(SPREAD, 0.5))


@pytest.fixture(scope="module")
def draped() -> Drape:
    return drape(fabric_from_theta(THETA), edge=8e-3)


def run(
    shape: Drape, monkeypatch: pytest.MonkeyPatch, *, start_value: float = 50.0
) -> tuple[refine.Refinement, dict]:
    """A refinement whose search finds ``shape`` with known uncertainties."""
    asked = {}

    def search(
        _: CapturedViews, starts: list[Unknowns], *, free: list[str], **more
    ) -> SearchResult:
        asked.update(starts=starts, free=free)
        names = (*(name for name in NAMES if name in free), "turn")
        objective = CapturedViews(seen, turn=0.5, edge=8e-3, coarse=8e-3).objective(8e-3)
        nuisance = objective.start
        trial = Trial(np.zeros(len(names)), Unknowns.of(THETA + 0.1), nuisance, shape, 10.0, 10.0)
        return SearchResult(trial, objective, Effort(), start_value, Uncertainty(
            names, 0.01 * np.eye(len(names)), 1.0), shape, Status.CONVERGED, "")

    monkeypatch.setattr(refine, "search", search)
    camera = nominal_camera()
    views = DepthRenderer(shape.positions, shape.faces).views(camera, 0.5).astype(np.float32)
    seen = located(views, camera)
    result = refine.refine_capture(
        before().cloth, seen, HEADER, density=0.15, warp=0.5, face=-1,
        settings=read_option("refine", "simulation") | {"edge_mm": 8.0})
    return result, asked


def test_samples_are_those_of_the_network_and_as_many_of_the_search(draped, monkeypatch):
    result, asked = run(draped, monkeypatch)
    network, searched = np.split(result.draws.cloth.theta, 2)
    np.testing.assert_allclose(network.mean(axis=0), before().samples.mean(axis=0))
    np.testing.assert_allclose(network.std(axis=0),
                               refine.NARROWED * before().samples.std(axis=0))
    assert searched.mean(axis=0)[:3] == pytest.approx(THETA[:3] + 0.1, abs=0.02)
    assert searched.std(axis=0)[0] == pytest.approx(refine.NARROWED * 0.1, rel=0.1)
    assert result.searched.mean[:6] == pytest.approx(THETA + 0.1)
    mean = np.array(result.content["posterior"]["mean"])
    assert mean[:6] == pytest.approx(result.draws.cloth.theta.mean(axis=0))
    assert result.draws.known and not result.warnings
    assert result.resimulation.overlap > 0.97
    membrane = result.content["specimen"]["membrane_n_per_m"]
    assert membrane["interval_68"][1] / membrane["median"] == pytest.approx(math.exp(0.1))
    assert membrane["median"] == pytest.approx(200 * 0.15 / 0.3)  # of the fabric of 150 g/m²
    assert len(asked["starts"]) == 3
    np.testing.assert_allclose(asked["starts"][0].theta, before().theta, rtol=1e-12)


def test_a_refinement_that_gains_nothing_leaves_the_network_its_answer(draped, monkeypatch):
    result, _ = run(draped, monkeypatch, start_value=10.2)
    assert result.draws is None
    assert "refinement_no_better" in [found.code for found in result.warnings]


@pytest.mark.parametrize(("displacement", "warning"), [
    (3.0, None), (12.0, "12 mm from the scan"), (None, "does not come to rest")])
def test_cloth_released_at_a_scan_stays_there(displacement, warning):
    near = displacement and Fidelity(displacement, 1.0, 70.0, 70.0)
    warnings = texts(refine._scan_warnings(near))
    assert len(warnings) == (warning is not None) and (warning or "") in "".join(warnings)
