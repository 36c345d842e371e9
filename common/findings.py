"""What is to be said of a capture, a value or an estimate, as a record: a fact, not a sentence.

A finding is made where its fact is known, and travels as it is. Its words are made at the view, by
:attr:`Finding.text`, from the sentences of ``findings.yaml``, the one place of all of them.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import yaml

from common.files import finite, printable

SENTENCES = Path(__file__).with_suffix(".yaml")


@cache
def sentences() -> dict[str, str]:
    """The sentence of each code, with the names of its values in braces, as in str.format."""
    found: dict[str, str] = yaml.safe_load(SENTENCES.read_text(encoding="utf-8"))
    return found


@dataclass(frozen=True)
class Finding:
    """A warning, a contradiction, an advice or the reason of a refusal.

    ``values`` are what its sentence states, in JSON's types: numbers in the unit that people see,
    and names; ``value`` and ``limit`` where a measured value has a limit.
    """

    code: str  # a key of findings.yaml
    values: Mapping[str, Any] = field(default_factory=dict)
    source: str = ""  # key of the capture, strip or stated value; '': what is estimated

    @property
    def text(self) -> str:
        """The line for people: fact, limit, remedy."""
        return sentences()[self.code].format(**{
            name: math.nan if value is None else value for name, value in self.values.items()})

    @property
    def record(self) -> dict[str, Any]:
        """In JSON's types, with its text; a number that is not finite is None."""
        return {"code": self.code, "source": printable(self.source), "text": self.text,
                "values": finite(dict(self.values))}


def texts(findings: Iterable[Finding]) -> list[str]:
    """The lines of findings."""
    return [found.text for found in findings]


def records(findings: Iterable[Finding]) -> list[dict[str, Any]]:
    """The records of findings."""
    return [found.record for found in findings]
