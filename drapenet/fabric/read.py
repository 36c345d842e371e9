"""Read: captures, scans and strips of a fabric, with what is stated of it."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from common.documents import read_yaml
from common.errors import InputError
from common.types import Density
from data.captures.capture import Capture
from data.captures.description import NEED_WARP, Description, Specimen
from data.captures.reader import DESCRIPTION, captures_in, read_capture
from data.readings.known import Known
from data.strips.description import FILE as STRIPS
from data.strips.description import StripsDescription
from data.tension.description import FILE as TENSION
from drapenet.result.copies import first_with

if TYPE_CHECKING:
    from data.strips.folder import StripSet
    from data.tension.folder import TensionSet

    Source = Capture | StripSet | TensionSet
else:  # the simulator of strips is loaded where there are some
    Source = Any
"""What an estimate is made from."""
MAX_DENSITY_DIFFERENCE = 0.1  # between specimens of one fabric, relative to the smallest


def read_source(folder: Path) -> Source:
    """The strips of a folder with ``strips.yaml`` or ``tension.yaml``, else its capture."""
    if (folder / TENSION).exists():
        return _tension(folder)[0]
    return _strips(folder)[0] if (folder / STRIPS).exists() else read_capture(folder)


def _strips(folder: str | Path) -> "list[StripSet]":
    """The strips of a folder; none of ''."""
    if not folder:
        return []
    from data.strips.folder import read_strips  # the simulator of strips, which captures need not

    return [read_strips(folder)]


def _tension(folder: str | Path) -> "list[TensionSet]":
    """The strips under weights of a folder; none of ''."""
    if not folder:
        return []
    from data.tension.folder import read_tension  # a fit, which others need not

    return [read_tension(folder)]


Refused = dict[Path, InputError]
"""Captures that are refused, and why."""


def read_sources(
    places: Iterable[Path], strips: str | Path = "", tension: str | Path = ""
) -> tuple[list[Source], Refused | None]:
    """The captures in the ``places``, the hanging strips and those under weights of folders; and
    those captures of a folder of several that are refused, if not all are; None: each place is a
    capture, which must be read."""
    of_strips: list[Source] = [*_strips(strips), *_tension(tension)]
    captures: list[Source] = []
    refused: Refused | None = None
    for place in places:
        folders = captures_in(place)
        if len(folders) > 1:
            refused = refused or {}
        for path in folders:
            try:
                captures.append(read_capture(path))
            except InputError as error:
                if refused is None or len(folders) == 1:
                    raise
                refused[path] = error
    if refused and not captures:
        raise next(iter(refused.values()))
    return [*captures, *of_strips], refused


def read_scans(
    files: Iterable[Path], specimen: Specimen, strips: str | Path = "", tension: str | Path = ""
) -> list[Source]:
    """The captures made of scans of a ``specimen``, and the strips as :func:`read_sources`."""
    of_strips: list[Source] = [*_strips(strips), *_tension(tension)]  # first: scans need seconds
    from drapenet.surface.registration import read_scan_capture

    return [*(read_scan_capture(file, specimen) for file in files), *of_strips]


def known_of(folder: Path) -> Source | None:
    """What the description of a capture that is refused states of its fabric, as strips.yaml
    without strips would; None if there is nothing that can be read."""
    file = folder / DESCRIPTION
    try:
        description = Description.of(read_yaml(file), file)
    except InputError:
        return None
    if not (description.known and description.known.values()):
        return None
    from data.strips.folder import StripSet  # see above

    known = Known(**description.known.model_dump(include={*Known.model_fields}))
    return StripSet(folder, description.density, known=known, labels=description.labels)


def with_known(sources: Sequence[Source], known: Mapping[str, Any] | None) -> list[Source]:
    """The ``sources`` of a fabric, of which the first also states what is ``known`` of it, as its
    file would: only one, for a drape coefficient is evidence of each capture that states it."""
    if known is None:
        return list(sources)
    if stated := next((source for source in sources if source.known), None):
        raise InputError(f"known is in {stated.path} and an argument; give the values in one of "
                         "them")
    first, *others = sources
    model = Description if isinstance(first, Capture) else StripsDescription
    described = model.of({"density_g_m2": round(1e3 * first.density, 6), "known": known}, "")
    checked: Any = described.known  # of the kind that the source states
    return [replace(first, known=checked), *others]


def require_one_fabric(
    densities: Sequence[Density], digests: Iterable[tuple[str, Sequence[str]]]
) -> None:
    """InputError for captures that cannot be combined; ``digests``: name and
    :attr:`~data.captures.capture.Capture.digests` of each.
    """
    names: dict[str, str] = {}
    for name, every in digests:
        if other := first_with(names, every, name):
            raise InputError(f"{other} and {name} have the same views, which are not "
                             "independent; give each capture once")
    require_one_density(densities)


def require_one_density(densities: Sequence[Density]) -> None:
    """InputError for specimens whose densities, kg/m², are too different to be of one fabric."""
    low, high = min(densities, default=0.0), max(densities, default=0.0)
    if high > (1 + MAX_DENSITY_DIFFERENCE) * low:
        raise InputError(f"captures and strips of one fabric state densities from {1e3 * low:g} to "
                         f"{1e3 * high:g} g/m², more than {MAX_DENSITY_DIFFERENCE:.0%} apart; "
                         "correct density_g_m2, or give different fabrics apart")


def require_directions(marked: bool, strips: bool, stated: Iterable[Known | None]) -> None:
    """InputError if strips or values along the yarns meet captures without the warp's direction."""
    if marked:
        return
    if strips:
        raise InputError(f"strips along the yarns {NEED_WARP}")
    if any(known.along_yarns for known in stated if known):
        raise InputError(f"known values along the yarns {NEED_WARP}")
