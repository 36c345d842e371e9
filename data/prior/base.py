"""What every prior can do, and the checks that reading their files has in common."""

from typing import ClassVar, Protocol

import numpy as np

from common.errors import InputError

ROUNDING = 1e-14  # of the largest variance, below which another one is rounding


class Prior(Protocol):
    """A distribution over theta (see :mod:`data.fabrics`)."""

    kind: ClassVar[str]
    fabrics: int

    @classmethod
    def fit(cls, theta: np.ndarray) -> "Prior":
        """Fit to the distinct fabrics theta (F, 6)."""

    def sample(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Draw theta (n, 6), admissible or not."""

    def log_likelihood(self, theta: np.ndarray) -> np.ndarray:
        """Log density (n,) of theta (n, 6), per unit of theta."""

    def as_dict(self) -> dict:
        """All parameters, in JSON's types."""

    @classmethod
    def from_dict(cls, content: dict) -> "Prior":
        """The inverse of :meth:`as_dict`; InputError where a parameter makes no sense."""


def check_fabrics(theta: np.ndarray, *, least: int = 7) -> np.ndarray:
    """theta as floats (F, 6); InputError if it has another shape or fewer than ``least`` rows."""
    theta = np.asarray(theta, dtype=np.float64)
    if theta.ndim != 2 or theta.shape[1] != 6 or len(theta) < least:
        raise InputError(
            f"a prior needs more than {least - 1} distinct fabrics, not {len(theta)}")
    return theta


def read_array(content: object, name: str, shape: tuple[int, ...]) -> np.ndarray:
    """The finite numbers ``content[name]`` of a shape; InputError when they are not there."""
    try:
        array = np.array(content[name], dtype=np.float64)
    except (KeyError, TypeError, ValueError, OverflowError):
        array = None
    if array is None or array.shape != shape or not np.isfinite(array).all():
        size = " × ".join(map(str, shape))
        raise InputError(f"it needs '{name}', {size} finite numbers")
    return array


def check_covariances(covariances: np.ndarray, complaint: str) -> None:
    """InputError with ``complaint`` if one of covariances (..., K, K), finite, is none.

    They must be symmetric and positive definite, by more than rounding.
    """
    variances = np.linalg.eigvalsh(covariances)
    if (not np.allclose(covariances, np.swapaxes(covariances, -1, -2))
            or (variances[..., 0] <= ROUNDING * variances[..., -1]).any()):
        raise InputError(complaint)


def read_count(content: dict, name: str) -> int:
    """The whole number ``content[name]`` >= 0; InputError when it is not there."""
    count = content.get(name)
    if type(count) is not int or count < 0:
        raise InputError(f"it needs '{name}', a whole number")
    return count
