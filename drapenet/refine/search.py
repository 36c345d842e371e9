"""Search for the captured specimen, from views or a scan.

On a mesh a drape has many equilibria a millimetre or two apart, because folds lock to the mesh,
which would bias the moduli. The specimen is therefore pulled onto the captured surface and held by
weak springs: the equilibrium is unique and moves smoothly with the moduli.
"""

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Protocol

import numpy as np

from common.types import Metres, Radians
from drapenet.refine.depth import DepthViews, DepthWeights
from drapenet.refine.minimise import Limits, Outcome, Status, minimise
from drapenet.refine.objective import Nuisance, Objective, fit_nuisances
from drapenet.refine.positions import RobustPositions
from drapenet.refine.problem import Effort, Problem, Trial, Uncertainty, laplace
from drapenet.refine.unknowns import SpecimenPrior, Unknowns
from drapenet.surface.shape import CapturedShape
from drapenet.surface.springs import (
    Springs,
    Surface,
    captured_shape,
    nearest_points,
    plane_springs,
    springs_to,
)
from drapenet.views.located import LocatedViews
from sim.draping import Drape, follow
from sim.scene import make_specimen
from sim.solver.newton import NewtonOptions

REACH = 6e-3  # m, maximum distance of a vertex from the captured point that holds it
MIN_DECREASE = 3e-3  # predicted decrease of a step, relative to the value
MAX_JUMP = 3.0
"""Growth of the misfit, or of half the number of measurements if that is larger, at which cloth is
taken to have left the captured folds: springs are not made softer."""
MIN_IMPROVEMENT = 0.5  # of the log probability over the initial estimate
RELEASE = NewtonOptions(residual=1e-2, step=1e-2, max_iterations=200)  # for display and a check

Progress = Callable[[int], None]
"""Called after each simulation with their number."""


@dataclass(frozen=True)
class Round:
    """One search on one mesh."""

    edge: Metres  # at the plate's rim
    pulls: tuple[float, ...]  # force of the springs at 1 mm, over the cloth's weight, in turn
    evaluations: int  # maximum for each pull, without those of the starts


@dataclass(frozen=True)
class Anchored:
    """Cloth on the captured surface: its shape, objective, and springs of a pull that hold it."""

    near: Drape
    objective: Objective
    springs: Callable[[float, Nuisance], Springs]


class CapturedDrape(Protocol):
    """A captured drape, as views or as a scan, and the rounds of the search."""

    rounds: tuple[Round, ...]

    def anchored(self, level: Round, unknowns: Unknowns, nuisance: Nuisance | None) -> Anchored:
        """A specimen on the surface that corresponds to the objective's ``nuisance``."""


class CapturedViews:
    """Depth views of a drape; pose and ``turn``, the direction of the warp in the first view, are
    initial guesses. Only the last round has a mesh finer than ``coarse``.
    """

    def __init__(
        self, located: LocatedViews, *, turn: Radians, edge: Metres, coarse: Metres
    ) -> None:
        self._located, self._turn = located, turn
        self._objectives: dict[float, DepthViews] = {}
        coarse = max(edge, coarse)
        # Nothing is estimated under the strongest springs, with which any moduli fit.
        self.rounds: tuple[Round, ...] = (
            Round(coarse, (0.3,), 0), Round(coarse, (0.1, 0.03, 0.01), 3),
            Round(edge, (0.01, 0.003), 5))

    def objective(self, edge: Metres) -> DepthViews:
        if edge not in self._objectives:
            mesh = make_specimen(self._located.rig, edge=edge).mesh
            self._objectives[edge] = DepthViews(self._located, mesh.faces, turn=self._turn,
                                                weights=DepthWeights().on_mesh(edge))
        return self._objectives[edge]

    def anchored(self, level: Round, unknowns: Unknowns, nuisance: Nuisance | None) -> Anchored:
        objective = self.objective(level.edge)
        points = objective.points(objective.start if nuisance is None else nuisance)
        surface = Surface(*points, self._located.rig)
        shape = captured_shape(unknowns.fabric, surface, edge=level.edge)
        near, at = nearest_points(shape.scene, shape.positions, *points, reach=REACH)

        def springs(pull: float, nuisance: Nuisance) -> Springs:
            points, normals = objective.points(nuisance)
            return springs_to(points[at], normals[at], shape.scene, near, pull)

        return Anchored(shape, objective, springs)


class CapturedScan:
    """A registered scan of a drape (:class:`CapturedDrape`)."""

    rounds: tuple[Round, ...] = (Round(0.0, (0.05,), 6),)  # of its own mesh

    def __init__(self, shape: CapturedShape) -> None:
        self._shape = shape
        self._objective = RobustPositions(shape.positions, vertices=shape.hanging)

    def anchored(self, level: Round, unknowns: Unknowns, nuisance: Nuisance | None) -> Anchored:
        near = self._shape.as_drape(unknowns.fabric)

        def springs(pull: float, nuisance: Nuisance) -> Springs:
            return plane_springs(near.scene, near.positions, pull=pull)

        return Anchored(near, self._objective, springs)


@dataclass
class SearchResult:
    """Result of a search."""

    best: Trial  # held to the surface by weak springs
    objective: Objective  # of the last round
    effort: Effort
    start_value: float | None  # of the first start with that objective, if it converged
    uncertainty: Uncertainty | None  # None if the drape has no derivatives
    released: Drape | None  # without springs; None if it did not converge
    status: Status
    message: str

    @property
    def improved(self) -> bool:
        """Whether the cloth explains the capture better than the first start."""
        return self.start_value is None or self.best.value < self.start_value - MIN_IMPROVEMENT


def search(
    sought: CapturedDrape, starts: Sequence[Unknowns], *, free: Collection[str],
    prior: SpecimenPrior | None = None, progress: Progress | None = None,
) -> SearchResult | None:
    """Search for the observed specimen; None if no cloth converges on its surface.

    All ``starts`` are evaluated, and Levenberg-Marquardt continues from the best. ``free``: names
    of the free parameters of :data:`.unknowns.NAMES`.
    """
    run = _Run(sought, free, prior, progress)
    guesses: Sequence[Unknowns] = starts
    for level in sought.rounds:
        last = level is sought.rounds[-1]
        run.round(level, guesses, first=starts[0] if last else None)
        if run.problem is None:
            return None
        guesses = [run.problem.optimum.unknowns]
    problem, outcome = run.problem, run.outcome
    assert problem and outcome  # of the last round
    problem.weigh()
    best = problem.optimum
    start_value = problem.total(run.first) if run.first else None
    uncertainty = laplace(problem, best)
    run.effort.solves += 1
    released = follow(best.drape, best.unknowns.fabric, options=RELEASE)
    return SearchResult(best, problem.objective, run.effort, start_value, uncertainty,
                        released if released.converged else None, outcome.status,
                        outcome.message)


@dataclass
class _Run:
    """State of a search."""

    sought: CapturedDrape
    free: Collection[str]
    prior: SpecimenPrior | None
    progress: Progress | None
    effort: Effort = field(default_factory=Effort)
    problem: Problem | None = None  # the present one
    outcome: Outcome | None = None  # of its optimisation
    first: Trial | None = None  # of the first start

    def round(self, level: Round, guesses: Sequence[Unknowns], *, first: Unknowns | None) -> None:
        """Optimise from the best of ``guesses`` with ever softer springs, evaluate ``first``."""
        nuisance = self.problem.optimum.nuisance if self.problem else None
        anchored = self.sought.anchored(level, guesses[0], nuisance)
        problems = [self.problem_at(anchored, anchored.near, guess, nuisance, level.pulls[0])
                    for guess in guesses]
        values = [problem.best.value if problem.best else math.inf for problem in problems]
        if min(values) == math.inf:
            return  # keep the result of the previous round
        kept = problems[int(np.argmin(values))]
        outcome = self.minimise(kept, level.evaluations)
        held = level.pulls[0]
        for pull in level.pulls[1:]:
            best = kept.optimum
            problem = self.problem_at(anchored, best.drape, best.unknowns, best.nuisance, pull)
            if problem.best is None:
                return
            after = self.minimise(problem, level.evaluations)
            if problem.optimum.misfit > MAX_JUMP * max(best.misfit, kept.measurements / 2):
                self.problem, self.outcome = kept, outcome
                break
            kept, outcome, held = problem, after, pull
        if first is not None:
            best = kept.optimum
            self.first = self.problem_at(anchored, best.drape, first, best.nuisance, held).best

    def problem_at(
        self, anchored: Anchored, near: Drape, guess: Unknowns, nuisance: Nuisance | None,
        pull: float,
    ) -> Problem:
        """The problem with an initial guess, evaluated, with fitted nuisances."""
        problem = Problem(near, guess, anchored.objective, free=self.free, prior=self.prior,
                          rest=anchored.near.rest, nuisance=nuisance,
                          springs=partial(anchored.springs, pull), effort=self.effort,
                          error_scale=self.problem.error_scale if self.problem else 1.0)
        problem.value(problem.start)
        if problem.best is not None:
            best = problem.best
            nuisance = fit_nuisances(problem.objective, best.drape.positions, best.nuisance)
            problem.value(np.concatenate([best.x[: problem.size],
                                          nuisance / problem.objective.scale]))
        self.report()
        return problem

    def minimise(self, problem: Problem, evaluations: int) -> Outcome:
        """Run Levenberg-Marquardt from the best trial of ``problem``, the new present problem."""
        self.problem = problem
        problem.weigh()
        problem.start = problem.optimum.x
        self.outcome = minimise(
            problem, limits=Limits(evaluations=evaluations + 1, decrease=MIN_DECREASE),
            report=self.report)
        return self.outcome

    def report(self) -> None:
        if self.progress:
            self.progress(self.effort.solves)
