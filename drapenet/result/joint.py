"""Joint posterior of several captures of one fabric, with the prior counted once.

In normal approximation a capture's likelihood is its posterior divided by the prior. Errors of
captures of one fabric are correlated, because membrane, hysteresis and natural curvature are
properties of the cloth: each of n captures has the weight ``1 / (1 + (n - 1) SHARED)``.
"""

from collections.abc import Sequence
from dataclasses import replace
from operator import itemgetter

import numpy as np
from scipy.special import chdtri

from data.fabrics.fabrics import from_theta
from data.fabrics.prior import GaussianPrior, load_prior
from drapenet.result.document import CaptureRecord, EstimateDocument
from drapenet.result.estimate import Estimate
from sim.material import LINEAR, REFERENCE_DENSITY, STIFF_SOFT, SWAPPED, is_admissible

SHARED = 0.6
"""Correlation of the errors of two captures of one fabric (``python -m experiments repeats``)."""
SPECIMEN = 0.10
"""Standard deviation of log alpha between specimens of a fabric.

No repeats of measured alpha are at hand. A trial network estimated a bending stiffness from
outlines of real drapes: its median ratio between samples of one fabric and face is 1.10 (nine
fabrics) and 1.13 (thirteen), as of normal logarithms with standard deviations of 0.10 and 0.13,
which include errors of the network.
"""
CONTRADICTION_LEVEL = 0.01  # probability of the warning for captures of the same fabric
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
    """Joint estimate of one fabric; its captures, named by ``labels`` in warnings, have the same
    names of directions, and the first gives the axis.
    """
    prior = fabric_prior(estimates[0].names)
    beforehand = np.linalg.inv(prior.covariance)
    weight = 1 / (1 + (len(estimates) - 1) * SHARED)
    precision, pull = beforehand.copy(), beforehand @ prior.mean
    for estimate in estimates:
        normal = estimate.normal
        gained = _positive(np.linalg.inv(normal.covariance) - beforehand)
        precision += weight * gained
        # Likelihood of the gained precision whose peak gives the posterior's mean.
        pull += weight * (gained @ normal.mean + beforehand @ (normal.mean - prior.mean))
    covariance = np.linalg.inv(precision)
    middle = covariance @ pull
    samples = np.random.default_rng(0).multivariate_normal(middle, covariance, size=_DRAWS)
    possible = is_admissible(*from_theta(samples))
    kept = samples[possible] if possible.any() else samples
    return replace(estimates[0], samples=kept, warnings=tuple(contradictions(estimates, labels)))


def joint_estimate(
    estimates: Sequence[Estimate], documents: Sequence[EstimateDocument]
) -> tuple[Estimate, EstimateDocument]:
    """Joint estimate of one fabric and its document, with the moduli of each capture."""
    labels = [document.capture.source or "" for document in documents]
    estimate, first = joined(estimates, labels), documents[0]
    warnings = [*estimate.warnings, *(
        f"{label} has {len(document.warnings)} warning{'s' * (len(document.warnings) > 1)} by "
        f"itself: {document.warnings[0]}"
        for label, document in zip(labels, documents, strict=True) if document.warnings)]
    density = first.capture.density_g_m2
    if any(document.capture.density_g_m2 != density for document in documents):
        warnings.append("the captures state different densities: moduli are those at "
                        f"{density:g} g/m²")
    records = [CaptureRecord(capture=document.capture, moduli=document.moduli,
                             warnings=document.warnings) for document in documents]
    return estimate, EstimateDocument.from_estimate(
        estimate, capture={"sources": labels, "rig": first.capture.rig, "density_g_m2": density},
        checkpoint=first.checkpoint, captures=records, warnings=warnings)


def contradictions(estimates: Sequence[Estimate], labels: Sequence[str]) -> list[str]:
    """One line for each capture that contradicts the others.

    The difference of log alpha between a capture's posterior mean and the mean of the others has
    the covariance of the uncorrelated part of their errors and of the scatter of specimens. The
    level of its chi-square is divided by the number of captures if that exceeds two (Bonferroni).
    The worst capture is removed, and the test repeated with the remaining ones.
    """
    logs = [estimate.samples[:, LINEAR] for estimate in estimates]
    means = [samples.mean(axis=0) for samples in logs]
    covariances = [(1 - SHARED) * np.cov(samples.T) + SPECIMEN**2 * np.eye(3) for samples in logs]
    directions, unit = estimates[0].names, 1e6 * estimates[0].density / REFERENCE_DENSITY
    left, lines = list(range(len(estimates))), []
    while len(left) > 1:
        tests = len(left) if len(left) > 2 else 1
        limit = float(chdtri(len(directions), CONTRADICTION_LEVEL / tests))
        distances = []
        for k in left:
            rest = [j for j in left if j != k]
            together = np.mean([means[j] for j in rest], axis=0)
            apart = means[k] - together
            covariance = covariances[k] + sum(covariances[j] for j in rest) / len(rest) ** 2
            distances.append((float(apart @ np.linalg.solve(covariance, apart)), k, together,
                              int(np.abs(apart / np.sqrt(np.diag(covariance))).argmax())))
        distance, k, together, worst = max(distances, key=itemgetter(0))
        if distance <= limit:
            break
        left.remove(k)
        rival = labels[left[0]] if len(left) == 1 else f"the other {len(left)} captures"
        alpha, expected = unit * np.exp([means[k][worst], together[worst]])
        lines.append(f"{labels[k]} contradicts {rival}: alpha {directions[worst]} is {alpha:.3g} "
                     f"against {expected:.3g} µN·m (chi-square of the three alpha {distance:.1f}, "
                     f"limit {limit:.1f}); check fabric, side, density and specimen, and estimate "
                     "different fabrics apart")
    return lines


def _positive(matrix: np.ndarray) -> np.ndarray:
    """The nearest positive semidefinite matrix."""
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
    return (vectors * np.maximum(values, 0.0)) @ vectors.T
