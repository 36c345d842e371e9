"""What all priors have: parameters in JSON, checks of them, samples, and the softening."""

from dataclasses import dataclass, fields
from functools import cached_property, partial
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field, PlainValidator

from common.errors import InputError
from common.types import Theta
from data.fabrics.fabrics import from_theta
from sim.material import LINEAR, RATIO, is_admissible

MAX_TRIES = 10_000
DECIMALS = 12
"""Decimals to which samples are rounded, so that they nearly always agree between machines whose
libraries differ in the last bits."""
TOLERANCE = 1e-9
"""Coordinates that differ by less are equal up to rounding."""
_FIT_SAMPLES = 20_000  # samples from which the prior's softening is estimated
_LEAST_RATIO = 1e-6  # m, of mean |beta|/alpha, for its logarithm


def log_stiffness(theta: Theta) -> np.ndarray:
    """Mean of the three log alphas of each fabric, (...)."""
    return theta[..., LINEAR].mean(axis=-1)


@dataclass(frozen=True, eq=False)
class Stored:
    """Base of dataclasses in JSON; annotations of fields validate them, see :func:`array`."""

    def as_dict(self) -> dict:
        """All parameters, in JSON types."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: value.as_dict() if isinstance(value, Stored) else np.asarray(value).tolist()
                for name, value in values.items()}


@dataclass(frozen=True, eq=False)
class Prior(Stored):
    """A distribution over theta (see :mod:`data.fabrics.fabrics`)."""

    kind: ClassVar[str]

    def sample(self, n: int, rng: np.random.Generator) -> Theta:
        """Draw n fabrics, admissible or not."""
        raise NotImplementedError

    @cached_property
    def softening(self) -> float:
        """Exponent p of beta/alpha ~ alpha^p across fabrics: slope of a straight line through the
        logarithm of the mean |beta|/alpha over the mean log alpha. In the published table, and in
        the bundled autoencoder, it is 0.25."""
        samples = self.sample(_FIT_SAMPLES, np.random.default_rng(0))
        ratio = np.maximum(np.abs(samples[:, RATIO]).mean(axis=1), _LEAST_RATIO)
        (variance, covariance), _ = np.cov(log_stiffness(samples), np.log(ratio))
        return float(covariance / max(variance, TOLERANCE))


Count = Annotated[int, Field(ge=0, strict=True)]


def array(*shape: int | None) -> PlainValidator:
    """Check of a field of finite numbers with a given shape, None for any length but 0."""
    return PlainValidator(partial(_finite, shape))


def _finite(shape: tuple[int | None, ...], content: object) -> np.ndarray:
    try:
        numbers = np.array(content, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        numbers = np.array(np.nan)
    if (numbers.ndim != len(shape) or not numbers.size or not np.isfinite(numbers).all()
            or any(size not in (None, length) for size, length in
                   zip(shape, numbers.shape, strict=True))):
        raise ValueError(f"give {' × '.join(str(size or 'K') for size in shape)} finite numbers")
    return numbers


def require_fabrics(theta: Theta, least: int) -> None:
    """InputError for fewer than ``least`` fabrics."""
    if len(theta) < least:
        raise InputError(
            f"the table has {len(theta)} distinct fabrics; a prior needs at least {least}")


@dataclass(frozen=True, eq=False)
class TablePrior(Prior):
    """Measured fabrics, equally probable, for the evaluation of estimators."""

    theta: Annotated[np.ndarray, array(None, 6)]
    kind: ClassVar[str] = "table"

    def sample(self, n: int, rng: np.random.Generator) -> Theta:
        return self.theta[rng.integers(len(self.theta), size=n)]


def sample_admissible(prior: Prior, rng: np.random.Generator) -> tuple[Theta, int]:
    """An admissible fabric (:func:`sim.material.is_admissible`), and the number of rejected ones.
    """
    for rejected in range(MAX_TRIES):
        theta = prior.sample(1, rng)[0]
        if is_admissible(*from_theta(theta)):
            return theta, rejected
    raise InputError(f"none of {MAX_TRIES} samples of the prior is a possible fabric; fit it "
                     "to more fabrics")
