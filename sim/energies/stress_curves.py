"""Diagonalised elasticity: every component of the strain has a stress curve of its own."""

import numpy as np
from scipy.interpolate import PchipInterpolator


class StressCurve:
    """Stress of one strain component: increasing, with a continuous slope.

    A monotone cubic through the knots (PCHIP, whose slope never vanishes between increasing
    knots), so that the energy has two continuous derivatives. Its slope at rest is that of the
    first interval, and from the last knot on it is straight with the slope of the last interval.

    Args:
        strain, stress: (K,) knots, both increasing from 0; N/m.
        odd: whether negative strains mirror the curve, as shear does. Otherwise it goes on
            straight with its slope at rest: how cloth is pushed together says nothing of how
            it tightens when pulled.
    """

    def __init__(self, strain: np.ndarray, stress: np.ndarray, *, odd: bool) -> None:
        # The mirrored knots and one more beyond the end give both ends their secants' slopes.
        x = np.concatenate([-strain[::-1], strain[1:], [2 * strain[-1] - strain[-2]]])
        y = np.concatenate([-stress[::-1], stress[1:], [2 * stress[-1] - stress[-2]]])
        self._stress = PchipInterpolator(x, y)
        self._slope = self._stress.derivative()
        self._energy = self._stress.antiderivative()
        self._at_rest = self._energy(0.0)
        self._least, self._most = (-strain[-1] if odd else 0.0), strain[-1]

    def _split(self, strain: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The strain within the curved part, and how far it lies outside."""
        within = np.clip(strain, self._least, self._most)
        return within, strain - within

    def energy(self, strain: np.ndarray) -> np.ndarray:
        within, beyond = self._split(strain)
        straight = beyond * (self._stress(within) + 0.5 * beyond * self._slope(within))
        return self._energy(within) - self._at_rest + straight

    def stress(self, strain: np.ndarray) -> np.ndarray:
        within, beyond = self._split(strain)
        return self._stress(within) + beyond * self._slope(within)

    def slope(self, strain: np.ndarray) -> np.ndarray:
        return self._slope(self._split(strain)[0])


class DiagonalLaw:
    """Warp, weft and shear, each with its curve and no Poisson effect (Miguel et al., 4.1, 4.2).

    Args:
        warp, weft: stress (N/m) over the Green strain along u and v.
        shear: stress S_uv (N/m) over 2 E_uv.
    """

    def __init__(self, warp: StressCurve, weft: StressCurve, shear: StressCurve) -> None:
        self.curves = (warp, weft, shear)

    def energy(self, strain: np.ndarray) -> np.ndarray:
        return sum(curve.energy(x) for curve, x in zip(self.curves, strain.T, strict=True))

    def stress(self, strain: np.ndarray) -> np.ndarray:
        parts = zip(self.curves, strain.T, strict=True)
        return np.column_stack([curve.stress(x) for curve, x in parts])

    def tangent(self, strain: np.ndarray) -> np.ndarray:
        result = np.zeros((len(strain), 3, 3))
        for i, curve in enumerate(self.curves):
            result[:, i, i] = curve.slope(strain[:, i])
        return result
