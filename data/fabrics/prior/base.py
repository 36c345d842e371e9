"""Interface of priors, and conversion of their parameters to and from JSON."""

from collections.abc import Callable
from dataclasses import fields
from functools import partial
from typing import Annotated, Any, ClassVar, Protocol, TypeVar

import numpy as np
from pydantic import Field, PlainValidator, TypeAdapter, ValidationError

from common.errors import InputError, one_line

ROUNDING = 1e-14  # of the largest variance; smaller eigenvalues are rounding errors
T = TypeVar("T", bound="Stored")


class Prior(Protocol):
    """A distribution over theta (see :mod:`data.fabrics.fabrics`)."""

    kind: ClassVar[str]

    def sample(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Draw theta (n, 6), admissible or not."""

    def as_dict(self) -> dict:
        """All parameters, in JSON types."""


class Stored:
    """Base of dataclasses stored in JSON; annotations of fields validate them, see :func:`array`.
    """

    def as_dict(self) -> dict:
        """All parameters, in JSON types."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: value.as_dict() if isinstance(value, Stored) else np.asarray(value).tolist()
                for name, value in values.items()}

    @classmethod
    def from_dict(cls: type[T], content: object) -> T:
        """Inverse of :meth:`as_dict`; InputError for an invalid parameter."""
        try:
            return TypeAdapter(cls).validate_python(content)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            cause = first.get("ctx", {}).get("error", first["msg"])
            raise InputError(f"{'.'.join(map(str, first['loc']))}: {one_line(Exception(cause))}"
                             ) from None


Count = Annotated[int, Field(ge=0, strict=True)]


def array(*shape: int | None, check: Callable[[np.ndarray], str] = lambda found: "") -> Any:
    """Type of a field of finite numbers with a given shape, None for any length.

    ``check`` returns an error message, empty for valid numbers.
    """
    return Annotated[np.ndarray, PlainValidator(partial(_finite, shape, check))]


def _finite(
    shape: tuple[int | None, ...], check: Callable[[np.ndarray], str], content: object
) -> np.ndarray:
    try:
        found = np.array(content, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        found = np.array(np.nan)
    if (found.ndim != len(shape) or not np.isfinite(found).all()
            or any(size not in (None, length) for size, length in
                   zip(shape, found.shape, strict=True))):
        raise ValueError(f"give {' × '.join(str(size or 'K') for size in shape)} finite numbers")
    if wrong := check(found):
        raise ValueError(wrong)
    return found


def wrong_covariance(covariances: np.ndarray) -> str:
    """Error message for covariances (..., K, K), finite; empty if they are valid.

    They must be symmetric and, beyond rounding errors, positive definite.
    """
    variances = np.linalg.eigvalsh(covariances)
    right = np.allclose(covariances, np.swapaxes(covariances, -1, -2)) and (
        variances[..., 0] > ROUNDING * variances[..., -1]).all()
    return "" if right else "covariances must be symmetric and positive definite"


def check_fabrics(theta: np.ndarray, *, least: int = 7) -> np.ndarray:
    """theta as floats (F, 6); InputError for another shape or fewer than ``least`` rows."""
    theta = np.asarray(theta, dtype=np.float64)
    if theta.ndim != 2 or theta.shape[1] != 6 or len(theta) < least:
        raise InputError(
            f"the table has {len(theta)} distinct fabrics; a prior needs at least {least}")
    return theta
