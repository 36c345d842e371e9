"""The search for the specimen that a capture shows, the same for views and for scans.

On a mesh a drape has many equilibria close to each other, a millimetre or two apart: its folds
stick where the mesh lets them. A free simulation ends in one of them, the captured cloth in none,
and the difference would be charged to the moduli. So a specimen is pulled onto the captured surface
(:mod:`.attraction`), which finds the folds, and weak springs hold it there: one equilibrium is
left, which moves smoothly with the moduli. The right fabric needs the springs little; a wrong one
pulls at them, which shows in the same residuals, only smaller. Several fabrics begin, and
Levenberg-Marquardt goes on from the best; then the specimen is pulled again, for the first shape
was that of a wrong fabric, seen from a little beside.
"""

import math
import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from common.ctrl_c import require_interruption
from data.cameras import Camera
from drapenet.refine.attraction import (
    Springs,
    captured_shape,
    nearest_points,
    plane_springs,
    spring_stiffness,
)
from drapenet.refine.cloth import Cloth, Knowledge
from drapenet.refine.depth import DepthViews, DepthWeights
from drapenet.refine.objective import Objective, fit_nuisances
from drapenet.refine.optimisers import Limits, Status, minimise
from drapenet.refine.problem import Effort, Hold, Problem, Trial, Uncertainty, laplace
from drapenet.refine.surface import CapturedShape, RobustPositions
from sim.drape import DrapeResult
from sim.mesh.specimens import make_specimen
from sim.newton import NewtonOptions
from sim.scene import Rig
from sim.sensitivity import follow

REACH = 6e-3  # m, beyond which a captured point does not hold cloth
MIN_DECREASE = 3e-3  # share of the value that a step must promise
MIN_IMPROVEMENT = 0.5  # of the logarithm of the probability, below which nothing was gained
RELEASE = NewtonOptions(residual=1e-2, step=1e-2, max_iterations=200)
"""When cloth that is let go is at rest well enough to be looked at."""

Progress = Callable[[int, float], None]
"""Called after each simulation with the number of simulations so far and the best value."""


@dataclass(frozen=True)
class Round:
    """One search on one mesh.

    Attributes:
        edge: m, of its edges at the plate's rim.
        pulls: force of the springs at 1 mm, over the cloth's weight, one after the other.
        evaluations: simulations with each of them at most, beside those of the starts.
    """

    edge: float
    pulls: tuple[float, ...]
    evaluations: int


@dataclass(frozen=True)
class Held:
    """Cloth on the captured surface: where it lies, what holds it there, what it is compared by."""

    near: DrapeResult
    springs: Callable[[float], Hold]
    objective: Objective


class Seen(Protocol):
    """Something captured.

    Attributes:
        rounds: in which it is searched for.
    """

    rounds: tuple[Round, ...]

    def held(self, level: Round, cloth: Cloth, nuisance: np.ndarray | None) -> Held:
        """A specimen on the surface as it is seen with the objective's parameters ``nuisance``."""


class CapturedViews:
    """Depth views of a drape (:class:`Seen`).

    Args:
        views: (K, H, W) z-depth, m, background 0.
        camera: of all of them, as well as it is known.
        turns: (K,) rad, how far the table had turned in each view.
        turn: direction of the warp in the first view, rad, as well as it is known.
        rig: with a plate.
        edge: m, at the rim of the specimen's mesh in the last round; coarse: in those before, which
            find folds, pose and most of the fabric.
    """

    def __init__(
        self, views: np.ndarray, camera: Camera, *, turns: Sequence[float], turn: float, rig: Rig,
        edge: float, coarse: float,
    ) -> None:
        self._views, self._camera, self._rig = views, camera, rig
        self._turns, self._turn = turns, turn
        self._objectives: dict[float, DepthViews] = {}
        coarse = max(edge, coarse)
        self.rounds = (Round(coarse, (0.3,), 3), Round(coarse, (0.1, 0.03), 4),
                       Round(edge, (0.03, 0.01, 0.003), 3))

    def objective(self, edge: float) -> DepthViews:
        """The objective of the mesh with these edges at the rim."""
        if edge not in self._objectives:
            mesh = make_specimen(self._rig, edge=edge).mesh
            self._objectives[edge] = DepthViews(
                self._views, self._camera, mesh.faces, turns=self._turns, turn=self._turn,
                weights=DepthWeights().on_mesh(edge))
        return self._objectives[edge]

    def held(self, level: Round, cloth: Cloth, nuisance: np.ndarray | None) -> Held:
        """See :class:`Seen`."""
        objective = self.objective(level.edge)
        points = objective.points(objective.start if nuisance is None else nuisance)
        shape = captured_shape(cloth.fabric, *points, rig=self._rig, edge=level.edge)
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
    """What a search has found.

    Attributes:
        best: the best trial, held to the surface by weak springs.
        objective: it was compared by.
        start_value: of the first start, by the last round's objective; None where that did not
            converge.
        uncertainty: None where the drape has no derivatives, or after an interruption.
        released: the best cloth let go; None where it did not come to rest.
        effort: spent on all.
        seconds: in all.
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
    """The specimen that ``seen`` shows; None where no cloth converges on its surface.

    Interrupted from the keyboard, it hands back the best so far.

    Args:
        starts: all begin; the last round compares with the first of them.
        free: names of :data:`.cloth.UNKNOWNS` that are unknown.
        known: of them beforehand.
    """
    run = _Run(seen, free, known, progress)
    try:
        cloths = starts
        for number, level in enumerate(seen.rounds):
            last = number == len(seen.rounds) - 1
            run.round(level, cloths, first=starts[0] if last else None)
            if run.problem is None:
                return None
            cloths = [run.problem.best.cloth]
        run.conclude()
    except (KeyboardInterrupt, SystemError) as error:
        require_interruption(error)
        if run.problem is None or run.problem.best is None:
            raise KeyboardInterrupt from None
        run.status, run.message = Status.INTERRUPTED, "interrupted; the best so far"
    return Found(run.problem.best, run.problem.objective, run.start_value, run.uncertainty,
                 run.released, run.effort, time.perf_counter() - run.began, run.status, run.message)


class _Run:
    """One search: the problem under way, and what was found."""

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
        """Hold all ``cloths`` to the surface, and go on from the one that it fits best, while the
        springs become weaker; in the end compare with ``first``.
        """
        before = self.problem
        nuisance, error_scale = (before.best.nuisance, before.error_scale) if before else (None, 1.0)
        held = self.seen.held(level, cloths[0], nuisance)
        tried = [self.problem_at(held, held.near, cloth, nuisance, level.pulls[0], error_scale)
                 for cloth in cloths]
        tried = [problem for problem in tried if problem.best is not None]
        if not tried:
            return  # the round before stands
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
        """The problem that begins with ``cloth``, seen from where that fits best."""
        problem = Problem(near, cloth, held.objective, free=self.free, known=self.known,
                          rest=held.near.rest, nuisance=nuisance, hold=held.springs(pull),
                          error_scale=error_scale, effort=self.effort)
        problem.value(problem.start)
        if problem.best is not None:
            self.problem = self.problem or problem  # for whoever interrupts the first round
            best = problem.best
            nuisance = fit_nuisances(problem.objective, best.drape.positions, best.nuisance)
            problem.value(np.concatenate([best.x[: problem.cloths],
                                          nuisance / problem.objective.scale]))
        self.report(problem)
        return problem

    def minimise(self, problem: Problem, evaluations: int) -> None:
        """Levenberg-Marquardt from the best trial of ``problem``, which is then the one."""
        self.problem = problem
        problem.weigh()
        problem.start = problem.best.x
        outcome = minimise(
            problem, limits=Limits(evaluations=evaluations + 1, decrease=MIN_DECREASE),
            report=lambda *_: self.report(problem))
        if outcome.status is Status.INTERRUPTED:
            raise KeyboardInterrupt
        self.status, self.message = outcome.status, outcome.message

    def conclude(self) -> None:
        """How certain the best is, how well the first start does, and the free drape."""
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
