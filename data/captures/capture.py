"""Captures of a draped specimen: what all have in common, and a type for each kind.

A further kind is a type here, its reader in :mod:`data.captures.reader`, and what it gives to the
estimator (:mod:`drapenet.fabric.observe`) and to the eye (:mod:`data.captures.preview`).
"""

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from common.findings import Finding
from common.types import Density, Radians, Turns, Views
from data.captures.cutout import CutOut
from data.captures.description import UNLABELLED, Labels
from data.readings.known import Reported
from data.render.cameras import Intrinsics
from sim.rig import Rig

if TYPE_CHECKING:
    from data.captures.photograph import PhotographedOutline


@dataclass(frozen=True)
class Check:
    """What is measured of a capture, as text; a warning, None if it is sound."""

    name: str
    value: str
    warning: Finding | None = None


def warnings_of(checks: Iterable[Check]) -> list[Finding]:
    """The warnings of those checks that have one."""
    return [check.warning for check in checks if check.warning]


@dataclass(frozen=True, kw_only=True)
class Capture:
    """What is stated of a draped specimen, whatever was captured of it.

    Attributes:
        warp_direction: in the first view, in [0, pi), 0 to the right in the picture, pi/2 away from
            the camera (up in a picture from above); None when it is not marked.
        path: names it.
        face: "up" if the face of the fabric that the laboratory has marked is on top, else "down".
    """

    density: Density
    rig: Rig
    warp_direction: Radians | None = None
    path: Path = Path("capture")
    face: str = "up"
    known: Reported | None = None
    labels: Labels = UNLABELLED
    warnings: tuple[Finding, ...] = ()

    @property
    def sign(self) -> int:
        """1 if the marked face is up, else -1."""
        return 1 if self.face == "up" else -1

    @property
    def content(self) -> bytes:
        """What was captured; two captures of one fabric never have the same."""
        raise NotImplementedError

    @property
    def causes(self) -> str:
        """What to check where what is seen contradicts what is stated, the likeliest first."""
        return Finding("check_views").text

    @property
    def digest(self) -> str:
        """SHA-256 of the content."""
        return hashlib.sha256(self.content).hexdigest()

    @property
    def files_sha256(self) -> tuple[str, ...]:
        """Of the bytes of an outline's files, the same whatever is stated with them."""
        return ()

    @property
    def digests(self) -> tuple[str, ...]:
        """Of the content and of the files; captures that share one are of the same pictures."""
        return self.digest, *self.files_sha256


@dataclass(frozen=True)
class DepthCapture(Capture):
    """Depth views of a specimen on a turntable.

    Attributes:
        turns: nominal, since the first view.
        cut: None if the frames showed only cloth.
    """

    views: Views
    intrinsics: Intrinsics
    turns: Turns
    cut: CutOut | None = None

    @property
    def content(self) -> bytes:
        """The views."""
        return self.views.tobytes()


@dataclass(frozen=True)
class OutlineCapture(Capture):
    """The outline of a drape from above, of a photograph or of a table."""

    outline: "PhotographedOutline"

    @property
    def causes(self) -> str:
        """Those of the outline."""
        return self.outline.causes

    @property
    def content(self) -> bytes:
        """The curve."""
        return self.outline.curve.tobytes()

    @property
    def files_sha256(self) -> tuple[str, ...]:
        """Those of the outline."""
        return self.outline.files_sha256


@dataclass(frozen=True)
class ReportedCapture(Capture):
    """A drape coefficient, and perhaps a number of nodes, without any picture: in ``known``."""

    @property
    def content(self) -> bytes:
        """The numbers."""
        return str(self.known).encode()
