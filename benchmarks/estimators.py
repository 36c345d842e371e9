"""Estimators to compare with: this release, and the drape coefficient alone."""

from functools import cache

import numpy as np

import drapenet
from benchmarks.protocol import CASES, UNITS, Moduli
from common.tables import number, read_table
from data.captures.capture import Capture
from drapenet.measured.captures import Captured
from sim.material import REFERENCE_DENSITY

LEARNED = "coefficients.csv"
"""Drapes of other fabrics: tester, moduli at 300 g/m², drape coefficient."""


def release(capture: Capture) -> Moduli:
    """Samples (S, 6) by the network of this release."""
    return np.hstack(drapenet.estimate(capture).moduli())


def coefficient_alone(capture: Capture) -> Moduli:
    """Samples (S, 6) by a regression of log alpha on the drape coefficient: its value plus each of
    its residuals; beta/alpha is that of the fabrics with these residuals."""
    outline = Captured.of(capture).observed().seen.outline
    assert outline, "of depth views and of outlines"
    weights, residuals, ratio = regression(capture.rig.name)
    coefficient = outline.corrected(capture.rig).coefficient(capture.rig)
    alpha = np.exp(powers(np.array([coefficient])) @ weights + residuals)
    alpha *= capture.density / REFERENCE_DENSITY
    return np.hstack([alpha, alpha * ratio])


@cache
def regression(tester: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weights (3, 3) of the powers of the coefficient in log alpha, N·m at 300 g/m², residuals (N,
    3), and beta/alpha (N, 3), m, of the fabrics draped on a tester."""
    _, rows = read_table(CASES / LEARNED, "coefficients")
    values = np.array([[number(cell) for cell in row[1:]] for _, row in rows if row[0] == tester])
    moduli, given = values[:, :6] * UNITS, powers(values[:, 6] / 100)
    logs = np.log(moduli[:, :3])
    weights = np.linalg.lstsq(given, logs, rcond=None)[0]
    return weights, logs - given @ weights, moduli[:, 3:] / moduli[:, :3]


def powers(coefficient: np.ndarray) -> np.ndarray:
    """Powers (N, 3) of drape coefficients (N,)."""
    return coefficient[:, None] ** np.arange(3)
