"""Load and extension of a strip of cloth between two marks.

The law is that of :class:`sim.energies.membrane.OrthotropicStVK`: between clamps that are far away
a strip has one stress along it, S = n/lambda for the load n, N per m of its width, and the stretch
lambda, and the Green strain (lambda² - 1)/2 = c S. Along the warp c = 1/E_warp, along the weft
1/E_weft, and along the bias

    c = (1 + q)/(4 G),    q = G (1/E_warp + 1/E_weft - 2 nu/sqrt(E_warp E_weft)),

with Poisson's ratio nu, the geometric mean of those under tension along warp and along weft.
FAST-3's G = 123/EB5 is 1/(4 c) with lambda near 1: it takes yarns as stiff and clamps as far away.

A clamp keeps cloth from narrowing. Cut along the bias it must narrow to stretch, so that it
stretches less near the clamps: :func:`deficit`. Along the yarns this is less than 0.1 widths, and
is left out.
"""

from typing import NamedTuple

import numpy as np

from common.types import Metres
from data.readings.quantity import STANDARD_GRAVITY
from sim.material import BIAS, WARP

GF_PER_CM = 1e-3 * STANDARD_GRAVITY * 1e2  # N/m
KES_SHEAR = 56.188  # N/m, of 1 gf/(cm °)


class Machine(NamedTuple):
    """How a machine pulls its specimen: load, N/m, its relative error as the law sees it, size."""

    name: str
    load: float
    error: float
    width: Metres
    length: Metres  # between the clamps


EB5, E100 = (Machine("FAST-3", each * GF_PER_CM, 0.01, 0.05, 0.1) for each in (5.0, 100.0))
EMT = Machine("KES-FB1", 500.0 * GF_PER_CM, 0.3, 0.2, 0.05)
"""Crimp, which the law has not, makes cloth softer under the usual loads: an assumed 30 %."""
FAR = 1.5  # widths from a clamp, beyond which it changes nothing
SOFTNESS = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.4, 0.8, 1.0)  # q
MARGINS = (0.0, 0.125, 0.25, 0.5, 0.75, 1.0, 1.25, FAR)  # from mark to clamp over the width
DEFICITS = np.array([
    [0.638, 0.39, 0.141, -0.297, -0.122, -0.012, 0.038, 0.025],
    [0.619, 0.368, 0.12, -0.285, -0.116, -0.01, 0.037, 0.025],
    [0.578, 0.332, 0.085, -0.262, -0.107, -0.005, 0.036, 0.023],
    [0.543, 0.296, 0.056, -0.243, -0.098, -0.002, 0.033, 0.02],
    [0.481, 0.241, 0.018, -0.212, -0.085, 0.001, 0.028, 0.016],
    [0.369, 0.154, -0.026, -0.16, -0.063, 0.002, 0.019, 0.011],
    [0.262, 0.086, -0.045, -0.114, -0.045, 0.0, 0.011, 0.006],
    [0.149, 0.031, -0.044, -0.067, -0.028, -0.003, 0.003, 0.003],
    [0.053, 0.001, -0.027, -0.028, -0.013, -0.003, 0.0, 0.0],
    [0.003, -0.003, -0.005, -0.004, -0.002, -0.001, 0.0, 0.0],
    [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]])
"""By :data:`SOFTNESS` and :data:`MARGINS`, what is missing between two marks that lie as far inside
their clamps, in widths of the strip: simulated by :func:`sim.tension.pull` on strips of four
widths, E_warp = E_weft and nu 0.3, at small extensions, with meshes of 24 and 48 cells across, or
48 and 80 below q = 0.01, extrapolated. On strips of two and eight widths it is the same to 0.02;
nu from 0 to 0.5 and yarns that differ by 2.5 times change it by 0.03, extensions of 10 % by 0.04.
"""


def softness(warp: np.ndarray, weft: np.ndarray, shear: np.ndarray, poisson: np.ndarray | float
             ) -> np.ndarray:
    """q of stiffnesses, N/m, of any shape: the yarns' share in the extension along the bias over
    that of the shear."""
    return shear * (1 / warp + 1 / weft - 2 * poisson / np.sqrt(warp * weft))


def compliance(direction: int, stiffness: tuple[np.ndarray, np.ndarray, np.ndarray],
               poisson: np.ndarray | float) -> np.ndarray:
    """c, m/N, along the direction of this number, of the stiffnesses (warp, weft, shear), N/m."""
    warp, weft, shear = stiffness
    if direction == BIAS:
        return (1 + softness(warp, weft, shear, poisson)) / (4 * shear)
    return 1 / (warp if direction == WARP else weft)


def deficit(softness: np.ndarray, margin: float) -> np.ndarray:
    """What is missing in the extension of a bias strip between two marks, in widths of the strip;
    ``margin``: from each mark to its clamp, in widths."""
    if margin >= FAR:
        return np.zeros_like(softness)
    of_margin = [np.interp(margin, MARGINS, row) for row in DEFICITS]
    return np.interp(np.log(softness), np.log(SOFTNESS), of_margin)


def reach(direction: int, stiffness: tuple[np.ndarray, np.ndarray, np.ndarray],
          poisson: np.ndarray | float, *, gauge: float, margin: float) -> np.ndarray:
    """Extension between marks over that without clamps; ``gauge``, the distance of the marks, and
    ``margin`` in widths."""
    if direction != BIAS:
        return np.ones_like(stiffness[0])
    return 1 - deficit(softness(*stiffness, poisson), margin) / gauge


def load(extension: np.ndarray | float, c: np.ndarray) -> np.ndarray:
    """N/m, of a strip of compliance c, m/N, stretched by the share ``extension``."""
    stretch = 1 + extension
    return (stretch**2 - 1) * stretch / (2 * c)


def extension(load: np.ndarray | float, c: np.ndarray) -> np.ndarray:
    """The inverse of :func:`load`, by Newton's method, which converges from above."""
    strain = c * load
    stretch = 1 + strain
    for _ in range(30):
        stretch = stretch - ((stretch**2 - 1) * stretch - 2 * strain) / (3 * stretch**2 - 1)
    return stretch - 1
