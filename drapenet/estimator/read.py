"""Read: captures, scans and strips of a fabric, with what is stated of it."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from common.errors import InputError
from common.types import Density
from data.captures.description import NEED_WARP, Specimen
from data.readings.known import Known
from drapenet.measured.base import Measured
from drapenet.measured.read import read_measured, sources_in
from drapenet.result.copies import first_with

MAX_DENSITY_DIFFERENCE = 0.1  # between specimens of one fabric, relative to the smallest
Refused = dict[Path, InputError]
"""Captures that are refused, and why."""


def read_sources(
    places: Iterable[Path], strips: str | Path = "", tension: str | Path = ""
) -> tuple[list[Measured], Refused | None]:
    """The sources in the ``places``, the hanging strips and those under weights of folders; and
    those captures of a folder of several that are refused, if not all are; None: each place is a
    source, which must be read."""
    named = _named(strips, tension)
    sources: list[Measured] = []
    refused: Refused | None = None
    for place in places:
        folders = sources_in(place, "capture")
        if len(folders) > 1:
            refused = refused or {}
        for path in folders:
            try:
                sources.append(read_measured(path))
            except InputError as error:
                if refused is None or len(folders) == 1:
                    raise
                refused[path] = error
    if refused and not sources:
        raise next(iter(refused.values()))
    return [*sources, *named], refused


def read_scans(
    files: Iterable[Path], specimen: Specimen, strips: str | Path = "", tension: str | Path = ""
) -> list[Measured]:
    """The captures made of scans of a ``specimen``, and the strips as :func:`read_sources`."""
    named, stated = _named(strips, tension), specimen.model_dump()  # first: scans need seconds
    return [*(read_measured(file, stated, "scan") for file in files), *named]


def _named(strips: str | Path, tension: str | Path) -> list[Measured]:
    """The strips of folders that are named with their kind; none of ''."""
    return [read_measured(Path(folder), kind=kind)
            for kind, folder in (("strips", strips), ("tension", tension)) if folder]


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
