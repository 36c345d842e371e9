"""Arguments of functions that researchers call with what they have: checked where they enter."""

from numbers import Integral
from typing import Any

import numpy as np

from common.errors import InputError, one_line, shown


def number(name: str, value: object, unit: str) -> float:
    """An argument of one finite number, which is no text; InputError for others."""
    return float(numbers(name, value, f"a finite number, {unit}", ()))


def numbers(
    name: str, values: Any, what: str, shape: tuple[int | None, ...] | None = None
) -> np.ndarray:
    """An argument of finite real numbers of a ``shape``, in which None is any length, as a float64
    array, which may be the argument itself; InputError for others, masked ones among them, which
    says to give ``what``."""
    try:
        found = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise wrong(name, values, what) from None
    except RuntimeError as error:  # a tensor with gradients
        raise InputError(f"{name}: {one_line(error)}") from None
    fits = shape is None or (found.ndim == len(shape) and all(
        length in (None, size) for length, size in zip(shape, found.shape, strict=True)))
    plain = not (isinstance(values, str | bool) or np.ma.is_masked(values)
                 or np.iscomplexobj(values))
    if fits and plain and np.isfinite(found).all():
        return found
    raise wrong(name, values, what)


def whole_number(name: str, value: object, least: int) -> int:
    """An argument of a whole number of at ``least`` that; InputError for others."""
    if isinstance(value, Integral) and int(value) >= least:
        return int(value)
    raise wrong(name, value, f"a whole number, at least {least}")


def wrong(name: str, value: object, what: str) -> InputError:
    """The error of an argument in place of which to give ``what``."""
    shape = tuple(getattr(value, "shape", ()))
    return InputError(f"{name}" + (f" of the shape {shape}" if len(shape) > 1 else
                                   f"={shown(value)}") + f": give {what}")


def require(**given: tuple[Any, ...]) -> None:
    """InputError for an argument of another class: of each its value, its class and, if it helps,
    an example."""
    for name, (value, kind, *example) in given.items():
        if not isinstance(value, kind):
            raise InputError("; give one such as ".join([
                f"{name}={shown(value)} is not of the class {getattr(kind, '__name__', kind)}",
                *example]))
