"""Sources of a fabric, whatever door they came through: where each is, and where its results go."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from common.files import printable
from data.captures.capture import Capture
from drapenet.measured.base import Measured
from drapenet.measured.captures import Captured
from drapenet.measured.read import kind_in, read_measured, sources_in


@dataclass(frozen=True, kw_only=True)
class Source:
    """A capture, a scan, strips or values: what a fabric is estimated from.

    Attributes:
        place: folder or file of the user, or what is read already, such as a capture of arrays.
        part: folder of its results, from that of the fabric on.
        name: names it in sentences in place of its path, which a client of a service must not see.
        required: whether the fabric is refused with it; others are left out, with a warning.
        kind: name of its kind of measurement; '': by what is in the folder.
        stated: what a door states beside the files: of a scan the specimen, or ``known``.
    """

    place: Path | Measured
    part: str = "."
    name: str = ""
    required: bool = True
    kind: str = ""
    stated: Mapping[str, Any] = field(default_factory=dict)

    @property
    def path(self) -> Path:
        """The path that names it."""
        place = self.place if isinstance(self.place, Path) else self.place.path
        return Path(self.name) if self.name else place

    @property
    def label(self) -> str:
        """Names it in sentences."""
        return printable(self.path)

    def read(self) -> Measured:
        """What it says; InputError for the first fault."""
        if isinstance(self.place, Path):
            found = read_measured(self.place, self.stated, self.kind)
        else:
            known = self.stated.get("known")
            found = self.place.with_known(known) if known else self.place
        return found.changed(path=self.path) if self.name else found


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
        if isinstance(place, Capture):
            found.append(Source(place=Captured.of(place)))
        elif scan is not None:
            found.append(Source(place=place, kind="scan", stated=scan))
        else:
            folders = sources_in(place, "capture")
            found += [Source(place=folder, kind=kind_in(folder).name, required=len(folders) == 1)
                      for folder in folders]
    found += [Source(place=Path(place), kind=kind)
              for kind, place in (("strips", strips), ("tension", tension)) if str(place)]
    if known is not None:
        found[0] = replace(found[0], stated={**found[0].stated, "known": known})
    return found if len(found) == 1 else [
        replace(source, part=f"{source.kind.replace('scan', '') or 'capture'}_{k}")
        for k, source in enumerate(found)]
