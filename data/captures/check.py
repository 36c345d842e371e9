"""Checks of a capture, for pictures, messages and warnings."""

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class Check:
    """What is measured of a capture, as text; a warning with its remedy, empty if it is sound."""

    name: str
    value: str
    warning: str = ""


def warnings_of(checks: Iterable[Check]) -> list[str]:
    """The warnings of those checks that have one."""
    return [check.warning for check in checks if check.warning]
