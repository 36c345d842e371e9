"""What all kinds of measurements have: a source as it is read, and what is recorded of it.

:class:`Measured` is a source at hand, :class:`Record` the part of ``estimate.json`` that is left of
it, from which it is joined with others.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, ClassVar, TypeVar

import numpy as np
from pydantic import BeforeValidator, Field, InstanceOf, PlainSerializer, PlainValidator

from common.documents import Excerpt, Schema, read_yaml, require_file_in
from common.errors import InputError
from common.files import finite, printable
from common.findings import Finding, records
from common.types import Density
from data.captures.capture import Capture
from data.captures.description import UNLABELLED, Labels, Weighed
from data.fabrics.fabrics import ClothProperties
from data.readings.known import Known
from data.render.setups import Setups
from drapenet.evidence.source import Source
from drapenet.measured import KINDS, SCAN
from drapenet.views.located import LocatedViews
from drapenet.views.observation import Observation

D = TypeVar("D", bound="Described")
M = TypeVar("M", bound="Measured")
Prior = Callable[[], ClothProperties]
"""Draws the usual fabrics, which takes a second: for kinds whose evidence needs them."""
INTERVALS = {"interval_68": 0.68, "interval_90": 0.90}
Text = InstanceOf[str]
"""A text that may hold a path, whose bytes need not be UTF-8."""
Finite = Annotated[float | None, BeforeValidator(finite)]
"""A number, None where it is not finite."""
Interval = Annotated[list[float], Field(min_length=2, max_length=2)]


def finding_of(content: Any) -> Finding:
    """The finding of a record that has a code with a sentence, and its values."""
    if isinstance(content, Finding):
        return content
    try:
        code, values, source = (content[key] for key in ("code", "values", "source"))
        records([found := Finding(code, values, source)])
    except (AttributeError, IndexError, KeyError, TypeError, ValueError):
        raise ValueError("is not the record of a finding") from None
    return found


Recorded = Annotated[Finding, PlainValidator(finding_of),
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
        return "{} ({})".format(*self.texts())


def intervals(samples: np.ndarray) -> dict[str, Any]:
    """Median and central intervals of samples (S, ...), over the first axis."""
    return {"median": np.median(samples, axis=0).tolist(), **{
        key: np.quantile(samples, [(1 - level) / 2, (1 + level) / 2], axis=0).tolist()
        for key, level in INTERVALS.items()}}


class Record(Excerpt):
    """What is kept of a source in ``estimate.json``: all that is joined later, for the source may
    be gone."""

    kind: ClassVar[str]
    """Name of its kind: :attr:`Measured.name`."""
    names: ClassVar[tuple[str, ...]] = ()
    """Columns that all tables have; others stand only where :meth:`columns` has them."""
    source: Text
    density_g_m2: float
    known: Known | None = None

    @property
    def needs_warp(self) -> bool:
        """Whether warp and weft must be told apart."""
        return False

    @property
    def bends(self) -> bool:
        """Whether it says how the fabric bends, beside ``known``."""
        return bool(self.sources())

    @property
    def membrane(self) -> float | None:
        """Geometric mean of the stretch along warp and weft, N/m at 300 g/m², if measured."""
        return None

    def sources(self) -> list[Source]:
        """What it is evidence of, beside ``known``."""
        return []

    def counted(self) -> tuple[int, str, str]:
        """How many specimens were measured, and what one and several are called."""
        return 1, self.kind, f"{self.kind}s"

    def lines(self) -> list[str]:
        """What was measured, for the terminal."""
        return []

    def columns(self) -> dict[str, Quantity | None]:
        """What was measured, by the name of its column in tables."""
        return {}

    def along(self, direction: str, *, usual: bool = False) -> Quantity | None:
        """Stretch along warp or weft, or for the bias shear, N/m; None if not measured, or, if the
        ``usual`` one will do, not known."""
        return None


def _record(content: Any) -> Record:
    """The record of the kind that the content names."""
    if isinstance(content, Record):
        return content
    try:
        kind = kind_named(content["kind"])
    except (InputError, KeyError, TypeError):
        raise ValueError("is not the record of a kind that is known here") from None
    return kind.recorded.model_validate(content)


AnyRecord = Annotated[Record, PlainValidator(_record), PlainSerializer(
    lambda record: {"kind": record.kind} | record.model_dump(by_alias=True, exclude_unset=True))]
"""A record of any kind; in JSON with the name of its kind."""


class Described(Weighed, Labels):
    """What is stated of a source that is no capture, in the description of its kind."""

    remedy = "docs/use.md shows an example"
    file: ClassVar[str]
    content: ClassVar[str]
    """What the file is to be written with, for whoever has none."""
    entries: ClassVar[str] = ""
    """Key of its list of specimens, if it has one."""
    pictures: ClassVar[tuple[str, ...]] = ()
    """Keys of these entries that name photographs."""
    typed: ClassVar[bool] = True
    """Whether the page of the service asks for its numbers, in place of a file."""
    known: Known | None = Field(
        None, title="values of other tests, alone where nothing else is measured",
        description=Known.remedy)

    @classmethod
    def in_folder(cls: type[D], folder: Path) -> D:
        """Read the description in a folder."""
        file = require_file_in(folder, cls.file, cls.content)
        return cls.of(read_yaml(file), file)

    def common(self, folder: Path) -> dict[str, Any]:
        """What sources of all kinds have, of that in a folder."""
        return {"path": folder, "density": self.density, "known": self.known,
                "labels": self.labels, "warnings": self.questions}

    @property
    def needs_warp(self) -> bool:
        """Whether captures of the same fabric must know the direction of the warp."""
        return bool(self.known and self.known.along_yarns)


@dataclass(frozen=True)
class Observed:
    """A capture as it is observed."""

    capture: Capture
    seen: Observation  # the network's input
    views: LocatedViews | None = None  # of a depth capture


class Stated(Schema):
    """What is known of a fabric beside the description of a source."""

    known: Known = Field(description=Known.remedy)


@dataclass(frozen=True, kw_only=True)
class Measured:
    """One source, read: what a folder or a file says of a fabric.

    A source has what a network observes (:meth:`observed`), a record of its own (:meth:`record`),
    or both.
    """

    name: ClassVar[str]
    """Of the kind: the stem of its description, with which the names of its results begin."""
    noun: ClassVar[str]
    """What was measured, in sentences."""
    apart: ClassVar[str] = "{noun}: give one after the other"
    """End of the sentence that refuses it beside a source of another kind."""
    version: ClassVar[int] = 1
    """To be raised when the kind makes other results of the same source."""
    schema: ClassVar[type[Weighed]]
    """Content of its description."""
    stated: ClassVar[type[Schema]] = Stated
    """Type of ``known`` values that a user gives beside a description."""
    recorded: ClassVar[type[Record]] = Record
    path: Path
    density: Density
    known: Known | None = None
    labels: Labels = UNLABELLED
    warnings: tuple[Finding, ...] = ()  # of reading

    @classmethod
    def read(cls, place: Path, stated: Mapping[str, Any]) -> "Measured":
        """Read a folder or file; InputError for the first fault.

        Args:
            stated: what a description would say, where the kind has none.
        """
        raise NotImplementedError

    @property
    def label(self) -> str:
        """Names it in sentences."""
        return printable(self.path)

    @property
    def digests(self) -> tuple[str, ...]:
        """SHA-256 of what was captured; sources that share one show the same."""
        return ()

    @property
    def marked(self) -> bool | None:
        """Whether the direction of the warp is known; None if the source needs none."""
        return None

    @property
    def alone(self) -> bool:
        """Whether a fabric may have no other source of strips under weights."""
        return False

    @property
    def needs_warp(self) -> bool:
        """Whether captures of the same fabric must know the direction of the warp."""
        return False

    def changed(self: M, **changes: Any) -> M:
        """The same source with other ``path``, ``labels``, ``known`` or ``warnings``."""
        return replace(self, **changes)

    def with_known(self: M, known: Mapping[str, Any]) -> M:
        """The source that also states what is ``known`` of the fabric, as its file would."""
        if self.known:
            raise InputError(f"known is in {self.path} and an argument; give the values in one of "
                             "them")
        described: Any = self.stated.of({"known": known}, "")
        return self.changed(known=described.known)

    def observed(self) -> Observed | None:
        """What the network reads; None if it is not for the network."""
        return None

    def record(self, prior: Prior) -> Record | None:
        """What is recorded, evidence with respect to a ``prior``; None if the network reads all of
        it."""
        return None

    def findings(self, observed: Observed | None, setups: Setups) -> list[Finding]:
        """Doubts beside the ``warnings``, of what was observed as the ``setups`` that were trained
        or not, or of the record; InputError if nothing can be estimated."""
        return []

    def shown(self) -> bytes:
        """PNG of the source as it was read; empty if there is nothing to see."""
        return b""

    def thumbnail(self) -> bytes:
        """A small PNG for lists; likewise."""
        return b""

    def tables(self) -> dict[str, bytes]:
        """Files to be checked, by their names: what was read in numbers."""
        return {}


def kind_named(name: str) -> type[Measured]:
    """The kind of this name, such as "strips", or "scan"; InputError if there is none."""
    places = {Path(file).stem: place for file, place in KINDS.items()} | {"scan": SCAN}
    if name not in places:
        raise InputError(f"{name} is not a kind of measurement; it is one of {', '.join(places)}")
    return kind_at(places[name])


def kind_at(place: str) -> type[Measured]:
    """The kind at a place of :data:`drapenet.measured.KINDS`, imported."""
    module, _, name = place.partition(":")
    return getattr(import_module(module), name)
