"""Joint posterior of several captures of one fabric, with the prior counted once.

In normal approximation a capture's likelihood is its posterior divided by the prior. Errors of
captures of one fabric are correlated, because membrane, hysteresis and natural curvature are
properties of the cloth: each of n captures has the weight ``1 / (1 + (n - 1) SHARED)``.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from data.fabrics.fabrics import from_theta
from data.fabrics.prior import GaussianPrior, load_prior
from drapenet.result.content import Result, to_json
from drapenet.result.estimate import Estimate
from sim.material import LINEAR, REFERENCE_DENSITY, STIFF_SOFT, SWAPPED, is_admissible

SHARED = 0.6
"""Correlation of the errors of two captures of one fabric (``python -m experiments repeats``)."""
SPECIMEN = 0.10
"""Standard deviation of log alpha between specimens of a fabric.

No repeats of measured alpha are at hand. A trial network, trained on outlines of simulated drapes,
estimated a bending stiffness (torque over curvature at 40 1/m) from outlines of real drapes. Its
median ratio between samples of one fabric and face is 1.10 (nine fabrics) and 1.13 (thirteen), as
of normal logarithms with standard deviations of 0.10 and 0.13. These include errors of the network.
"""
CONTRADICTION_LEVEL = 0.01
"""Significance level: probability of the warning for captures of the same fabric."""
_DRAWS = 4000


def fabric_prior(names: Sequence[str]) -> GaussianPrior:
    """Prior of theta along directions of these names; for stiff/soft, the mixture of both orders
    of warp and weft, in normal approximation.
    """
    prior = load_prior("gaussian")
    if names[0] != STIFF_SOFT[0]:
        return prior
    apart = (prior.mean - prior.mean[SWAPPED]) / 2
    covariance = (prior.covariance + prior.covariance[np.ix_(SWAPPED, SWAPPED)]) / 2
    return GaussianPrior(prior.mean - apart, covariance + np.outer(apart, apart), prior.fabrics)


def joined(estimates: Sequence[Estimate], labels: Sequence[str]) -> Estimate:
    """Joint estimate of one fabric.

    Args:
        estimates: of its captures, all warp/weft or all stiff/soft; the first gives the axis.
        labels: of the captures, for warnings.
    """
    prior = fabric_prior(estimates[0].names)
    beforehand = np.linalg.inv(prior.covariance)
    weight = 1 / (1 + (len(estimates) - 1) * SHARED)
    precision, pull = beforehand.copy(), beforehand @ prior.mean
    for one in estimates:
        normal = one.normal
        own = np.linalg.inv(normal.covariance)
        gained = _positive(own - beforehand)
        precision += weight * gained
        # Likelihood of the gained precision whose peak gives the posterior's mean.
        pull += weight * (gained @ normal.mean + beforehand @ (normal.mean - prior.mean))
    covariance = np.linalg.inv(precision)
    middle = covariance @ pull
    samples = np.random.default_rng(0).multivariate_normal(middle, covariance, size=_DRAWS)
    possible = is_admissible(*from_theta(samples))
    kept = samples[possible] if possible.any() else samples
    return replace(estimates[0], samples=kept,
                   warnings=tuple(contradictions(estimates, labels)))


def joint_result(results: Sequence[Result]) -> Result:
    """Joint result of one fabric from the ``results`` of its captures (:func:`joined`); its content
    includes the moduli of each.
    """
    estimates, contents = ([getattr(one, part) for one in results]
                           for part in ("estimate", "content"))
    labels = [content["capture"]["source"] for content in contents]
    densities = {round(one.density, 6) for one in estimates}
    estimate = joined(estimates, labels)
    about = {"sources": labels, "rig": contents[0]["capture"]["rig"],
             "density_g_m2": round(1e3 * estimates[0].density, 6)}
    each = [{key: content[key] for key in ("capture", "moduli", "warnings")}
            for content in contents]
    content = to_json(estimate, capture=about,
                      source={"checkpoint": contents[0]["checkpoint"], "captures": each})
    content["warnings"] += [
        f"{label} has {len(one['warnings'])} warning{'s' * (len(one['warnings']) > 1)} by itself: "
        f"{one['warnings'][0]}" for label, one in zip(labels, contents, strict=True)
        if one["warnings"]]
    if len(densities) > 1:
        content["warnings"].append("the captures state different densities: moduli are those at "
                                   f"{1e3 * estimates[0].density:g} g/m²")
    return Result(estimate, content)


def contradictions(estimates: Sequence[Estimate], labels: Sequence[str]) -> list[str]:
    """One line for each capture that contradicts the others.

    The difference of log alpha (3,) between a capture's posterior mean and the mean of the others
    has the covariance of the uncorrelated part of their errors and of the scatter of specimens. Its
    chi-square is compared with the quantile of :data:`CONTRADICTION_LEVEL`, divided by the
    number of captures if that exceeds two (Bonferroni). The worst capture is removed, and the test
    repeated with the remaining ones.
    """
    means = [one.samples[:, LINEAR].mean(axis=0) for one in estimates]
    covariances = [(1 - SHARED) * np.cov(one.samples[:, LINEAR].T) + SPECIMEN**2 * np.eye(3)
                   for one in estimates]
    directions, unit = estimates[0].names, 1e6 * estimates[0].density / REFERENCE_DENSITY
    left, lines = list(range(len(estimates))), []
    while len(left) > 1:
        tests = len(left) if len(left) > 2 else 1
        limit = float(chi2.isf(CONTRADICTION_LEVEL / tests, len(directions)))
        found = []
        for k in left:
            others = [j for j in left if j != k]
            together = np.mean([means[j] for j in others], axis=0)
            apart = means[k] - together
            covariance = covariances[k] + sum(covariances[j] for j in others) / len(others) ** 2
            found.append((float(apart @ np.linalg.solve(covariance, apart)), k, together,
                          int(np.abs(apart / np.sqrt(np.diag(covariance))).argmax())))
        distance, k, together, worst = max(found, key=lambda one: one[0])
        if distance <= limit:
            break
        left.remove(k)
        other = labels[left[0]] if len(left) == 1 else f"the other {len(left)} captures"
        own, expected = unit * np.exp([means[k][worst], together[worst]])
        lines.append(f"{labels[k]} contradicts {other}: alpha {directions[worst]} is {own:.3g} "
                     f"against {expected:.3g} µN·m (chi-square of the three alpha {distance:.1f}, "
                     f"limit {limit:.1f}); check fabric, side, density and specimen, and estimate "
                     "different fabrics apart")
    return lines


def _positive(matrix: np.ndarray) -> np.ndarray:
    """The nearest positive semidefinite matrix."""
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
    return (vectors * np.maximum(values, 0.0)) @ vectors.T
