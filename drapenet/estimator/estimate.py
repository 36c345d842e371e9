"""The estimate of a fabric from whatever is known of it: the one way for the command, batches, the
service and Python.

Each source, a capture or a folder of strips, is a :class:`Part` with files of its own;
:func:`join` makes the fabric's estimate from the parts.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from common.errors import InputError
from common.files import by_number, printable, replace_file
from common.findings import Finding
from common.normal import Normal
from data.captures.capture import Capture
from drapenet.config import EstimateOptions
from drapenet.estimator.combine import combine, evidence_of
from drapenet.estimator.describe import describe_jointly, describe_strips, describe_tension
from drapenet.estimator.infer import CaptureEvidence, infer_jointly, prior_draws
from drapenet.estimator.next_measurements import next_measurements
from drapenet.estimator.read import (
    Refused,
    Source,
    known_of,
    require_directions,
    require_one_fabric,
)
from drapenet.estimator.stages import (
    CaptureEstimate,
    Progress,
    estimate_capture,
    require_sound,
)
from drapenet.evidence.state import fabric_prior, prior_along
from drapenet.network.checkpoint import Header
from drapenet.result.document import EstimateDocument
from drapenet.result.estimate import Estimate
from drapenet.result.files import (
    ESTIMATE,
    OBSERVATION,
    REPORT,
    STRIPS,
    capture_names,
    fabric_name,
    pictures_of_strips,
    read_document,
    read_observation,
    remove_report,
    require_output,
    write_estimate,
)
from drapenet.result.strips import StripsRecord
from drapenet.result.tension import TensionRecord
from drapenet.views.observation import Observation

if TYPE_CHECKING:
    from data.strips.folder import StripSet
    from data.tension.folder import TensionSet

Stage = Callable[[str, CaptureEstimate], None]


@dataclass(frozen=True)
class Part:
    """What one source says of a fabric: the document of its estimate alone, and what the network
    reads of a capture."""

    document: EstimateDocument
    observation: Observation | None = None

    @property
    def evidence(self) -> CaptureEvidence | None:
        """Of a capture."""
        if self.observation is None:
            return None
        refined = self.document.refined and self.document.refined.posterior
        return CaptureEvidence(
            self.document.label, self.observation, self.document.capture.known,
            Normal(np.array(refined.mean), np.array(refined.covariance)) if refined else None)


def read_part(folder: Path) -> Part:
    """The part whose files :func:`estimate_source` has written to a folder."""
    document = read_document(folder / ESTIMATE)
    return Part(document, None if document.strips or document.tension else
                read_observation(folder))


def captures_in(folder: Path) -> tuple[Observation, ...] | None:
    """What the network reads of the captures of the estimate that is written to a folder; None if
    they are elsewhere."""
    document = read_document(folder / ESTIMATE)
    places = ([folder] if document.capture.source else
              sorted(folder.glob("capture_*"), key=by_number))
    places = [place for place in places if (place / OBSERVATION).is_file()]
    complete = len(places) == len(document.captures or [document.capture.source] *
                                  bool(document.capture.source))
    return _seen([read_part(place) for place in places]) if complete else None


def _seen(parts: Iterable[Part]) -> tuple[Observation, ...]:
    """What the network reads of the captures among the parts."""
    return tuple(one for part in parts if part.evidence for one in part.evidence.observations)


def estimate_fabric(
    sources: Sequence[Source], header: Header, options: EstimateOptions, *,
    out: Path | None = None, refused: Refused | None = None,
    on_estimate: Callable[[EstimateDocument, Path | None], None] = lambda document, folder: None,
) -> Estimate:
    """Estimate a fabric from all its ``sources``, and each of several by itself.

    Args:
        refused: captures that could not be read; unless ``options`` are strict, the fabric is
            estimated without them, and without those that show no drape, with a warning. None: each
            capture must show one.
        out: folder of the files, if any; several sources have folders in it.
        on_estimate: called with each document and its folder.
    """
    if not sources:
        raise InputError("nothing is known of the fabric; give captures or strips")
    if refused and options.strict:
        raise next(iter(refused.values()))
    captures = [source for source in sources if isinstance(source, Capture)]
    require_one_fabric([source.density for source in sources],
                       [(str(capture.path), capture.digests) for capture in captures])
    require_directions(all(capture.warp_direction is not None for capture in captures),
                       any(source.along_yarns for source in sources
                           if not isinstance(source, Capture)),
                       [source.known for source in sources])
    if len(sources) == 1 and not refused:
        estimate, part = estimate_source(sources[0], header, options, out=out)
        on_estimate(part.document, out)
        return replace(estimate, warnings=tuple(part.document.warnings), captures=_seen([part]))
    folders = [out / f"{'capture' if isinstance(source, Capture) else source.kind}_{k}" if out
               else None for k, source in enumerate(sources)]
    for folder in filter(None, folders):
        require_output(folder)
    parts, places, refused = [], [], None if refused is None else {**refused}
    for source, folder in zip(sources, folders, strict=True):
        try:
            _, part = estimate_source(source, header, options, out=folder)
        except InputError as error:
            if refused is None or options.strict or not isinstance(source, Capture):
                raise
            refused[source.path] = error
            continue
        parts.append(part)
        places.append(folder)
        on_estimate(part.document, folder)
    if refused and not any(part.observation for part in parts):
        raise next(iter(refused.values()))
    known, lost = known_parts(refused or {}, parts, header)
    estimate, document = join([*parts, *known], header, strict=options.strict,
                              ahead=bool(out and options.drapes))
    document = document.warned(*(Finding("capture_refused", {
        "capture": printable(path), "reason": str(error).removeprefix(f"{path}: ")})
        for path, error in (refused or {}).items()), *lost)
    if out:
        write_joint(out, estimate, document, parts, places, drawn=bool(options.drapes))
    on_estimate(document, out)
    return replace(estimate, warnings=tuple(document.warnings), captures=_seen(parts))


def estimate_source(
    source: Source, header: Header, options: EstimateOptions, *, out: Path | None = None,
    progress: Progress | None = None, on_stage: Stage = lambda name, result: None,
) -> tuple[Estimate, Part]:
    """The estimate of one source by itself, with its files in ``out``, if any.

    Args:
        progress, on_stage: see :func:`drapenet.estimator.stages.estimate_capture`.
    """
    if isinstance(source, Capture):
        result = estimate_capture(source, header, options, out=out, progress=progress,
                                  on_stage=on_stage)
        return result.estimate, Part(result.document, result.observed.seen)
    estimate, document, found = (_of_tension(source, header) if source.kind == "tension" else
                                 _of_strips(source, header))
    require_sound([*estimate.contradictions, *found], options.strict, str(source.path))
    if out:
        remove_report(out)
        if options.drapes:
            document = document.followed_by(next_measurements(estimate, [], header))
        write_estimate(out, estimate, document)
        if options.drapes:
            from drapenet.report.strips import draw_strips

            if picture := draw_strips(source):
                replace_file(out / STRIPS, picture)
            _report(document, [], [out], out, options.address)
    return estimate, Part(document)


def _of_strips(
    source: "StripSet", header: Header
) -> tuple[Estimate, EstimateDocument, Sequence[Finding]]:
    """The estimate from hanging strips alone, and their warnings."""
    record = StripsRecord.of_evidence(
        source, source.evidence(prior_along(fabric_prior(header), source.density)))
    estimate = combine(prior_draws(header), evidence_of([record], [], source.density),
                       source.density, header, name="")
    return estimate, describe_strips(estimate, source, record, header), source.warnings


def _of_tension(
    source: "TensionSet", header: Header
) -> tuple[Estimate, EstimateDocument, Sequence[Finding]]:
    """The same from strips under weights; moduli are those of usual fabrics and known values."""
    record = TensionRecord.of_strips(source)
    estimate = combine(prior_draws(header), evidence_of([], [record.known], source.density),
                       source.density, header, name="")
    return estimate, describe_tension(estimate, source, record, header), record.findings


def known_parts(
    refused: Iterable[Path], parts: Sequence[Part], header: Header
) -> tuple[list[Part], list[Finding]]:
    """Parts of what the descriptions of ``refused`` captures, their folders, state of the fabric of
    ``parts``, and a finding for each that cannot be joined with them."""
    found, lost = [], []
    marked = all(part.observation.known for part in parts if part.observation)
    for source in map(known_of, refused):
        if source is None:  # without strips it has no length
            continue
        try:
            require_one_fabric([source.density, *(part.document.density for part in parts)], [])
            require_directions(marked, False, [source.known])
        except InputError as error:
            lost.append(Finding("known_lost", {"capture": printable(source.path),
                                               "reason": error.message}))
        else:
            found.append(estimate_source(source, header, EstimateOptions())[1])
    return found, lost


def join(
    parts: Sequence[Part], header: Header, *, strict: bool = False, ahead: bool = False
) -> tuple[Estimate, EstimateDocument]:
    """The estimate of a fabric from its parts, and its document with the moduli of each, and if it
    looks ``ahead`` with what may be measured next.

    InputError for parts that cannot be of one fabric, or, if ``strict``, that contradict others.
    """
    documents = [part.document for part in parts]
    captures = [evidence for part in parts if (evidence := part.evidence)]
    records = [record for document in documents for record in document.strips or []]
    require_one_fabric([document.density for document in documents],
                       [(document.label, document.capture.digests)
                        for document in documents if document.capture.source])
    tensions = [document.tension for document in documents if document.tension]
    if len(tensions) > 1:
        raise InputError(f"{tensions[0].source} and {tensions[1].source} both have strips under "
                         "weights; state all strips of a fabric in one tension.yaml")
    stated = [*(capture.stated for capture in captures), *(each.known for each in tensions)]
    require_directions(all(capture.seen.known for capture in captures),
                       any(record.moduli for record in records)
                       or any(each.along_yarns for each in tensions),
                       [*stated, *(record.known for record in records)])
    density, names = documents[0].density, ("", "the capture", "the captures")
    draws, contradictions = infer_jointly(captures, header)
    estimate = combine(draws, evidence_of(records, stated, density), density, header,
                       name=names[min(len(captures), 2)], contradictions=contradictions)
    require_sound(estimate.contradictions, strict, "the fabric")
    document = describe_jointly(estimate, documents, header)
    if ahead:
        document = document.followed_by(next_measurements(estimate, _seen(parts), header))
    return estimate, document


def write_joint(
    out: Path, estimate: Estimate, document: EstimateDocument, parts: Sequence[Part],
    folders: Sequence[Path | None], *, drawn: bool, address: str = "",
) -> None:
    """Write a joint estimate, and if it is ``drawn`` its report with the captures' pictures;
    ``address``: of its page, if any."""
    remove_report(out)
    write_estimate(out, estimate, document)
    if drawn:
        pairs = [(part, folder) for part, folder in zip(parts, folders, strict=False) if folder]
        _report(document, [(part.document, folder) for part, folder in pairs if part.observation],
                [folder for part, folder in pairs if not part.observation], out, address)


def _report(
    document: EstimateDocument, captures: Sequence[tuple[EstimateDocument, Path]],
    strips: Sequence[Path], out: Path, address: str,
) -> None:
    """Write the report of an estimate, with the pictures in its captures' and strips' folders."""
    from drapenet.report.report import ShownCapture, write_report

    files = [folder / REPORT for _, folder in captures]
    shown = [ShownCapture(name, part, file.read_bytes() if file.exists() else b"")
             for name, (part, _), file in zip(capture_names(document), captures, files,
                                              strict=True)]
    write_report(out, fabric_name(document), document, shown, strips=pictures_of_strips(strips),
                 address=address)
