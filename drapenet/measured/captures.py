"""Captures of a draped specimen as the network reads them: depth views, an outline, or numbers."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import singledispatch
from pathlib import Path
from typing import Any, TypeVar

from pydantic import Field

from common.documents import Schema
from common.errors import InputError
from common.findings import Finding
from data.captures.capture import Capture, DepthCapture, OutlineCapture, ReportedCapture
from data.captures.description import Description
from data.captures.reader import read_capture
from data.readings.known import Reported
from data.render.setups import Setups
from drapenet.measured.base import Measured, Observed
from drapenet.views.checks import view_warnings
from drapenet.views.located import LocatedViews
from drapenet.views.observation import Observation

C = TypeVar("C", bound="Captured")


class StatedOfDrape(Schema):
    """What is known of a draped fabric beside its description."""

    known: Reported = Field(description=Reported.remedy)


@dataclass(frozen=True, kw_only=True)
class Captured(Measured):
    """A capture of any type."""

    name, noun, schema, stated = "capture", "captures", Description, StatedOfDrape
    capture: Capture

    @classmethod
    def read(cls, place: Path, stated: Mapping[str, Any]) -> "Captured":
        return cls.of(read_capture(place))

    @classmethod
    def of(cls: type[C], capture: Capture) -> C:
        """The source of a capture that is read already."""
        return cls(capture=capture, path=capture.path, density=capture.density,
                   known=capture.known, labels=capture.labels, warnings=capture.warnings)

    @property
    def digests(self) -> tuple[str, ...]:
        return self.capture.digests

    @property
    def marked(self) -> bool:
        return self.capture.warp_direction is not None

    def changed(self: C, **changes: Any) -> C:
        return self.of(replace(self.capture, **changes))

    def observed(self) -> Observed:
        return observe(self.capture)

    def findings(self, observed: Observed | None, setups: Setups) -> list[Finding]:
        if not (observed and observed.views and observed.seen.map):
            return []
        return view_warnings(observed.views, observed.seen.map, setups)

    def shown(self) -> bytes:
        from data.captures.preview import show  # Matplotlib

        return show(self.capture)

    def thumbnail(self) -> bytes:
        from data.captures.preview import show

        return show(self.capture, small=True)


class Scan(Captured):
    """The scan of a drape; what is stated of it is a description without camera and tester."""

    @classmethod
    def read(cls, place: Path, stated: Mapping[str, Any]) -> "Scan":
        from drapenet.surface.registration import read_scan_capture  # of meshes, half a second

        specimen = Description.of(stated, "")
        return cls.of(replace(read_scan_capture(place, specimen), known=specimen.known,
                              labels=specimen.labels))


@singledispatch
def observe(capture: Capture) -> Observed:
    """What the network reads of a capture; InputError if it does not show what its type needs."""
    raise InputError(f"{capture.path}: captures of the kind {type(capture).__name__} cannot be "
                     "observed; register one in drapenet/measured/captures.py")


@observe.register
def _(capture: DepthCapture) -> Observed:
    views = LocatedViews.of(capture)
    return Observed(capture, Observation.of_views(views, capture.sign, capture.warp_direction),
                    views)


@observe.register
def _(capture: OutlineCapture) -> Observed:
    return Observed(capture, Observation.of_outline(capture))


@observe.register
def _(capture: ReportedCapture) -> Observed:
    marked = capture.warp_direction is not None
    return Observed(capture, Observation.of_numbers(capture.rig, capture.sign, marked,
                                                    capture.known))
