"""The second stage of a network: a scale of the deviations that it states, by what can be seen of a
set of captures, from fabrics that it has not learned.

The scale's logarithm is linear. It is fitted by quantile regression (Koenker and Bassett 1978) of
how far the truth lies from the median, in half-widths of the central intervals, so that these hold
what they say whatever is seen.
"""

from dataclasses import dataclass

import numpy as np

from drapenet.network.inputs import Batch
from drapenet.network.posterior import LEVELS, Samples
from sim.material import LINEAR, RATIO

_SCALED = LINEAR, RATIO  # log alpha, beta/alpha
_SMOOTH = 0.1  # of the logarithm, over which a quantile's loss is rounded
_RIDGE = 3e-3  # of slopes
_LIMIT = 3.0  # deviations of a number, beyond which the scale is that of the limit
_LARGEST = np.log(4.0)  # of the scale


def seen_of(batch: Batch, samples: Samples) -> np.ndarray:
    """(M, F) numbers of each set that its scale depends on: means of the scalar inputs and stated
    errors of its captures, their number, and deviations of ``samples`` (S, M, T)."""
    each = np.column_stack([batch.facts, batch.error.mean(axis=1), batch.error.max(axis=1)])
    count = batch.members.sum(axis=1)
    spread = np.log(samples.std(axis=0))
    return np.column_stack([batch.members @ each / count[:, None], np.log2(count),
                            *(spread[:, kind].mean(axis=1) for kind in _SCALED)])


@dataclass(frozen=True)
class Calibration:
    """Scales of log alpha and beta/alpha by what is seen, standardised."""

    mean: np.ndarray  # (F,)
    spread: np.ndarray  # (F,)
    slopes: np.ndarray  # (2, 1 + F), of a constant and the standardised numbers

    def scales(self, seen: np.ndarray) -> np.ndarray:
        """(M, 2) of sets of which (M, F) is seen."""
        logarithm = _columns(seen, self.mean, self.spread) @ self.slopes.T
        return np.exp(logarithm.clip(-_LARGEST, _LARGEST))

    def applied(self, samples: Samples, seen: np.ndarray) -> Samples:
        """``samples`` (S, M, T), of which moduli deviate from their mean by the scale as much."""
        scaled = samples.copy()
        for kind, scale in zip(_SCALED, self.scales(seen).T, strict=True):
            part = samples[..., kind]
            middle = part.mean(axis=0)
            scaled[..., kind] = middle + scale[:, None] * (part - middle)
        return scaled

    @classmethod
    def fit(cls, samples: Samples, truth: np.ndarray, seen: np.ndarray) -> "Calibration":
        """That of posteriors' ``samples`` (S, M, T) of fabrics whose ``truth`` (M, T) is known."""
        mean, spread = seen.mean(axis=0), seen.std(axis=0)
        spread = np.where(spread > 1e-6, spread, 1.0)
        columns = _columns(seen, mean, spread)
        slopes = [_slopes(columns, _widths(samples[..., kind], truth[:, kind])) for kind in _SCALED]
        return cls(mean, spread, np.array(slopes))


def _columns(seen: np.ndarray, mean: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """(M, 1 + F) a constant, and the standardised numbers."""
    within = ((seen - mean) / spread).clip(-_LIMIT, _LIMIT)
    return np.column_stack([np.ones(len(seen)), within])


def _widths(samples: Samples, truth: np.ndarray) -> np.ndarray:
    """(L, M, K) logarithm of the truth's distance from the mean, in half-widths of the central
    intervals of :data:`LEVELS` about it."""
    middle = samples.mean(axis=0)
    half = np.quantile(np.abs(samples - middle), LEVELS, axis=0)
    return np.log(np.abs(truth - middle) / half + 1e-6)


def _slopes(columns: np.ndarray, widths: np.ndarray) -> np.ndarray:
    """(F,) slopes on ``columns`` (M, F) whose sums the ``widths`` (L, M, K) lie below in the shares
    :data:`LEVELS`."""
    from scipy.optimize import minimize  # takes 0.2 s

    levels = np.array(LEVELS)[:, None, None]

    def loss(slopes: np.ndarray) -> tuple[float, np.ndarray]:
        above = widths - (columns @ slopes)[:, None]
        smooth = _SMOOTH * np.logaddexp(0.0, above / _SMOOTH)
        share = 1 / (1 + np.exp(-(above / _SMOOTH).clip(-50, 50)))
        lost = (smooth - (1 - levels) * above).mean() + _RIDGE * (slopes[1:] ** 2).sum()
        slope = -(share - (1 - levels)).mean(axis=(0, 2)) @ columns / len(columns)
        return lost, slope + 2 * _RIDGE * np.r_[0.0, slopes[1:]]

    return minimize(loss, np.zeros(columns.shape[1]), jac=True, method="L-BFGS-B").x
