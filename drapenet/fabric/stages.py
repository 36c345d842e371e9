"""A capture's estimate in stages: network, checks, refinement, drape, report.

An error in one of the last three leaves the estimate of those before, with a warning.
"""

import os
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from common.errors import MAX_LIST_LENGTH, InputError, of, one_line
from common.files import replace_file
from common.findings import Finding, texts
from common.types import Metres
from data.captures.capture import Capture, OutlineCapture, ReportedCapture
from drapenet.config import EstimateOptions
from drapenet.evidence.source import of_values
from drapenet.evidence.state import fabric_prior
from drapenet.fabric.combine import combine, one_capture
from drapenet.fabric.describe import describe_capture
from drapenet.fabric.infer import evidence_of, infer
from drapenet.fabric.next_measurements import next_measurements
from drapenet.measured.base import Measured, Observed, Record
from drapenet.measured.captures import Captured
from drapenet.network.checkpoint import Header
from drapenet.network.predict import Draws
from drapenet.result.document import EstimateDocument, NextMeasurement
from drapenet.result.estimate import Estimate
from drapenet.result.files import (
    FAULTS,
    REPORT,
    SHAPES,
    TORQUES,
    fabric_name,
    remove_report,
    write_estimate,
    write_observation,
)
from drapenet.views.outline import outline_of_curve

if TYPE_CHECKING:
    from drapenet.report.drape import Resimulation

RAISE = "DRAPENET_RAISE_FAULTS"
"""Environment variable; if it is set, faults of the program end the estimate, as in tests."""


@dataclass(frozen=True)
class CaptureEstimate:
    """The estimate of one capture after one of its stages.

    Attributes:
        draws: samples from the pictures alone, without what is known of the fabric.
        records: of what the source states beside them.
        warnings: beside those of capture, samples and drape.
        refined: outcome of a refinement, for the document.
        following: what may be measured next, likewise.
    """

    observed: Observed
    header: Header
    draws: Draws
    records: tuple[Record, ...] = ()
    warnings: tuple[Finding, ...] = ()
    refined: dict[str, Any] | None = None
    drape: "Resimulation | None" = None
    following: tuple[NextMeasurement, ...] = ()

    @property
    def capture(self) -> Capture:
        """What was captured."""
        return self.observed.capture

    def with_warnings(self, *found: Finding) -> "CaptureEstimate":
        """The same estimate with these warnings as well."""
        return replace(self, warnings=(*self.warnings, *found))

    @cached_property
    def estimate(self) -> Estimate:
        """From the pictures and what is known of the fabric."""
        capture = self.capture
        return combine(self.draws, of_values(capture.known, capture.density), capture.density,
                       self.header, name=one_capture(isinstance(capture, ReportedCapture)))

    @cached_property
    def document(self) -> EstimateDocument:
        """The content of ``estimate.json``."""
        return describe_capture(self.estimate, self.observed, self.header, self.warnings,
                                records=self.records, refined=self.refined, drape=self.drape,
                                following=self.following)


def estimate_capture(
    measured: Measured, header: Header, options: EstimateOptions, *, out: Path | None = None,
    on_stage: Callable[[str, CaptureEstimate], None] = lambda name, result: None,
) -> CaptureEstimate:
    """Estimate a capture, refine the estimate and report it as the ``options`` say.

    Args:
        out: folder of the files, if any; the network's estimate is written before any simulation.
        on_stage: called when the stage "simulating" begins.
    """
    result = observe(measured, header, strict=options.strict)
    if out:
        remove_report(out)
        write_estimate(out, result.estimate, result.document)
        write_observation(out, result.observed.seen)
    if options.refine:
        result = _attempt(refine, result, ("refinement_failed", "refinement_fault"), out,
                          settings=options.refine)
    if options.drapes:
        on_stage("simulating", result)
        result = _attempt(simulate, result, ("drape_failed", "drape_fault"), out,
                          drapes=options.drapes, edge=options.edge)
    if options.drapes and out:
        result = _attempt(report, result, ("report_failed", "report_fault"), out, folder=out,
                          address=options.address)
    if out:
        write_estimate(out, result.estimate, result.document)
    return result


def _attempt(
    stage: Callable[..., CaptureEstimate], result: CaptureEstimate, codes: tuple[str, str],
    out: Path | None, **settings: Any,
) -> CaptureEstimate:
    """Outcome of a stage; if it fails, that of those before with a warning of the first of the
    ``codes``, or of the second, which names a file with the traceback."""
    try:
        return stage(result, **settings)
    except Exception as error:
        values = {"error": f"{type(error).__name__}, {one_line(error)}"}
        if not isinstance(error, InputError):  # a fault of the program
            if RAISE in os.environ:
                raise
            if out:
                replace_file(out / FAULTS, traceback.format_exc().encode())
                return result.with_warnings(Finding(codes[1], values | {"file": FAULTS}))
        return result.with_warnings(Finding(codes[0], values))


def by_network(capture: Capture, header: Header, *, strict: bool = False) -> CaptureEstimate:
    """:func:`observe` a capture."""
    return observe(Captured.of(capture), header, strict=strict)


def observe(measured: Measured, header: Header, *, strict: bool = False) -> CaptureEstimate:
    """Observe a source and infer its estimate by the network of ``header``, with the warnings of
    what is seen and of a drape that is unlike its estimate; InputError if it shows no drape, or, if
    ``strict``, for a warning."""
    observed = measured.observed()
    assert observed, "only of what the network reads"
    capture = observed.capture
    record = measured.record(partial(fabric_prior, header))
    records = (record,) if record else ()
    result = CaptureEstimate(observed, header, infer(observed, header, records), records)
    with of(capture.path):
        faults = measured.findings(observed, header.setups)
    result = result.with_warnings(*faults, *result.draws.unlike(capture.rig.specimen_size,
                                                                capture.causes))
    require_sound([*result.warnings, *capture.warnings, *result.estimate.contradictions], strict,
                  str(capture.path))
    return result


def require_sound(faults: Sequence[Finding], strict: bool, what: str) -> None:
    """InputError if there are faults and the user wants none."""
    if strict and faults:
        raise InputError(f"{what}: refused because strict=true: {'; '.join(texts(faults))}; "
                         "strict=false estimates it with a warning", max_length=MAX_LIST_LENGTH)


def refine(result: CaptureEstimate, *, settings: Mapping[str, Any]) -> CaptureEstimate:
    """Refine the estimate by simulation, which keeps the network's if there is no improvement."""
    from drapenet.refine.refine import refine_capture
    from drapenet.surface.registration import ScannedCapture

    capture, views = result.capture, result.observed.views
    if capture.warp_direction is None or not views:
        return result.with_warnings(Finding("refinement_unmarked" if views else
                                            "refinement_without_depth"))
    scan = capture.shape if isinstance(capture, ScannedCapture) else None
    outcome = refine_capture(result.draws.cloth, views, result.header,
                             density=capture.density, warp=capture.warp_direction,
                             face=capture.sign, scan=scan, settings=settings)
    if outcome is None:
        return result.with_warnings(Finding("refinement_without_drape"))
    result = replace(result.with_warnings(*outcome.warnings),
                     refined=outcome.content | {"before": result.document.moduli})
    if not outcome.draws:
        return result
    return replace(result, draws=outcome.draws, drape=outcome.resimulation)


def simulate(result: CaptureEstimate, *, drapes: int, edge: Metres) -> CaptureEstimate:
    """Simulate drapes of the estimate, unless a refinement has, and keep that of the best fit."""
    from drapenet.report.drape import resimulate, resimulate_outline

    capture = result.capture
    views = result.observed.views
    fabric = result.estimate.fabric
    settings: dict[str, Any] = {
        "edge": edge, "drapes": drapes,
        "laws": result.estimate.nuisances.turned(capture.sign).laws}
    if result.drape is not None:
        return result
    if isinstance(capture, OutlineCapture):
        seen = outline_of_curve(capture.outline.curve, height=capture.outline.height)
        drape = resimulate_outline(fabric, seen, capture.rig, **settings)
    elif views:
        drape = resimulate(fabric, views, **settings)
    else:
        return result
    if drape is None:
        return result.with_warnings(Finding("drape_missing"))
    return replace(result, drape=drape)


def report(result: CaptureEstimate, *, folder: Path, address: str) -> CaptureEstimate:
    """Write the report's files to a folder, with what may be measured next."""
    from drapenet.report.figures import draw_report, draw_torques
    from drapenet.report.report import ShownCapture, write_report
    from drapenet.report.shapes import drape_glb

    following = next_measurements(result.estimate, evidence_of(result.observed).observations,
                                  result.header)
    result = replace(result, following=tuple(following))
    capture, document = result.capture, result.document
    name = fabric_name(document)
    replace_file(folder / TORQUES, draw_torques(result.estimate))
    picture = b""
    if not isinstance(capture, ReportedCapture):
        picture = draw_report(result.estimate, document, capture, result.drape, title=name)
        replace_file(folder / REPORT, picture)
        replace_file(folder / SHAPES, drape_glb(capture.rig, result.observed.views, result.drape))
    write_report(folder, name, document, [ShownCapture(name, document, picture)],
                 address=address)
    return result
