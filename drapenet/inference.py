"""The estimate of a fabric from whatever is known of it: the one way for the command, batches, the
service and Python.

Each source, a capture or a folder of strips, is a :class:`Part` with files of its own;
:func:`joint_estimate` makes the fabric's estimate from the parts.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Union

import numpy as np

from common.errors import InputError
from common.normal import Linear, Normal
from data.captures.capture import Capture, require_one_fabric
from data.captures.description import Description, Labels
from data.strips.description import StripsDescription
from drapenet.config import EstimateOptions
from drapenet.evidence.fabric import (
    CaptureEvidence,
    StripsMeasured,
    fabric_estimate,
    require_directions,
)
from drapenet.evidence.state import fabric_prior, prior_along
from drapenet.network.checkpoint import Header
from drapenet.result.document import CaptureRecord, EstimateDocument, StripsRecord
from drapenet.result.estimate import Estimate
from drapenet.result.files import (
    ESTIMATE,
    REPORT,
    capture_names,
    fabric_name,
    read_document,
    read_observation,
    remove_report,
    require_output,
    write_estimate,
)
from drapenet.stages import CaptureEstimate, Progress, estimate_capture, require_sound
from drapenet.views.observation import Observation
from sim.material import MICRO

if TYPE_CHECKING:
    from data.strips.folder import StripSet
    from drapenet.surface.shape import CapturedShape

Source = Union[Capture, "StripSet", tuple[Capture, "CapturedShape"]]
"""A capture, strips, or a capture made of the scan beside it."""
Stage = Callable[[str, CaptureEstimate], None]


@dataclass(frozen=True)
class Part:
    """What one source says of a fabric: the document of its estimate alone, and what the network
    reads of a capture."""

    document: EstimateDocument
    observation: Observation | None = None

    @property
    def label(self) -> str:
        """Names it in sentences."""
        source = self.document.capture.source
        return source or next(each.source for each in self.document.strips or [])


def read_part(folder: Path) -> Part:
    """The part whose files :func:`estimate_source` has written to a folder."""
    document = read_document(folder / ESTIMATE)
    return Part(document, None if document.strips else read_observation(folder))


def estimate_fabric(
    sources: Sequence[Source], header: Header, options: EstimateOptions, *,
    out: Path | None = None,
    on_estimate: Callable[[EstimateDocument, Path | None], None] = lambda document, folder: None,
) -> Estimate:
    """Estimate a fabric from all its ``sources``, and each of several by itself.

    Args:
        out: folder of the files, if any; several sources have folders in it.
        on_estimate: called with each document and its folder.
    """
    if not sources:
        raise InputError("nothing is known of the fabric; give captures or strips")
    plain = [source[0] if isinstance(source, tuple) else source for source in sources]
    captures = [source for source in plain if isinstance(source, Capture)]
    require_one_fabric([source.density for source in plain],
                       [(str(capture.path), capture.digest) for capture in captures])
    require_directions(all(capture.warp_direction is not None for capture in captures),
                       any(len(source) for source in plain if not isinstance(source, Capture)),
                       [source.known for source in plain if source.known])
    if len(sources) == 1:
        estimate, part = estimate_source(sources[0], header, options, out=out)
        on_estimate(part.document, out)
        return replace(estimate, warnings=tuple(part.document.warnings))
    folders = [out / _folder(plain, k) if out else None for k in range(len(plain))]
    for folder in filter(None, folders):
        require_output(folder)
    parts = []
    for source, folder in zip(sources, folders, strict=True):
        _, part = estimate_source(source, header, options, out=folder)
        parts.append(part)
        on_estimate(part.document, folder)
    estimate, document = joint_estimate(parts, header, strict=options.strict)
    if out:
        write_joint(out, estimate, document, parts, folders, drawn=bool(options.drapes))
    on_estimate(document, out)
    return replace(estimate, warnings=tuple(document.warnings))


def _folder(sources: Sequence["Capture | StripSet"], k: int) -> str:
    """Name of the folder of a source: capture_0, capture_1, strips_2."""
    return f"{'capture' if isinstance(sources[k], Capture) else 'strips'}_{k}"


def with_known(
    sources: Sequence["Capture | StripSet"], known: Mapping[str, Any] | None
) -> list[Source]:
    """The ``sources`` of a fabric, of which the first also states what is ``known`` of it, as its
    file would: only one, for a drape coefficient is evidence of each capture that states it."""
    if known is None:
        return list(sources)
    if stated := next((source for source in sources if source.known), None):
        place = stated.path if isinstance(stated, Capture) else stated.folder
        raise InputError(f"known is in {place} and an argument; give the values in one of them")
    first, *others = sources
    model = Description if isinstance(first, Capture) else StripsDescription
    described = model.of({"density_g_m2": round(1e3 * first.density, 6), "known": known}, "")
    checked: Any = described.known  # of the kind that the source states
    return [replace(first, known=checked), *others]


def estimate_source(
    source: Source, header: Header, options: EstimateOptions, *, out: Path | None = None,
    progress: Progress | None = None, on_stage: Stage = lambda name, result: None,
) -> tuple[Estimate, Part]:
    """The estimate of one source by itself, with its files in ``out``, if any.

    Args:
        progress, on_stage: see :func:`drapenet.stages.estimate_capture`.
    """
    capture, scan = source if isinstance(source, tuple) else (source, None)
    if isinstance(capture, Capture):
        result = estimate_capture(capture, header, options, out=out, scan=scan, progress=progress,
                                  on_stage=on_stage)
        return result.estimate, Part(result.document, result.observation)
    estimate, document = _strips_alone(capture, header)
    require_sound([*estimate.contradictions, *capture.warnings], options.strict,
                  str(capture.folder))
    if out:
        remove_report(out)
        write_estimate(out, estimate, document)
        if options.drapes:
            _report(document, [], out)
    return estimate, Part(document)


def _strips_alone(strips: "StripSet", header: Header) -> tuple[Estimate, EstimateDocument]:
    """The estimate from strips, or from known values alone, and the fabric prior."""
    found = strips.evidence(prior_along(fabric_prior(header), strips.density))
    record = StripsRecord.of_evidence(strips, found)
    estimate = fabric_estimate([], [_measured(record)], strips.density, header)
    return estimate, EstimateDocument.from_estimate(
        estimate, checkpoint=header.identity, strips=[record],
        capture={"sources": [], "rig": "", "labels": strips.labels,
                 "density_g_m2": round(strips.density * 1e3, 6)},
        warnings=[*estimate.warnings, *strips.warnings, *estimate.contradictions])


def _measured(record: StripsRecord) -> StripsMeasured:
    return StripsMeasured(1e-3 * record.density_g_m2, {
        direction: (Linear(np.array(moduli.evidence.rows), np.array(moduli.evidence.values)),
                    MICRO * moduli.alpha_uN_m.median)
        for direction, moduli in record.moduli.items()}, record.known)


def joint_estimate(
    parts: Sequence[Part], header: Header, *, strict: bool = False
) -> tuple[Estimate, EstimateDocument]:
    """The estimate of a fabric from its parts, and its document with the moduli of each.

    InputError for parts that cannot be of one fabric, or, if ``strict``, that contradict others.
    """
    captures = [part for part in parts if part.observation]
    records = [record for part in parts for record in part.document.strips or []]
    documents = [part.document for part in captures]
    require_one_fabric([part.document.density for part in parts],
                       [(part.label, part.document.capture.views_sha256) for part in captures])
    require_directions(all(part.observation.known for part in captures if part.observation),
                       any(record.moduli for record in records),
                       [known for known in (*(document.capture.known for document in documents),
                                            *(record.known for record in records)) if known])
    density = parts[0].document.density
    estimate = fabric_estimate(
        [CaptureEvidence(part.label, part.observation, part.document.capture.known,
                         _refined(part.document)) for part in captures if part.observation],
        list(map(_measured, records)), density, header)
    require_sound(list(estimate.contradictions), strict, "the fabric")
    warnings = [*estimate.warnings, *estimate.contradictions, *(
        f"{part.label} has {len(part.document.warnings)} "
        f"warning{'s' * (len(part.document.warnings) > 1)} by itself: {part.document.warnings[0]}"
        for part in parts if part.document.warnings)]
    if any(part.document.density != density for part in parts):
        warnings.append("the captures state different densities: moduli are those at "
                        f"{1e3 * density:g} g/m², that of the first; weigh the fabric once, and "
                        "state the same density_g_m2 for all")
    rigs = dict.fromkeys(document.capture.rig for document in documents)
    labels = Labels.joined([part.document.capture.labels for part in parts])
    named = {part.document.capture.labels.fabric for part in parts} - {None}
    if len(named) > 1:
        warnings.append(f"the captures state different fabrics ({labels.fabric}): check that all "
                        "are of one")
    sections = {"captures": [
        CaptureRecord(capture=document.capture, moduli=document.moduli, warnings=document.warnings)
        for document in documents]} if documents else {}
    return estimate, EstimateDocument.from_estimate(
        estimate, capture={"sources": [part.label for part in captures], "rig": ", ".join(rigs),
                           "labels": labels,
                           "density_g_m2": round(density * 1e3, 6)},
        checkpoint=header.identity, warnings=warnings, **sections,
        **({"strips": records} if records else {}))


def _refined(document: EstimateDocument) -> Normal | None:
    """The posterior of a capture that was refined."""
    found = document.refined and document.refined.posterior
    return Normal(np.array(found.mean), np.array(found.covariance)) if found else None


def write_joint(
    out: Path, estimate: Estimate, document: EstimateDocument, parts: Sequence[Part],
    folders: Sequence[Path | None], *, drawn: bool,
) -> None:
    """Write a joint estimate, and if it is ``drawn`` its report with the captures' pictures."""
    remove_report(out)
    write_estimate(out, estimate, document)
    if drawn:
        _report(document, [(part.document, folder) for part, folder in
                           zip(parts, folders, strict=True) if part.observation and folder], out)


def _report(
    document: EstimateDocument, captures: Sequence[tuple[EstimateDocument, Path]], out: Path
) -> None:
    """Write the report of an estimate, with the pictures in its captures' folders."""
    from drapenet.report.report import ShownCapture, write_report

    files = [folder / REPORT for _, folder in captures]
    shown = [ShownCapture(name, part, file.read_bytes() if file.exists() else b"")
             for name, (part, _), file in zip(capture_names(document), captures, files,
                                              strict=True)]
    write_report(out, fabric_name(document), document, shown)
