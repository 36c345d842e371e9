"""The search for the cloth of a captured shape, within a number of simulations.

Real cloth rests where friction lets it, a scan's vertices slide along the cloth, and a mesh has
many equilibria near each other. So there are two questions, and the answers differ.

*Which cloth is it?* Weak springs hold the cloth to the captured surface, across it only. One
equilibrium remains, which moves smoothly with the moduli; the right ones need the springs least.

*Which drape comes nearest?* Let go at once, cloth keeps the captured folds or loses some, and the
distance jumps with the moduli. So the springs are weakened step by step, and at each step the
moduli follow, by Levenberg-Marquardt, so that the folds stay. What simulations are left go to the
free drape: an isotropic linear cloth is let go at the captured shape, then the best cloth again, or
a softer one, or one like it, and followed.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from common.ctrl_c import require_interruption
from data.prior.gaussian import GaussianPrior
from drapenet.refine.attraction import Springs, plane_springs
from drapenet.refine.captured import (
    USUAL_MEMBRANE,
    CapturedProblem,
    CapturedShape,
    Cloth,
    Effort,
    Settled,
)
from drapenet.refine.objective import Objective, Sum
from drapenet.refine.optimisers import Limits, Status, minimise
from drapenet.refine.registered import RobustPositions
from drapenet.refine.scan import Outline, border_edges, outline
from sim.drape import DrapeResult

PULL = 0.05
"""Force of the springs at 1 mm, over the cloth's weight. Simulated scans give the same moduli with
0.05 to 0.3; real ones, whose errors the cloth would follow, softer cloth with 0.3."""
HELD = 6  # simulations with these springs at most
RELEASE = (0.02, 0.01, 0.005, 0.002)  # weaker springs, as PULL
EACH, FREED = 2, 2  # simulations with each of them, and without any at most
PLAIN = 0.5  # alpha of isotropic linear cloth over that of softening cloth which drapes like it
SOFTER = 0.4  # of log alpha: softer cloth keeps more of the folds it is let go with
FOLLOW = 3  # simulations along one equilibrium at most
HOPELESS = 1.3  # times the least value: such an equilibrium is not followed
WORTHWHILE = 3e-3  # share of the value that a step along one equilibrium must promise
JUMP = 0.2  # standard deviation of a jump's unknowns, in their units
_AZIMUTHS = 180


@dataclass
class Found:
    """What a search has found.

    Attributes:
        estimate: the cloth, as it hangs under the springs; where none of these simulations ended,
            the nearest; None if none ended at all.
        released: the same cloth let go at the captured shape.
        nearest: the drape nearest to the captured shape, and its cloth.
        effort: spent on all.
    """

    estimate: Settled | None
    released: Settled | None
    nearest: Settled | None
    effort: Effort


def scan_objective(shape: CapturedShape) -> Objective:
    """Of a registered scan: its hanging vertices and, with a third of their say, its outline.

    The outline is what the drape coefficient is made of; alone, vertices leave it 4 points off.
    """
    radii = outline(shape.positions, border_edges(shape.faces), _AZIMUTHS)[0]
    return Sum([RobustPositions.of(shape),
                Outline(shape.faces, radii, sigma=2e-3, limit=1.0, independent=30.0)])


def surface_springs(captured: DrapeResult, pull: float = PULL) -> Springs:
    """What holds a cloth to a captured shape while its moduli are estimated."""
    return plane_springs(captured.scene, captured.positions, pull=pull)


def search_cloth(
    shape: CapturedShape,
    objective: Objective,
    start: Cloth,
    *,
    prior: GaussianPrior | None = None,
    solves: int = 25,
    seed: int = 0,
    report: Callable[[int, float], None] | None = None,
) -> Found:
    """The cloth of ``shape`` and the drape nearest to it, in at most ``solves`` simulations.

    Args:
        start: such as the prior's mean; the first simulation is of it.
        prior: of theta.
        seed: of the jumps.
        report: called after every simulation with their number and the least value, first of the
            held cloth, then of ever more freely hanging ones.

    An interruption ends the search, and the best so far is returned.
    """
    search = _Search(shape, objective, prior, solves, report, Found(None, None, None, Effort()))
    try:
        search.estimate(start)
        search.release(start)
        search.go_on(np.random.default_rng(seed))
    except (KeyboardInterrupt, SystemError) as error:
        require_interruption(error)
    found = search.found
    found.estimate = found.estimate or found.nearest
    return found


class _Search:
    """One search; everything found and spent is in ``found``."""

    def __init__(
        self, shape: CapturedShape, objective: Objective, prior: GaussianPrior | None,
        solves: int, report: Callable[[int, float], None] | None, found: Found,
    ) -> None:
        self.shape, self.objective, self.prior = shape, objective, prior
        self.solves, self.report, self.found = solves, report, found

    @property
    def left(self) -> int:
        return self.solves - self.found.effort.solves

    def problem(self, cloth: Cloth, **how) -> CapturedProblem:
        return CapturedProblem(self.shape, self.objective, cloth, prior=self.prior,
                               effort=self.found.effort, **how)

    def minimise(
        self, problem: CapturedProblem, evaluations: int, keep: Callable[[Settled | None], None]
    ) -> None:
        """Levenberg-Marquardt, keeping the best after each simulation; passes interruptions on."""
        limits = Limits(evaluations=evaluations, decrease=WORTHWHILE)
        outcome = minimise(problem, method="lm", limits=limits,
                           report=lambda *_: keep(problem.best))
        if outcome.status is Status.INTERRUPTED:
            raise KeyboardInterrupt

    def tell(self, best: Settled | None) -> None:
        if self.report and best is not None:
            self.report(self.found.effort.solves, best.value)

    def estimate(self, start: Cloth) -> None:
        """Find the cloth that needs the springs least."""
        captured = self.shape.as_drape(start.fabric)
        problem = self.problem(start, near=captured, springs=[surface_springs(captured)])
        self.minimise(problem, min(HELD, self.solves), self.keep_estimate)

    def release(self, start: Cloth) -> None:
        """Let the estimate go: at once, and again by ever weaker springs that the moduli follow."""
        here = self.found.estimate
        if self.left:
            self.found.released = self.let_go(here.cloth if here else start)
        if here is None:
            return
        captured = self.shape.as_drape(start.fabric)
        for pull in RELEASE:
            if not self.left:
                return
            problem = self.problem(here.cloth, near=here.drape, spread=math.inf,
                                   springs=[surface_springs(captured, pull)])
            self.minimise(problem, min(EACH, self.left), self.tell)
            if problem.best is None:
                return
            here = problem.best
        if self.left:
            problem = self.problem(here.cloth, near=here.drape, spread=math.inf)
            self.minimise(problem, min(FREED, self.left), self.keep_nearest)

    def go_on(self, rng: np.random.Generator) -> None:
        """From the nearest drape to a nearer one, as long as simulations are left."""
        if self.left and self.found.nearest is not None:
            self.attempt(_plain(self.found.nearest.cloth))
        tried, softer = None, False
        while self.left and self.found.nearest is not None:
            best = self.found.nearest
            again, tried = best is not tried, best
            if again:
                self.attempt(best.cloth, known=best.value)
            elif not softer:
                self.attempt(_softened(best.cloth))
                softer = True
            else:
                self.attempt(self.jump(best.cloth, rng))

    def attempt(self, cloth: Cloth, known: float = math.inf) -> None:
        """``cloth`` let go at the captured shape, and followed if it comes near, unless its value
        is ``known``."""
        trial = self.let_go(cloth)
        if trial is None or trial.value >= HOPELESS * self.found.nearest.value:
            return
        if self.left and not math.isclose(trial.value, known, rel_tol=1e-3):
            self.follow(trial)

    def let_go(self, cloth: Cloth) -> Settled | None:
        """``cloth`` let go at the captured shape."""
        problem = self.problem(cloth, spread=math.inf)
        problem.value(problem.start)
        self.keep_nearest(problem.best)
        return problem.best

    def follow(self, trial: Settled) -> None:
        """The best cloth along the equilibrium of ``trial``."""
        problem = self.problem(trial.cloth, near=trial.drape, spread=math.inf)
        problem.best = problem.last = replace(trial, x=problem.start)
        # The first point is known.
        self.minimise(problem, min(FOLLOW, self.left) + 1, self.keep_nearest)

    def jump(self, cloth: Cloth, rng: np.random.Generator) -> Cloth:
        """A cloth like ``cloth``."""
        problem = self.problem(cloth)
        x = problem.start + JUMP * rng.standard_normal(len(problem.start))
        return problem.cloth(np.clip(x, problem.low, problem.high))

    def keep_estimate(self, trial: Settled | None) -> None:
        self.found.estimate = trial
        self.tell(trial)

    def keep_nearest(self, trial: Settled | None) -> None:
        known = self.found.nearest
        if trial is not None and (known is None or trial.value < known.value):
            self.found.nearest = trial
        self.tell(self.found.nearest)


def _plain(cloth: Cloth) -> Cloth:
    """Isotropic linear cloth about as stiff as ``cloth`` is in the folds of a drape."""
    log_alpha = cloth.theta[:3].mean() + math.log(PLAIN)
    return Cloth(np.r_[np.full(3, log_alpha), np.zeros(3)], USUAL_MEMBRANE, cloth.warp)


def _softened(cloth: Cloth) -> Cloth:
    return replace(cloth, theta=cloth.theta - SOFTER * np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]))


def search_curvature(
    shape: CapturedShape, objective: Objective, start: Cloth, near: DrapeResult, *,
    prior: GaussianPrior | None = None, solves: int = 12,
) -> tuple[Settled | None, int]:
    """A natural curvature added to a cloth that has been found, and simulations.

    Args:
        near: its drape, where the first simulation begins.
    """
    problem = CapturedProblem(shape, objective, start, prior=prior, near=near, spread=math.inf,
                              free=np.ones(11, dtype=bool))
    minimise(problem, method="lm", limits=Limits(evaluations=solves))
    return problem.best, problem.effort.solves


def stiffness_only(
    shape: CapturedShape, objective: Objective, alphas: np.ndarray, *, membrane: float = 200.0
) -> list[Settled]:
    """Simulations of isotropic linear fabrics of the moduli ``alphas`` (A,), N·m."""
    settled = []
    for alpha in alphas:
        cloth = Cloth(np.r_[np.full(3, math.log(alpha)), np.zeros(3)], membrane)
        problem = CapturedProblem(shape, objective, cloth)
        problem.value(problem.start)
        if problem.best is not None:
            settled.append(replace(problem.best, cloth=cloth))
    return settled
