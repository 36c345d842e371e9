"""Checks of a capture, for pictures, messages and warnings."""

from collections.abc import Iterable
from dataclasses import dataclass

from common.findings import Finding

MAX_COEFFICIENT = 1.15  # of a drape, from 0 to 1; sound captures of stiff cloth have up to 0.98

@dataclass(frozen=True)
class Check:
    """What is measured of a capture, as text; a warning, None if it is sound."""

    name: str
    value: str
    warning: Finding | None = None


def warnings_of(checks: Iterable[Check]) -> list[Finding]:
    """The warnings of those checks that have one."""
    return [check.warning for check in checks if check.warning]
