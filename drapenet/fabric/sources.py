"""Sources of a fabric, whatever door they came through: where each is, and where its results go."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from common.errors import InputError
from common.files import printable
from data.captures.capture import Capture
from data.captures.reader import captures_in
from drapenet.measured import kind_at


@dataclass(frozen=True, kw_only=True)
class Source:
    """A capture, a scan, strips or values: what a fabric is estimated from.

    Attributes:
        place: folder or file of the user, or a capture made of arrays.
        part: folder of its results, from that of the fabric on.
        name: names it in sentences in place of its path, which a client of a service must not see.
        required: whether the fabric is refused with it; others are left out, with a warning.
        stated: what a door states beside the files: of a scan the specimen, or ``known``.
    """

    place: Path | Capture
    part: str = "."
    name: str = ""
    required: bool = True
    stated: Mapping[str, Any] = field(default_factory=dict)

    @property
    def path(self) -> Path:
        """The path that names it."""
        place = self.place.path if isinstance(self.place, Capture) else self.place
        return Path(self.name) if self.name else place

    @property
    def label(self) -> str:
        """Names it in sentences."""
        return printable(self.path)


def sources_of(
    places: Sequence[Path | Capture], *, strips: str | Path = "", tension: str | Path = "",
    scan: Mapping[str, Any] | None = None, known: Mapping[str, Any] | None = None,
) -> list[Source]:
    """The sources that a command names: captures, folders of captures, in which those that are
    refused are left out, or files of ``scan``s with what is stated of the specimen; then the
    folders of strips and of strips under weights. The first also states what is ``known``.

    The results of a source alone are those of the fabric; of several each has a folder.
    """
    found: list[Source] = []
    for place in places:
        if scan is not None or isinstance(place, Capture):
            found.append(Source(place=place, stated=scan or {}))
            continue
        folders = captures_in(place)
        found += [Source(place=folder, required=len(folders) == 1) for folder in folders]
    found += [Source(place=Path(place)) for place in (strips, tension) if str(place)]
    if not found:
        raise InputError("nothing is known of the fabric; give captures or strips")
    if known is not None:
        found[0] = replace(found[0], stated={**found[0].stated, "known": known})
    return found if len(found) == 1 else [
        replace(source, part=f"{kind_at(source.place)}_{k}") for k, source in enumerate(found)]
