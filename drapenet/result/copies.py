"""Captures that repeat pictures of others: of one fabric they count once, wherever it is joined."""

from collections.abc import Iterable, Sequence
from typing import TypeVar

from common.findings import Finding
from drapenet.result.document import EstimateDocument

_Item = TypeVar("_Item")


def first_with(first: dict[str, _Item], digests: Iterable[str], item: _Item) -> _Item | None:
    """The earlier capture that shares one of the ``digests`` of ``item``, of those that are kept in
    ``first``; None: there is none, and ``item`` is kept."""
    every = tuple(digests)
    if shared := next((digest for digest in every if digest in first), None):
        return first[shared]
    first.update(dict.fromkeys(every, item))
    return None


def copies(documents: Sequence[EstimateDocument]) -> dict[int, int]:
    """Of the estimates of a fabric's captures and strips, by their numbers, those of pictures of an
    earlier one, or of its numbers, each with that one."""
    first: dict[str, int] = {}
    found = ((k, first_with(first, filter(None, document.capture.digests), k))
             for k, document in enumerate(documents))
    return {k: other for k, other in found if other is not None}


def left_out(documents: Sequence[EstimateDocument]) -> dict[int, Finding]:
    """A warning for each of the :func:`copies`."""
    return {k: Finding("twin_left_out", {"capture": documents[k].label,
                                         "other": documents[other].label})
            for k, other in copies(documents).items()}
