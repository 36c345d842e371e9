"""Types of the content of ``estimate.json``: a quantity with its intervals, findings, texts."""

import math
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field, InstanceOf, PlainSerializer, PlainValidator

from common.documents import Excerpt
from common.findings import Finding, records

INTERVALS = {"interval_68": 0.68, "interval_90": 0.90}
Text = InstanceOf[str]
"""A text that may hold a path, whose bytes need not be UTF-8."""
Finite = Annotated[float | None, BeforeValidator(
    lambda value: None if isinstance(value, float) and not math.isfinite(value) else value)]
"""A number, None where it is not finite, for which JSON has no notation."""
Interval = Annotated[list[float], Field(min_length=2, max_length=2)]


def _finding(content: Any) -> Finding:
    """The finding of a record that has a code with a sentence, and its values."""
    if isinstance(content, Finding):
        return content
    try:
        code, values, source = (content[key] for key in ("code", "values", "source"))
        records([found := Finding(code, values, source)])
    except (AttributeError, IndexError, KeyError, TypeError, ValueError):
        raise ValueError("is not the record of a finding") from None
    return found


Recorded = Annotated[Finding, PlainValidator(_finding),
                     PlainSerializer(lambda found: found.record)]
"""A finding; in JSON its :attr:`~common.findings.Finding.record`."""


class Quantity(Excerpt):
    """Median and central intervals of a quantity."""

    median: float
    interval_68: Interval
    interval_90: Interval

    def times(self, factor: float) -> "Quantity":
        """The quantity multiplied by a positive factor."""
        return Quantity(median=factor * self.median,
                        interval_68=[factor * end for end in self.interval_68],
                        interval_90=[factor * end for end in self.interval_90])

    def texts(self, key: str = "interval_68") -> tuple[str, str]:
        """Median and interval as text, with decimals according to the interval's width."""
        low, high = getattr(self, key)
        places = 0
        if (half := (high - low) / 2) > 0:
            places = min(max(1 - math.floor(math.log10(half)), 0), 6)
        return f"{self.median:.{places}f}", f"{low:.{places}f} to {high:.{places}f}"

    def __str__(self) -> str:
        """Median and 68 % interval."""
        return "{} ({})".format(*self.texts())


def intervals(samples: np.ndarray) -> dict[str, Any]:
    """Median and central intervals of samples (S, ...), over the first axis."""
    return {"median": np.median(samples, axis=0).tolist(), **{
        key: np.quantile(samples, [(1 - level) / 2, (1 + level) / 2], axis=0).tolist()
        for key, level in INTERVALS.items()}}
