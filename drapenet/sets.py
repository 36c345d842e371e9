"""Several captures of one fabric: which of them contradicts the others.

A posterior's mean differs from the truth by an error, and of two posteriors of the same fabric the
difference of the means has a covariance that follows from theirs and the prior's: in normal
approximation, with prior P and posteriors A and B of independent captures,
A + B - A P⁻¹ B - B P⁻¹ A, plus the scatter of specimens.
"""

from collections.abc import Callable, Sequence

import numpy as np
from scipy.special import chdtri

from common.types import Density, Theta
from sim.material import LINEAR, REFERENCE_DENSITY

SPECIMEN = 0.10
"""Standard deviation of log alpha between specimens of a fabric.

No repeats of measured alpha are at hand. A trial network estimated a bending stiffness from
outlines of real drapes: its median ratio between samples of one fabric and face is 1.10 (nine
fabrics) and 1.13 (thirteen), as of normal logarithms with standard deviations of 0.10 and 0.13,
which include errors of the network.
"""
LEVEL = 0.01  # probability of the warning for captures of the same fabric


def contradictions(
    alone: Sequence[Theta], joined: Callable[[list[int]], Theta], labels: Sequence[str], *,
    names: Sequence[str], spread: Theta, density: Density,
) -> list[str]:
    """One line for each capture that contradicts the others.

    The level of the chi-square of log alpha is divided by the number of captures if that exceeds
    two (Bonferroni). The worst capture is removed, and the test repeated with the remaining ones.

    Args:
        alone: samples (S, 6) of each capture.
        joined: gives samples of the posterior of several captures, by their numbers.
        names: of the directions.
        spread: standard deviation over fabrics.
        density: at which the moduli in a line are.
    """
    left, lines, prior = list(range(len(alone))), [], np.diag(spread[LINEAR] ** 2)
    unit = 1e6 * density / REFERENCE_DENSITY
    while len(left) > 1:
        limit = float(chdtri(3, LEVEL / (len(left) if len(left) > 2 else 1)))
        found = []
        for k in left:
            mean, covariance = _moments(alone[k])
            others, remaining = _moments(joined([j for j in left if j != k]))
            shared = covariance @ np.linalg.solve(prior, remaining)
            scatter = (covariance + remaining - shared - shared.T
                       + SPECIMEN**2 * (1 + 1 / (len(left) - 1)) * np.eye(3))
            apart = mean - others
            # A posterior wider than the prior gives less than the scatter of specimens.
            deviation = np.sqrt(np.diag(scatter).clip(SPECIMEN**2))
            found.append((float(apart @ np.linalg.solve(scatter, apart)), k, mean, others,
                          int(np.abs(apart / deviation).argmax())))
        distance, k, mean, others, worst = max(found, key=lambda item: item[0])
        if distance <= limit:
            break
        left.remove(k)
        rival = labels[left[0]] if len(left) == 1 else f"the other {len(left)} captures"
        alpha, expected = unit * np.exp([mean[worst], others[worst]])
        lines.append(f"{labels[k]} contradicts {rival}: alpha {names[worst]} is {alpha:.3g} "
                     f"against {expected:.3g} µN·m (chi-square of the three alpha {distance:.1f}, "
                     f"limit {limit:.1f}); check fabric, side, density and specimen, and estimate "
                     "different fabrics apart")
    return lines


def _moments(samples: Theta) -> tuple[np.ndarray, np.ndarray]:
    """Mean (3,) and covariance (3, 3) of log alpha."""
    logs = samples[:, LINEAR]
    return logs.mean(axis=0), np.cov(logs.T)
