"""Parts of an outline that stand out over more of the azimuth than folds of that drape can.

A shadow or a sheet of paper that is read as cloth fills the valleys between folds. Of a drape with
many folds, each is narrow; only a stiff cloth has few, wide ones.
"""

import numpy as np
from scipy.ndimage import minimum_filter1d

from common.findings import Finding
from data.captures.sides import side

_ORDERS = np.arange(2, 21)  # of waves around the outline; the first is of a specimen off its centre
_FLAT = 2e-3  # deviation over the mean, of a specimen without folds
_FOLDS = (3.5, 5.5, 7.0, 12.0)
_LIMITS = {12: (1.6, 1.4, 0.9, 0.5), 8: (1.25, 1.0, 0.6, 0.1)}
"""By how many standard deviations of the radius all of an arc may stand out, for mean orders of an
outline's waves of ``_FOLDS``; the key is how often the arc goes around. Three of 1 000 simulated
outlines have more, and none of 309 real ones."""


def bulge(radii: np.ndarray) -> list[Finding]:
    """A warning if an arc of a hem bulges, of radii (A,) at equally spaced azimuths from x on."""
    waves = np.fft.rfft(radii)
    waves[:2] = 0
    away, power = np.fft.irfft(waves, len(radii)), np.abs(waves[_ORDERS]) ** 2
    if away.std() < _FLAT * radii.mean():
        return []
    folds, found = power @ _ORDERS / power.sum(), []
    for share, limits in _LIMITS.items():
        least = minimum_filter1d(away, len(radii) // share, mode="wrap")
        value = least.max() / away.std()
        found.append((value - np.interp(folds, _FOLDS, limits), least.argmax()))
    excess, place = max(found)
    if excess <= 0:
        return []
    return [Finding("hem_bulges", {"place": f"at the {side(2 * np.pi * place / len(radii))}"})]
