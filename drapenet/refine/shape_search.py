"""The search for the cloth of a captured shape, within a number of simulations.

A simulation let go at the captured shape keeps the captured folds or loses some, and there its
value jumps; stiff cloth loses more. So the search begins with a walk along the stiffness alone, to
where most folds are kept, and goes on with Levenberg-Marquardt from there, twice: with the warp
along the first axis, and half-way to the second.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from data.prior.gaussian import GaussianPrior
from drapenet.refine.captured import SCALE, CapturedProblem, CapturedShape, Cloth, Settled
from drapenet.refine.objective import Objective
from drapenet.refine.optimisers import Limits, minimise

STRIDE = 0.4  # of log alpha, in the walk
WALK = 6  # simulations at most
_SECOND_WARP = math.pi / 4


def search_cloth(
    shape: CapturedShape,
    objective: Objective,
    start: Cloth,
    *,
    prior: GaussianPrior | None = None,
    solves: int = 25,
    report: Callable[[int, float], None] | None = None,
) -> tuple[Settled | None, CapturedProblem]:
    """The best cloth found for ``shape`` in at most ``solves`` simulations; the first is ``start``.

    Args:
        start: such as the prior's mean.
        prior: of theta.
        report: called after every simulation with their number and the least value.

    Returns:
        The best simulation, None if none ended, and the problem with its counts.
        An interruption ends the search, and the best so far is returned.
    """
    problem = CapturedProblem(shape, objective, start, prior=prior)

    def tell() -> None:
        if report and problem.best is not None:
            report(problem.solves, problem.best.value)

    try:
        _walk(problem, min(WALK, solves), tell)
        for turn, last in ((0.0, False), (_SECOND_WARP, True)):
            left = solves - problem.solves
            if left < 2 or problem.best is None:
                break
            x = problem.best.x.copy()
            x[7] += turn / SCALE[7]
            problem.start = x
            allowed = left if last else left // 2 + 1  # the first point is known
            outcome = minimise(problem, method="lm", limits=Limits(evaluations=allowed),
                               report=lambda *_: tell())
            if outcome.status.value == "interrupted":
                break
    except KeyboardInterrupt:
        pass
    return problem.best, problem


def search_curvature(
    shape: CapturedShape, objective: Objective, start: Cloth, *,
    prior: GaussianPrior | None = None, solves: int = 12,
) -> tuple[Settled | None, CapturedProblem]:
    """As :func:`search_cloth`, with a natural curvature, from a cloth that has been found."""
    problem = CapturedProblem(shape, objective, start, prior=prior, free=np.ones(11, dtype=bool))
    minimise(problem, method="lm", limits=Limits(evaluations=solves))
    return problem.best, problem


def _walk(problem: CapturedProblem, solves: int, tell: Callable[[], None]) -> None:
    """From the start along the stiffness, towards softer cloth first, while it gets better."""
    def at(shift: float) -> float:
        x = problem.start.copy()
        x[:3] += shift
        value = problem.value(np.clip(x, problem.low, problem.high))
        tell()
        return value

    least, place = at(0.0), 0.0
    for direction in (-1, 1):
        begun = place
        while problem.solves < solves:
            value = at(place + direction * STRIDE)
            if not value < least:
                break
            least, place = value, place + direction * STRIDE
        if place != begun:
            break  # softer was better: stiffer is known
    if problem.solves < solves and math.isfinite(least):
        at(place + STRIDE / 2)


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
