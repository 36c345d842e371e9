"""How well a refinement determines its unknowns: Laplace's approximation at the optimum."""

from dataclasses import dataclass

import numpy as np

from drapenet.refine.problem import DrapeProblem, Trial


@dataclass(frozen=True)
class Uncertainty:
    """A normal distribution around the optimum.

    Attributes:
        names: (n,) of the unknowns, the six of theta first.
        covariance: (n, n) in their units: (J^T J)^-1 times the reduced chi².
        reduced_chi2: what is left of the residuals per degree of freedom; below 1 it is taken for
            1, for then the assumed errors were generous.
    """

    names: tuple[str, ...]
    covariance: np.ndarray
    reduced_chi2: float

    @property
    def theta(self) -> np.ndarray:
        """(6,) standard errors of log alpha and of beta/alpha, m."""
        return np.sqrt(np.diag(self.covariance)[:6])


def laplace(problem: DrapeProblem, trial: Trial) -> Uncertainty | None:
    """The uncertainty at ``trial``, the problem's best or last; None where nothing is known.

    An unknown that the residuals do not depend on has an infinite variance.
    """
    linearised = problem.linearised(trial.x)
    if linearised is None:
        return None
    residuals, jacobian = linearised
    freedom = max(problem.measurements - len(trial.x), 1.0)
    reduced = float(residuals @ residuals) / freedom
    values, vectors = np.linalg.eigh(jacobian.T @ jacobian)
    with np.errstate(divide="ignore"):
        variances = np.where(values > 1e-12 * values[-1], 1 / values, np.inf)
    weights = np.where(vectors**2 > 1e-12, vectors**2, 0.0)
    known = np.isfinite(variances)
    covariance = (vectors[:, known] * variances[known]) @ vectors[:, known].T
    covariance[np.diag_indices_from(covariance)] = np.where(
        weights[:, ~known].any(axis=1), np.inf, np.diag(covariance))
    covariance *= max(reduced, 1.0)
    return Uncertainty(problem.names, covariance * np.outer(problem.scale, problem.scale), reduced)
