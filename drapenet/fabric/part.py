"""A part of a fabric: what one source says of it, and the files in which that is kept.

The files of a part in its folder are those of an estimate. ``part.json``, removed first and written
last, states what they were made from: a part that is made from the same, and has all its files, is
read, not made again. A refusal is kept, too, with what its source states of the fabric.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from common.documents import read_json
from common.errors import InputError
from common.files import remove_file, replace_file, replace_json
from common.findings import Finding
from common.normal import Normal
from common.provenance import digest
from common.types import Density
from data.readings.known import Known
from drapenet.config import EstimateOptions
from drapenet.evidence.state import fabric_prior
from drapenet.fabric.combine import combine, evidence_of
from drapenet.fabric.describe import describe_record
from drapenet.fabric.infer import CaptureEvidence, prior_draws
from drapenet.fabric.next_measurements import next_measurements
from drapenet.fabric.sources import Source
from drapenet.fabric.stages import (
    CaptureEstimate,
    estimate_capture,
    require_sound,
)
from drapenet.measured.base import Measured
from drapenet.measured.read import known_values
from drapenet.network.checkpoint import Header, read_header
from drapenet.result.document import EstimateDocument
from drapenet.result.estimate import Estimate
from drapenet.result.files import (
    ESTIMATE,
    OBSERVATION,
    SAMPLES,
    SHOWN,
    STRIPS,
    read_estimate,
    read_observation,
    remove_report,
    write_estimate,
)
from drapenet.views.observation import Observation

PART = "part.json"
VERSION = 6
"""Of the files of a part: raise it when the same source and settings give others."""
Stage = Callable[[str, CaptureEstimate], None]


@dataclass(frozen=True)
class Part:
    """What a source says of a fabric.

    Attributes:
        estimate: from it alone.
        observation: what the network reads of it; None: it is no picture of a drape.
    """

    source: Source
    estimate: Estimate
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

    @property
    def density(self) -> Density:
        """Of its specimen."""
        return self.document.density

    @property
    def digests(self) -> tuple[str, ...]:
        """Of what was captured."""
        return self.document.capture.digests if self.observation else ()

    @property
    def marked(self) -> bool | None:
        """Whether the warp is marked; None: it has no direction in a picture."""
        return self.observation.known if self.observation else None

    @property
    def needs_warp(self) -> bool:
        """Whether captures of the same fabric must know the direction of the warp."""
        return any(record.needs_warp for record in self.document.records)

    @property
    def label(self) -> str:
        """Names it in sentences."""
        return self.document.label

    @property
    def alone(self) -> bool:
        """Whether a fabric may have no other source of its kind."""
        return self.document.tension is not None

    @property
    def known(self) -> Known | None:
        """What is stated of the fabric."""
        return next(iter(self.document.stated), None)

    def named(self, fabric: str) -> "Part":
        """The part with the name by which a door calls its fabric now."""
        about = self.document.capture
        about = about.model_copy(update={"labels": about.labels.named(fabric)})
        return replace(self, document=self.document.model_copy(update={"capture": about}))


@dataclass(frozen=True)
class Refusal:
    """A source that is refused, and why.

    Attributes:
        known: what is stated of the fabric, as a description of values alone; empty if nothing is.
    """

    source: Source
    error: InputError
    known: dict[str, Any]

    @classmethod
    def of(cls, source: Source, error: InputError) -> "Refusal":
        """The refusal of a source, with what it states of the fabric."""
        return cls(source, error, known_values(source.place)
                   if isinstance(source.place, Path) else {})

    @property
    def finding(self) -> Finding:
        """The warning of an estimate without it."""
        reason = str(self.error).removeprefix(f"{self.source.path}: ")
        return Finding("capture_refused", {"capture": self.source.label, "reason": reason})


def part_key(source: Source, header: Header, options: EstimateOptions) -> str:
    """Digest of what the files of a part are made from; '': the source is gone, or of arrays."""
    if not (isinstance(source.place, Path) and source.place.exists()):
        return ""
    about = {"drapes": options.drapes, "edge": options.edge, "refine": options.refine,
             "strict": options.strict}
    return digest([VERSION, source.place, source.label, source.stated, about, header.sha256])


def stored_part(source: Source, folder: Path, key: str) -> Part | Refusal | None:
    """The part whose files are in a folder, with this ``key`` if it is not ''; None if they are
    missing, damaged or made from something else, or the source is of arrays or values, of which no
    key says whether they have changed."""
    if not isinstance(source.place, Path):
        return None
    try:
        state = read_json(folder / PART, remedy="estimate the capture again")
        if key not in ("", state["key"]):
            return None
        if refusal := state.get("refusal"):
            return Refusal(source, InputError(refusal["message"], source=refusal["source"],
                                              joint=refusal["joint"]), state["known"])
        if not all((folder / name).is_file() for name in state["files"]):
            return None
        estimate, document = read_estimate(folder)
        seen = read_observation(folder) if OBSERVATION in state["files"] else None
        return Part(source, estimate, document, seen)
    except (ValueError, KeyError, TypeError):
        return None


def keep_refusal(refusal: Refusal, folder: Path, key: str) -> None:
    """Keep a refusal in the folder of its source."""
    clear(folder)
    error = refusal.error
    replace_json(folder / PART, {"key": key, "known": refusal.known, "refusal": {
        "message": error.message, "source": error.source, "joint": error.joint}})


def kept_values(folder: Path) -> dict[str, Any] | None:
    """What the refused source in a folder states of its fabric; None: no refusal is kept."""
    try:
        state = read_json(folder / PART, remedy="send the capture again")
    except InputError:
        return None
    return state["known"] if state.get("refusal") else None


def clear(folder: Path) -> None:
    """Remove the files of an earlier part."""
    for name in (PART, ESTIMATE, SAMPLES, OBSERVATION):
        remove_file(folder / name)
    remove_report(folder)


def make_part(
    measured: Measured, source: Source, header: Header, options: EstimateOptions, *,
    folder: Path | None = None, key: str = "", on_stage: Stage = lambda name, result: None,
) -> Part:
    """The estimate of a source by itself, as it was read, with its files in ``folder``, if any.

    Args:
        key: see :func:`part_key`.
        on_stage: see :func:`drapenet.fabric.stages.estimate_capture`.

    InputError if it shows no drape, or, if ``options`` are strict, for a fault.
    """
    if folder:
        clear(folder)
        _draw(measured, folder, options)
    observed = measured.observed()
    if observed:
        result = estimate_capture(measured, header, options, out=folder, on_stage=on_stage)
        part = Part(source, result.estimate, result.document, observed.seen)
    else:
        part = _of_record(measured, source, header, options, folder)
    if folder:
        made = (ESTIMATE, SAMPLES, OBSERVATION, *SHOWN)
        replace_json(folder / PART, {
            "key": key, "files": [name for name in made if (folder / name).is_file()]})
    return part


def _draw(measured: Measured, folder: Path, options: EstimateOptions) -> None:
    """Write the pictures of what was read that the ``options`` name."""
    for name, draw in ((options.picture, measured.shown), (options.thumbnail, measured.thumbnail)):
        if name:
            remove_file(folder / name)
        if name and (picture := draw()):
            replace_file(folder / name, picture)


def _of_record(
    measured: Measured, source: Source, header: Header, options: EstimateOptions,
    folder: Path | None,
) -> Part:
    """The estimate from strips or values: that of usual fabrics where they say nothing."""
    record = measured.record(partial(fabric_prior, header))
    assert record, "of what the network does not read"
    estimate = combine(prior_draws(header), evidence_of([record], [], measured.density),
                       measured.density, header, name="")
    found = (*measured.warnings, *measured.findings(None, header.setups))
    document = describe_record(estimate, measured, record, found, header)
    require_sound([*estimate.contradictions, *found], options.strict, source.label)
    if folder:
        if options.drapes:
            document = document.followed_by(next_measurements(estimate, [], header))
        write_estimate(folder, estimate, document)
        if options.drapes:
            from drapenet.report.report import report_fabric

            if picture := measured.shown():
                replace_file(folder / STRIPS, picture)
            report_fabric(folder, document, [], [folder], options.address)
    return Part(source, estimate, document)


def make_in_folder(
    source: Source, folder: Path, key: str, options: EstimateOptions, weights: Path
) -> str:
    """Make a source's part, or its refusal, in a folder, in a process of its own; the sentence of
    the refusal, or ''."""
    clear(folder)  # also of a part that a fault of the program would leave
    try:
        make_part(source.read(), source, read_header(weights), options, folder=folder, key=key)
    except InputError as error:
        keep_refusal(Refusal.of(source, error), folder, key)
        return str(error)
    return ""
