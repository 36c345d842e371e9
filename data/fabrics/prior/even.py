"""Fabrics to learn from: samples of a prior, made stiffer or softer, and less anisotropic.

The priors fitted to published fabrics have few stiff and few limp ones (docs/training.md). A sample
keeps all else when it is moved: its three alphas get one factor, so that their ratios stay, on
which :func:`sim.material.is_admissible` depends, and beta/alpha a power of this factor.

``anisotropy`` has the shares that are kept of the difference between warp and weft, and of that
between the bias and their mean (docs/physics.md); each fabric draws its own around them, log-normal
with the deviations ``varied``.
"""

from collections.abc import Sequence

import numpy as np

from common.types import Theta
from data.fabrics.fabrics import from_theta
from data.fabrics.prior.base import DECIMALS, Prior, log_stiffness, sample_admissible
from sim.material import BIAS, LINEAR, RATIO, WARP, WEFT, is_admissible

STIFFNESS = (0.7e-6, 700e-6)
"""Range of the mean alpha (geometric mean of warp, bias and weft) of moved fabrics, N·m at
300 g/m²: bending lengths from 6 mm, chiffon, to 62 mm, canvas."""

Shares = Sequence[float]
"""Of warp and weft, and of the bias: two."""
WHOLE: Shares = 1.0, 1.0  # of the prior's anisotropy
SAME: Shares = 0.0, 0.0  # shares that do not vary

_SPREAD_SAMPLES = 4000


def draw_fabric(
    prior: Prior, rng: np.random.Generator, *, even_share: float = 0.0,
    anisotropy: Shares = WHOLE, varied: Shares = SAME
) -> tuple[Theta, int, float]:
    """An admissible fabric, :func:`narrowed`, the number of rejected samples, and its shift of log
    alpha.

    With the probability ``even_share`` the sample is moved to a mean log alpha drawn uniformly from
    :data:`STIFFNESS`; else it is a fabric of the prior, with a shift of 0.
    """
    theta, rejected = sample_admissible(prior, rng)
    shares = np.array(anisotropy)
    if any(varied):
        whole = theta
        while True:
            drawn = shares * np.exp(np.array(varied) * rng.standard_normal(2))
            theta = narrowed(whole, drawn.tolist())
            if is_admissible(*from_theta(theta)):
                break
            rejected += 1
    else:
        theta = narrowed(theta, anisotropy)
    if not even_share or rng.random() >= even_share:
        return theta, rejected, 0.0
    shift = float(rng.uniform(*np.log(STIFFNESS)) - log_stiffness(theta))
    return moved(theta, shift, prior.softening), rejected, shift


def draw_fabrics(
    prior: Prior, count: int, *, even_share: float = 0.0, anisotropy: Shares = WHOLE,
    varied: Shares = SAME
) -> tuple[Theta, float]:
    """``count`` fabrics (count, 6) by a fixed seed, and the share of rejected samples."""
    rng = np.random.default_rng(0)
    theta, rejected, _ = zip(*(
        draw_fabric(prior, rng, even_share=even_share, anisotropy=anisotropy, varied=varied)
        for _ in range(count)), strict=True)
    return np.array(theta), sum(rejected) / (sum(rejected) + count)


def spread_of(prior: Prior) -> Theta:
    """(6,) standard deviation of theta over the fabrics of ``prior``, none of them moved."""
    return draw_fabrics(prior, _SPREAD_SAMPLES)[0].std(axis=0)


def narrowed(theta: Theta, anisotropy: Shares) -> Theta:
    """Fabrics (..., 6) with these shares of the difference between warp and weft, and of that
    between the bias and their mean, of log alpha and, up to 1, of beta/alpha; the means of the
    three directions stay. With shares up to 1 they are admissible if those of ``theta`` are: a
    smaller difference only widens the limits of a plate."""
    if tuple(anisotropy) == WHOLE:
        return theta
    theta = np.array(theta)
    for part, (yarns, bias) in ((LINEAR, anisotropy), (RATIO, np.minimum(anisotropy, 1.0))):
        values = theta[..., part]  # a view
        mean = (values[..., WARP] + values[..., WEFT]) / 2
        across = yarns * (values[..., WARP] - values[..., WEFT]) / 2
        off = (1 - bias) * (values[..., BIAS] - mean) / 3
        values[..., BIAS] -= 2 * off
        values[..., WARP], values[..., WEFT] = mean + off + across, mean + off - across
    return np.round(theta, DECIMALS)


def moved(theta: Theta, shift: float, softening: float) -> Theta:
    """Fabrics (..., 6) with ``shift`` added to the log alphas, and beta/alpha multiplied by
    exp(``softening`` * ``shift``)."""
    theta = np.array(theta)
    theta[..., LINEAR] += shift
    theta[..., RATIO] *= np.exp(softening * shift)
    return np.round(theta, DECIMALS)
