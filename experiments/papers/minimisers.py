"""Optimisers for comparison with Levenberg-Marquardt in :mod:`drapenet.refine.minimise`.

L-BFGS-B uses values and gradients, CMA-ES values only.
"""

import math

import numpy as np
from scipy.optimize import minimize as scipy_minimise

from drapenet.refine.minimise import Method, Run, Status, levenberg_marquardt

SIGMA = 0.3  # initial standard deviation of CMA-ES, in units of the problem
SEED = 0  # of CMA-ES
_INFEASIBLE_VALUE = 1e30  # replaces an infinite value where a method requires a finite one


def lbfgs(run: Run) -> tuple[Status, str]:
    """SciPy's L-BFGS-B on the value and its gradient."""
    problem, limits = run.problem, run.limits
    first = run.best

    def value_and_gradient(x: np.ndarray) -> tuple[float, np.ndarray]:
        value = first.value if np.array_equal(x, first.x) else run.value(x)
        linearised = problem.linearised(x) if math.isfinite(value) else None
        if linearised is None:
            # Larger than any feasible value and without slope, so that the line search backtracks.
            return 10.0, np.zeros_like(x)
        residuals, jacobian = linearised
        return value / first.value, jacobian.T @ residuals / first.value

    result = scipy_minimise(
        value_and_gradient, first.x, jac=True, method="L-BFGS-B",
        bounds=list(zip(problem.low, problem.high, strict=True)),
        options={"ftol": limits.decrease, "gtol": 1e-9, "maxfun": 10**6, "maxiter": 10**6})
    return (Status.CONVERGED if result.success else Status.STALLED), str(result.message)


def cma_es(run: Run) -> tuple[Status, str]:
    """CMA-ES of the package cma, with its default population size."""
    import cma  # slow import

    problem, limits = run.problem, run.limits
    strategy = cma.CMAEvolutionStrategy(run.best.x, SIGMA, {
        "bounds": [problem.low.tolist(), problem.high.tolist()], "seed": SEED + 1,
        "verbose": -9, "tolx": limits.step / 10, "tolfun": 0, "tolfunhist": 0, "tolflatfitness": 5,
    })
    while not strategy.stop():
        points = strategy.ask()
        strategy.tell(points, [min(run.value(np.asarray(x)), _INFEASIBLE_VALUE) for x in points])
    return Status.CONVERGED, f"cma stopped: {', '.join(strategy.stop())}"


METHODS: dict[str, Method] = {"lm": levenberg_marquardt, "lbfgs": lbfgs, "cmaes": cma_es}
