"""Describe: the document of an estimate, ``estimate.json``."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from common.files import printable
from common.findings import Finding
from data.captures.capture import DepthCapture
from data.captures.description import Labels
from drapenet.measured.base import Measured, Observed, Record
from drapenet.network.checkpoint import Header
from drapenet.result.advice import advice_of, joint_advice
from drapenet.result.document import (
    CaptureAbout,
    CaptureRecord,
    EstimateDocument,
    NextMeasurement,
    sections_of,
)
from drapenet.result.estimate import Estimate

if TYPE_CHECKING:
    from drapenet.report.drape import Resimulation


def describe_capture(
    estimate: Estimate, observed: Observed, header: Header, warnings: Sequence[Finding], *,
    records: Sequence[Record] = (), refined: dict[str, Any] | None, drape: "Resimulation | None",
    following: Sequence[NextMeasurement],
) -> EstimateDocument:
    """The document of one capture's estimate.

    Args:
        warnings: beside those of capture, samples and drape.
        records: of what the source states beside the capture.
        refined: outcome of a refinement.
        following: what may be measured next.
    """
    capture = observed.capture
    seen = observed.seen
    located = observed.views
    outline = seen.outline
    share = (outline.corrected(capture.rig).coefficient(capture.rig) if outline else
             seen.coefficient)
    nodes = outline.folds if outline else None if np.isnan(seen.nodes) else int(seen.nodes)
    about = CaptureAbout(
        source=printable(capture.path), density_g_m2=round(capture.density * 1e3, 6),
        rig=capture.rig.name, face=capture.face,
        views=len(capture.views) if isinstance(capture, DepthCapture) else 0,
        views_sha256=capture.digest, files_sha256=list(capture.files_sha256) or None,
        turns_deg=(np.degrees(located.turns).round(1) + 0.0).tolist() if located else None,  # no -0
        drape_coefficient_percent=round(100 * share, 1) if np.isfinite(share) else None,
        nodes=nodes, known=capture.known, labels=capture.labels)
    found = [*capture.warnings, *estimate.warnings, *estimate.contradictions, *warnings]
    optional: dict[str, Any] = sections_of(records) | ({"refined": refined} if refined else {})
    if advice := advice_of(capture.rig, share):
        optional["advice"] = advice
    if drape:
        found += drape.warnings(share)
        optional["resimulation"] = drape.as_dict()
    if following:
        optional["next_measurements"] = list(following)
    return EstimateDocument.from_estimate(estimate, capture=about, checkpoint=header.identity,
                                          warnings=found, **optional)


def describe_record(
    estimate: Estimate, source: Measured, record: Record, found: Sequence[Finding], header: Header
) -> EstimateDocument:
    """The document of the estimate from a ``source`` without captures alone, with what was
    ``found`` of it."""
    return EstimateDocument.from_estimate(
        estimate, checkpoint=header.identity, **sections_of([record]),
        capture=CaptureAbout(sources=[], rig="", labels=source.labels,
                             density_g_m2=round(1e3 * source.density, 6)),
        warnings=[*estimate.warnings, *found, *estimate.contradictions])


def describe_jointly(
    estimate: Estimate, documents: Sequence[EstimateDocument], header: Header
) -> EstimateDocument:
    """The document of a fabric's estimate from its parts, with the moduli of each."""
    captures = [document for document in documents if document.capture.source]
    records = [record for document in documents for record in document.records]
    density = documents[0].density
    warnings = [*estimate.warnings, *estimate.contradictions, *(
        Finding("part_has_warnings" if document.warnings[1:] else "part_has_warning", {
            "label": document.label, "count": len(document.warnings),
            "first": document.warnings[0].record})
        for document in documents if document.warnings)]
    if any(document.density != density for document in documents):
        warnings.append(Finding("densities_differ", {"taken": 1e3 * density}))
    labels = Labels.joined([document.capture.labels for document in documents])
    if len({document.capture.labels.fabric for document in documents} - {None}) > 1:
        warnings.append(Finding("fabrics_differ", {"fabrics": labels.fabric}))
    sections: dict[str, Any] = {"captures": [
        CaptureRecord(capture=document.capture, moduli=document.moduli, warnings=document.warnings)
        for document in captures]} if captures else {}
    sections |= sections_of(records)
    advice = joint_advice(document.advice for document in captures)
    if advice and not any(record.bends for record in records):
        sections["advice"] = advice
    rigs = dict.fromkeys(document.capture.rig for document in captures)
    return EstimateDocument.from_estimate(
        estimate, capture=CaptureAbout(
            sources=[document.label for document in captures], rig=", ".join(rigs), labels=labels,
            density_g_m2=round(density * 1e3, 6)),
        checkpoint=header.identity, warnings=warnings, **sections)
