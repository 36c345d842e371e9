"""Several captures of one fabric: one posterior, the prior counted once.

In normal approximation a capture's likelihood is its posterior over the prior. Captures of one
fabric share part of their error, since friction and membrane belong to the cloth: of n captures
each counts as one in ``1 + (n - 1) SHARED``.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from data.fabrics import from_theta
from data.prior import load_prior
from data.prior.gaussian import GaussianPrior
from drapenet.content import to_json
from drapenet.convention import LINEAR, STIFF_SOFT, SWAPPED
from drapenet.estimate import Estimate, modulus_names
from sim.material import is_admissible

SHARED = 0.6
"""Correlation of the errors of two captures of one fabric (``python -m benchmarks repeats``)."""
APART = 3.0
"""Deviations by which a capture may differ from the joint estimate before it is doubted."""
_DRAWS = 4000


def fabric_prior(names: Sequence[str]) -> GaussianPrior:
    """The prior of theta along directions of these names; where warp and weft are not known, that
    of either order.
    """
    prior = load_prior("gaussian")
    if names[0] != STIFF_SOFT[0]:
        return prior
    apart = (prior.mean - prior.mean[SWAPPED]) / 2
    covariance = (prior.covariance + prior.covariance[np.ix_(SWAPPED, SWAPPED)]) / 2
    return GaussianPrior(prior.mean - apart, covariance + np.outer(apart, apart), prior.fabrics)


def joined(estimates: Sequence[Estimate], labels: Sequence[str]) -> Estimate:
    """The estimate of one fabric from those of its captures.

    Args:
        estimates: of one naming (all warp/weft or all stiff/soft); the first gives the axis.
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
        # A likelihood with the precision gained, and the peak that leads to the posterior's mean.
        pull += weight * (gained @ normal.mean + beforehand @ (normal.mean - prior.mean))
    covariance = np.linalg.inv(precision)
    middle = covariance @ pull
    samples = np.random.default_rng(0).multivariate_normal(middle, covariance, size=_DRAWS)
    possible = is_admissible(*from_theta(samples))
    kept = samples[possible] if possible.any() else samples
    return replace(estimates[0], samples=kept,
                   warnings=tuple(contradictions(estimates, labels, middle)))


def joint_content(
    estimates: Sequence[Estimate], contents: Sequence[dict[str, Any]]
) -> dict[str, Any]:
    """The content of ``estimate.json`` of several captures, each with its own moduli beside it.

    Args:
        estimates: as for :func:`joined`.
        contents: of the ``estimate.json`` of each.
    """
    labels = [content["capture"]["source"] for content in contents]
    densities = {round(one.density, 6) for one in estimates}
    estimate = joined(estimates, labels)
    about = {"sources": labels, "rig": contents[0]["capture"]["rig"],
             "density_g_m2": round(1e3 * estimates[0].density, 6)}
    each = [{key: content[key] for key in ("capture", "moduli", "warnings")}
            for content in contents]
    content = to_json(estimate, capture=about,
                      source={"checkpoint": contents[0]["checkpoint"], "captures": each})
    if len(densities) > 1:
        content["warnings"].append("the captures state different densities: moduli are those at "
                                   f"{1e3 * estimates[0].density:g} g/m²")
    return content


def contradictions(
    estimates: Sequence[Estimate], labels: Sequence[str], middle: np.ndarray
) -> list[str]:
    """What to say, a line each, of captures that cannot be of the fabric ``middle`` (6,)."""
    lines = []
    for one, label in zip(estimates, labels, strict=True):
        gap = (one.samples.mean(axis=0) - middle)[LINEAR]
        away = gap / one.samples.std(axis=0)[LINEAR]
        k = int(np.abs(away).argmax())
        if abs(away[k]) > APART:
            name = modulus_names(one.names)[k]
            lines.append(f"{label} contradicts the other captures: its {name} is "
                         f"{np.exp(gap[k]):.2f} times the joint one, {abs(away[k]):.1f} standard "
                         "deviations away; check fabric, side, density and specimen")
    return lines


def _positive(matrix: np.ndarray) -> np.ndarray:
    """The nearest positive semidefinite matrix."""
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
    return (vectors * np.maximum(values, 0.0)) @ vectors.T
