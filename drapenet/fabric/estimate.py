"""The estimate of a fabric from all its sources: the one way for the command, batches, the service
and Python.

Each source is a :class:`~drapenet.fabric.part.Part` with files of its own, which are read where
they are made from the same, and made where they are not; :func:`join` makes the fabric's estimate
from the parts, as they are stored.
"""

import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from common.documents import read_json
from common.errors import InputError
from common.files import remove_file, replace_json
from common.findings import Finding
from common.types import Density
from data.captures.description import NEED_WARP
from data.readings.quantity import MAX_DENSITY_DIFFERENCE
from drapenet.config import EstimateOptions
from drapenet.fabric.combine import combine, evidence_of, one_capture, stated_of
from drapenet.fabric.describe import describe_jointly
from drapenet.fabric.infer import infer_jointly
from drapenet.fabric.next_measurements import next_measurements
from drapenet.fabric.part import (
    PART,
    Part,
    Refusal,
    make_part,
    part_key,
    stored_part,
)
from drapenet.fabric.sources import Source
from drapenet.fabric.stages import require_sound
from drapenet.measured.base import Measured
from drapenet.measured.read import values_alone
from drapenet.network.checkpoint import Header
from drapenet.result.copies import first_with
from drapenet.result.document import EstimateDocument
from drapenet.result.estimate import Estimate
from drapenet.result.files import remove_report, write_estimate
from drapenet.views.observation import Observation

FABRIC = "fabric.json"
"""The parts of a fabric's estimate, by their folders in its own."""


@dataclass(frozen=True)
class FabricResult:
    """The estimate of a fabric.

    Attributes:
        parts: what each source says, in their order; None: a copy that was not estimated.
        copies: findings of the sources with pictures of an earlier one, by number.
    """

    estimate: Estimate
    document: EstimateDocument
    parts: list[Part | Refusal | None]
    copies: dict[int, Finding] = field(default_factory=dict)

    @property
    def scatter(self) -> np.ndarray | None:
        """(3,) geometric standard deviation of alpha of the captures; None for one capture."""
        middles = [np.log([moduli.alpha_uN_m.median
                           for moduli in part.document.moduli_at_300_g_m2.values()])
                   for k, part in enumerate(self.parts) if k not in self.copies
                   and isinstance(part, Part) and part.observation]
        return np.exp(np.std(middles, axis=0, ddof=1)) if len(middles) > 1 else None


def estimate_fabric(
    sources: Sequence[Source], header: Header, options: EstimateOptions, *,
    folder: Path | None = None, fabric: str = "", twins: Sequence[Finding] = (),
    listed: bool = False,
    on_estimate: Callable[[EstimateDocument, Path | None], None] = lambda document, folder: None,
) -> FabricResult:
    """Estimate a fabric from all its ``sources``, and each of several by itself.

    A source that is refused is left out with a warning, and so is a copy of another, unless it is
    required; what a refused one states of the fabric is kept.

    Args:
        folder: of the fabric's files, if any, in which those of the parts have theirs.
        fabric: its name, in place of that which sources state.
        twins: of its captures in other fabrics.
        listed: whether it is one of many, whose pages and tables have its report and what is
            refused: it has no report of its own, and a strict one may lack sources.
        on_estimate: called with each document that is made, and its folder.

    InputError if a required source is refused, if all are, or for sources that cannot be of one
    fabric; if ``options`` are strict for a source that is refused or doubted.
    """
    if not sources:
        raise InputError("nothing is known of the fabric; give captures or strips")
    read = [_read(source, folder, header, options) for source in sources]
    strict = options.strict and not listed
    _require_some(read, strict)
    copies = _copies(sources, read)
    require_one_fabric([each for k, each in enumerate(read) if k not in copies
                         and not isinstance(each, Refusal)])
    parts: list[Part | Refusal | None] = []
    for k, (source, each) in enumerate(zip(sources, read, strict=True)):
        part = each if not isinstance(each, Measured) else None if k in copies else _made(
            each, source, folder, header, options)
        if isinstance(part, Part):
            on_estimate(part.document, _place(source, folder))
        parts.append(part)
    kept = [part.named(fabric) for k, part in enumerate(parts)
            if k not in copies and isinstance(part, Part)]
    _require_some(parts, strict)
    if len(sources) == 1:
        return _alone(kept[0], twins, folder, fabric, options.strict)
    kept.sort(key=lambda part: part.observation is None)
    known, lost = _known(parts, kept, header)
    joined = [*kept, *(part.named(fabric) for part in known)]
    estimate, document = join(joined, header, strict=options.strict,
                              ahead=bool(folder and options.drapes))
    missing = [part.finding for part in parts if isinstance(part, Refusal)]
    require_sound([*copies.values(), *twins, *lost], options.strict, "the fabric")
    document = document.warned(*copies.values(), *twins, *missing, *lost)
    if folder:
        _write_joint(folder, estimate, document, kept, options, reported=not listed)
    on_estimate(document, folder)
    return FabricResult(replace(estimate, warnings=tuple(document.warnings),
                                captures=_seen(kept)), document, parts, copies)


def _place(source: Source, folder: Path | None) -> Path | None:
    """The folder of a source's part; that of the fabric need not exist."""
    return Path(os.path.normpath(folder / source.part)) if folder else None


def _read(
    source: Source, folder: Path | None, header: Header, options: EstimateOptions
) -> Part | Refusal | Measured:
    """The part of a source that is stored, or the source as it is read, or why it is refused."""
    place = _place(source, folder)
    if place and (stored := stored_part(source, place, part_key(source, header, options))):
        return stored
    try:
        return source.read()
    except InputError as error:
        if source.required:
            raise
        return Refusal.of(source, error)


def _made(
    measured: Measured, source: Source, folder: Path | None, header: Header,
    options: EstimateOptions
) -> Part | Refusal:
    """The part of a source as it was read."""
    place = _place(source, folder)
    key = part_key(source, header, options) if place else ""
    try:
        return make_part(measured, source, header, options, folder=place, key=key)
    except InputError as error:
        if source.required:
            raise
        return Refusal.of(source, error)


def _require_some(parts: Iterable[Part | Refusal | Measured | None], strict: bool) -> None:
    """InputError if all are refused, or one, if none may be."""
    every = list(parts)
    errors = [part.error for part in every if isinstance(part, Refusal)]
    if errors and (strict or len(errors) == len([part for part in every if part])):
        raise errors[0]


def _copies(
    sources: Sequence[Source], parts: Sequence[Part | Refusal | Measured]
) -> dict[int, Finding]:
    """A finding for each source with pictures of an earlier one; InputError if it is required."""
    first: dict[str, str] = {}
    found = {}
    for k, (source, part) in enumerate(zip(sources, parts, strict=True)):
        other = None if isinstance(part, Refusal) else first_with(first, part.digests, source.label)
        if other and source.required:
            raise InputError(f"{other} and {source.label} have the same views, which are not "
                             "independent; give each capture once")
        if other:
            found[k] = Finding("twin_left_out", {"capture": source.label, "other": other})
    return found


def require_one_fabric(parts: Sequence[Part | Measured]) -> None:
    """InputError for sources that cannot be of one fabric."""
    require_one_density([(part.label, part.density) for part in parts])
    weighted = [part.label for part in parts if part.alone]
    if len(weighted) > 1:
        raise InputError(f"{weighted[0]} and {weighted[1]} both have strips under weights; state "
                         "all strips of a fabric in one tension.yaml")
    if all(part.marked is not False for part in parts):
        return
    if any(part.needs_warp for part in parts):
        raise InputError(f"strips along the yarns {NEED_WARP}")
    if any(part.known.along_yarns for part in parts if part.known):
        raise InputError(f"known values along the yarns {NEED_WARP}")


def require_one_density(stated: Sequence[tuple[str, Density]]) -> None:
    """InputError for named densities, kg/m², too different to be of one fabric."""
    ordered = sorted(stated, key=lambda one: one[1])
    if ordered and ordered[-1][1] > (1 + MAX_DENSITY_DIFFERENCE) * ordered[0][1]:
        (light, low), (heavy, high) = ordered[0], ordered[-1]
        raise InputError(f"captures and strips of one fabric state densities from {1e3 * low:g} "
                         f"({light}) to {1e3 * high:g} g/m² ({heavy}), more than "
                         f"{MAX_DENSITY_DIFFERENCE:.0%} apart; correct density_g_m2, or give "
                         "different fabrics apart")


def _alone(
    part: Part, twins: Sequence[Finding], folder: Path | None, fabric: str, strict: bool
) -> FabricResult:
    """The estimate of a fabric with one source, which is that of the source."""
    require_sound(twins, strict, "the fabric")
    document = part.named(fabric).document.warned(*twins)
    if folder and (part.source.part != "." or document != part.document):
        write_estimate(folder, part.estimate, document)
        replace_json(folder / FABRIC, {"parts": [part.source.part]})
    elif folder:
        remove_file(folder / FABRIC)  # of an earlier estimate from several
    return FabricResult(replace(part.estimate, warnings=tuple(document.warnings),
                                captures=_seen([part])), document, [part])


def _known(
    parts: Sequence[Part | Refusal | None], kept: Sequence[Part], header: Header
) -> tuple[list[Part], list[Finding]]:
    """Parts of what refused sources state of the fabric, and a finding for each that cannot be
    joined with those that are ``kept``."""
    found, lost = [], []
    for refusal in parts:
        if not (isinstance(refusal, Refusal) and refusal.known):
            continue
        values = values_alone(refusal.source.path, refusal.known)
        try:
            require_one_fabric([*kept, values])
        except InputError as error:
            lost.append(Finding("known_lost", {"capture": refusal.source.label,
                                               "reason": error.message}))
        else:
            found.append(make_part(values, refusal.source, header, EstimateOptions()))
    return found, lost


def join(
    parts: Sequence[Part], header: Header, *, strict: bool = False, ahead: bool = False
) -> tuple[Estimate, EstimateDocument]:
    """The estimate of a fabric from its parts, and its document with the moduli of each, and if it
    looks ``ahead`` with what may be measured next; InputError if ``strict`` and parts contradict
    each other."""
    documents = [part.document for part in parts]
    captures = [evidence for part in parts if (evidence := part.evidence)]
    records = [record for document in documents for record in document.records]
    density = documents[0].density
    names = ("", one_capture(documents[0].capture.reported), "the captures")
    stated = [each.stated for each in captures]
    draws, contradictions = infer_jointly(captures, header, stated_of(stated, density, records))
    estimate = combine(draws, evidence_of(records, stated, density), density, header,
                       name=names[min(len(captures), 2)], contradictions=contradictions)
    require_sound(estimate.contradictions, strict, "the fabric")
    document = describe_jointly(estimate, documents, header)
    if ahead:
        document = document.followed_by(next_measurements(estimate, _seen(parts), header))
    return estimate, document


def _write_joint(
    folder: Path, estimate: Estimate, document: EstimateDocument, kept: Sequence[Part],
    options: EstimateOptions, *, reported: bool,
) -> None:
    """Write a joint estimate, and its report with the captures' pictures, if it has one."""
    remove_file(folder / PART)  # of an estimate from one source
    remove_report(folder)
    write_estimate(folder, estimate, document)
    replace_json(folder / FABRIC, {"parts": [part.source.part for part in kept]})
    if reported and options.drapes:
        from drapenet.report.report import report_fabric

        places = [(part, place) for part in kept if (place := _place(part.source, folder))]
        report_fabric(folder, document, [(part.document, place) for part, place in places
                                         if part.observation],
                      [place for part, place in places if not part.observation], options.address)


def _seen(parts: Iterable[Part]) -> tuple[Observation, ...]:
    """What the network reads of the captures among the parts."""
    return tuple(one for part in parts if part.evidence for one in part.evidence.observations)


def captures_in(folder: Path) -> tuple[Observation, ...] | None:
    """What the network reads of the captures of the estimate that is written to a folder; None if
    they are elsewhere."""
    try:
        places = read_json(folder / FABRIC)["parts"] if (folder / FABRIC).exists() else ["."]
        parts = [stored_part(Source(place=folder / place, part=place), folder / place, "")
                 for place in places]
    except (InputError, KeyError, TypeError):
        return None
    every = [part for part in parts if isinstance(part, Part)]
    return _seen(every) if len(every) == len(parts) else None
