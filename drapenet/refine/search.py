"""Search for the captured specimen, from views or scans.

On a mesh a drape has many equilibria a millimetre or two apart, because folds lock to the mesh. A
free simulation ends in one of them, the captured cloth in none, and the difference would bias the
moduli. The specimen is therefore pulled onto the captured surface (:mod:`.attraction`), which gives
the folds, and held there by weak springs: the equilibrium is unique and moves smoothly with the
moduli. The springs carry little load for the right fabric and more for a wrong one, which shows in
the same residuals, only smaller. All initial fabrics are evaluated, and Levenberg-Marquardt
continues from the best; then the specimen is pulled again, with the improved fabric and pose.
"""

import math
import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from common.types import Metres, Radians
from drapenet.refine.depth import DepthViews, DepthWeights
from drapenet.refine.minimise import Limits, Status, minimise
from drapenet.refine.objective import Objective, fit_nuisances
from drapenet.refine.problem import Effort, Hold, Problem, Trial, Uncertainty, laplace
from drapenet.refine.springs import (
    Springs,
    captured_shape,
    nearest_points,
    plane_springs,
    spring_stiffness,
)
from drapenet.refine.surface import CapturedShape, RobustPositions
from drapenet.refine.unknowns import Cloth, Knowledge
from drapenet.views.located import LocatedViews
from sim.drape import DrapeResult
from sim.mesh.specimen import make_specimen
from sim.sensitivity import follow
from sim.solver.newton import NewtonOptions

REACH = 6e-3  # m, maximum distance of a vertex from the captured point that holds it
MIN_DECREASE = 3e-3  # predicted decrease of a step, relative to the value
MIN_IMPROVEMENT = 0.5  # of the log probability over the initial estimate
RELEASE = NewtonOptions(residual=1e-2, step=1e-2, max_iterations=200)
"""Tolerances of the released drape, which is for display and a check."""

Progress = Callable[[int, float], None]
"""Called after each simulation with the number of simulations so far and the best value."""


@dataclass(frozen=True)
class Round:
    """One search on one mesh.

    Attributes:
        edge: m, of its edges at the plate's rim.
        pulls: force of the springs at 1 mm, over the cloth's weight, in turn.
        evaluations: maximum simulations for each pull, without those of the starts.
    """

    edge: float
    pulls: tuple[float, ...]
    evaluations: int


@dataclass(frozen=True)
class Held:
    """Cloth on the captured surface: its shape, springs that hold it, and objective."""

    near: DrapeResult
    springs: Callable[[float], Hold]
    objective: Objective


class Seen(Protocol):
    """A captured drape, as views or as a scan.

    Attributes:
        rounds: of the search.
    """

    rounds: tuple[Round, ...]

    def held(self, level: Round, cloth: Cloth, nuisance: np.ndarray | None) -> Held:
        """A specimen on the surface that corresponds to the objective's ``nuisance`` (K,)."""


class CapturedViews:
    """Depth views of a drape (:class:`Seen`).

    Args:
        located: the views; pose and turns are initial guesses.
        turn: direction of the warp in the first view, rad, initial guess.
        edge: m, mesh edge at the rim in the last round; coarse: in the rounds before, which
            determine folds, pose and most of the fabric.
    """

    def __init__(
        self, located: LocatedViews, *, turn: Radians, edge: Metres, coarse: Metres
    ) -> None:
        self._located, self._turn = located, turn
        self._objectives: dict[float, DepthViews] = {}
        coarse = max(edge, coarse)
        self.rounds = (Round(coarse, (0.3,), 3), Round(coarse, (0.1, 0.03), 4),
                       Round(edge, (0.03, 0.01, 0.003), 3))

    def objective(self, edge: float) -> DepthViews:
        """The objective of the mesh with these edges at the rim."""
        if edge not in self._objectives:
            mesh = make_specimen(self._located.rig, edge=edge).mesh
            self._objectives[edge] = DepthViews(self._located, mesh.faces, turn=self._turn,
                                                weights=DepthWeights().on_mesh(edge))
        return self._objectives[edge]

    def held(self, level: Round, cloth: Cloth, nuisance: np.ndarray | None) -> Held:
        """See :class:`Seen`."""
        objective = self.objective(level.edge)
        points = objective.points(objective.start if nuisance is None else nuisance)
        shape = captured_shape(cloth.fabric, *points, rig=self._located.rig, edge=level.edge)
        near, at = nearest_points(shape.scene, shape.positions, *points, reach=REACH)

        def springs(pull: float) -> Hold:
            stiffness = spring_stiffness(shape.scene, near, pull)

            def hold(nuisance: np.ndarray) -> Springs:
                points, normals = objective.points(nuisance)
                return Springs(near, points[at], normals[at], stiffness)

            return hold

        return Held(shape, springs, objective)


class CapturedScan:
    """A registered scan of a drape (:class:`Seen`)."""

    rounds = (Round(0.0, (0.05,), 6),)  # of its own mesh

    def __init__(self, shape: CapturedShape) -> None:
        self.shape = shape
        self._objective = RobustPositions(shape.positions, vertices=shape.hanging)

    def held(self, level: Round, cloth: Cloth, nuisance: np.ndarray | None) -> Held:
        """See :class:`Seen`."""
        near = self.shape.as_drape(cloth.fabric)

        def springs(pull: float) -> Hold:
            held = plane_springs(near.scene, near.positions, pull=pull)
            return lambda _: held

        return Held(near, springs, self._objective)


@dataclass
class Found:
    """Result of a search.

    Attributes:
        best: the best trial, held to the surface by weak springs.
        objective: of the last round.
        start_value: of the first start with that objective; None if it did not converge.
        uncertainty: None if the drape has no derivatives, or after an interruption.
        released: drape of the best cloth without springs; None if it did not converge.
        effort: simulations of all rounds.
        seconds: total time.
        status, message: how it ended.
    """

    best: Trial
    objective: Objective
    start_value: float | None
    uncertainty: Uncertainty | None
    released: DrapeResult | None
    effort: Effort
    seconds: float
    status: Status
    message: str

    @property
    def improved(self) -> bool:
        """Whether the cloth found explains the capture better than the first start."""
        return self.start_value is None or self.best.value < self.start_value - MIN_IMPROVEMENT


def search(
    seen: Seen,
    starts: Sequence[Cloth],
    *,
    free: Collection[str],
    known: Knowledge | None = None,
    progress: Progress | None = None,
) -> Found | None:
    """Search for the specimen that ``seen`` shows; None if no cloth converges on its surface.

    Args:
        starts: initial guesses; the result is compared with the first of them.
        free: names of the free parameters of :data:`.cloth.UNKNOWNS`.
        known: prior; None for none.
    """
    run = _Run(seen, free, known, progress)
    cloths = starts
    for number, level in enumerate(seen.rounds):
        last = number == len(seen.rounds) - 1
        run.round(level, cloths, first=starts[0] if last else None)
        if run.problem is None:
            return None
        cloths = [run.problem.best.cloth]
    run.conclude()
    return Found(run.problem.best, run.problem.objective, run.start_value, run.uncertainty,
                 run.released, run.effort, time.perf_counter() - run.began, run.status, run.message)


class _Run:
    """State of a search: present problem and results."""

    def __init__(
        self, seen: Seen, free: Collection[str], known: Knowledge | None, progress: Progress | None
    ) -> None:
        self.seen, self.free, self.known, self.progress = seen, free, known, progress
        self.began, self.effort = time.perf_counter(), Effort()
        self.problem: Problem | None = None
        self.first: Trial | None = None
        self.start_value: float | None = None
        self.uncertainty: Uncertainty | None = None
        self.released: DrapeResult | None = None
        self.status, self.message = Status.FAILED, ""

    def round(self, level: Round, cloths: Sequence[Cloth], *, first: Cloth | None) -> None:
        """Hold all ``cloths`` to the surface and optimise from the one that fits best, with springs
        of decreasing stiffness; finally evaluate ``first``.
        """
        before = self.problem
        nuisance, error_scale = None, 1.0
        if before:
            nuisance, error_scale = before.best.nuisance, before.error_scale
        held = self.seen.held(level, cloths[0], nuisance)
        tried = [self.problem_at(held, held.near, cloth, nuisance, level.pulls[0], error_scale)
                 for cloth in cloths]
        tried = [problem for problem in tried if problem.best is not None]
        if not tried:
            return  # keep the result of the previous round
        self.minimise(min(tried, key=lambda one: one.best.value), level.evaluations)
        for pull in level.pulls[1:]:
            best = self.problem.best
            problem = self.problem_at(held, best.drape, best.cloth, best.nuisance, pull,
                                      self.problem.error_scale)
            if problem.best is None:
                return
            self.minimise(problem, level.evaluations)
        if first is not None:
            near = self.problem.best.drape
            self.first = self.problem_at(held, near, first, self.problem.best.nuisance,
                                         level.pulls[-1], self.problem.error_scale).best

    def problem_at(
        self, held: Held, near: DrapeResult, cloth: Cloth, nuisance: np.ndarray | None, pull: float,
        error_scale: float,
    ) -> Problem:
        """The problem with initial guess ``cloth``, evaluated, with fitted nuisances."""
        problem = Problem(near, cloth, held.objective, free=self.free, known=self.known,
                          rest=held.near.rest, nuisance=nuisance, hold=held.springs(pull),
                          error_scale=error_scale, effort=self.effort)
        problem.value(problem.start)
        if problem.best is not None:
            self.problem = self.problem or problem  # result if the first round is interrupted
            best = problem.best
            nuisance = fit_nuisances(problem.objective, best.drape.positions, best.nuisance)
            problem.value(np.concatenate([best.x[: problem.cloths],
                                          nuisance / problem.objective.scale]))
        self.report(problem)
        return problem

    def minimise(self, problem: Problem, evaluations: int) -> None:
        """Run Levenberg-Marquardt from the best trial of ``problem``, the new present problem."""
        self.problem = problem
        problem.weigh()
        problem.start = problem.best.x
        outcome = minimise(
            problem, limits=Limits(evaluations=evaluations + 1, decrease=MIN_DECREASE),
            report=lambda *_: self.report(problem))
        self.status, self.message = outcome.status, outcome.message

    def conclude(self) -> None:
        """Compute the uncertainty of the best, the first start's value and the released drape."""
        problem = self.problem
        problem.weigh()
        best = problem.best
        if self.first is not None:
            self.start_value = problem.total(self.first)
        self.uncertainty = laplace(problem, best)
        self.effort.solves += 1
        free = follow(best.drape, best.cloth.fabric, options=RELEASE)
        self.released = free if free.converged else None

    def report(self, problem: Problem) -> None:
        """Report the progress."""
        if self.progress:
            best = problem.best
            self.progress(self.effort.solves, best.value if best else math.inf)
