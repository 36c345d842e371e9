"""The stages of a capture's estimate: network, checks, refinement, drape, report.

An error in one of the last three leaves the estimate of those before, with a warning.
"""

import os
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from common.errors import MAX_LIST_LENGTH, InputError, one_line
from common.files import printable, replace_file
from common.types import Metres
from data.captures.capture import Capture
from drapenet.config import EstimateOptions
from drapenet.evidence.fabric import CaptureEvidence, joined, network_of, require_directions
from drapenet.evidence.source import of_values
from drapenet.network.checkpoint import Header
from drapenet.network.predict import Draws, predict
from drapenet.result.advice import advice_of
from drapenet.result.document import CaptureAbout, EstimateDocument
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
from drapenet.views.checks import view_warnings
from drapenet.views.located import LocatedViews
from drapenet.views.observation import Observation
from drapenet.views.outline import outline_of_curve

if TYPE_CHECKING:
    from drapenet.report.drape import Resimulation
    from drapenet.surface.shape import CapturedShape

Progress = Callable[[int, int], None]
"""Called with the simulated and the expected number of drapes."""
RAISE = "DRAPENET_RAISE_FAULTS"
"""Environment variable; if it is set, faults of the program end the estimate, as in tests."""


@dataclass(frozen=True)
class CaptureEstimate:
    """The estimate of one capture after one of its stages.

    Attributes:
        observation: the network's input.
        draws: samples from the pictures alone, without what is known of the fabric.
        warnings: beside those of capture, samples and drape.
        refined: outcome of a refinement, for the document.
    """

    capture: Capture
    header: Header
    located: LocatedViews | None  # None: a photograph
    observation: Observation
    draws: Draws
    warnings: tuple[str, ...] = ()
    refined: dict[str, Any] | None = None
    drape: "Resimulation | None" = None

    def with_warnings(self, *lines: str) -> "CaptureEstimate":
        """The same estimate with these warnings as well."""
        return replace(self, warnings=(*self.warnings, *lines))

    @cached_property
    def estimate(self) -> Estimate:
        """From the pictures and what is known of the fabric."""
        capture = self.capture
        return joined(self.draws, of_values(capture.known, capture.density), capture.density,
                      self.header, name="the capture")

    @cached_property
    def document(self) -> EstimateDocument:
        """The content of ``estimate.json``."""
        capture, seen = self.capture, self.observation
        outline = seen.outline
        share = (outline.corrected(capture.rig).coefficient(capture.rig) if outline else
                 seen.coefficient)
        nodes = outline.folds if outline else None if np.isnan(seen.nodes) else int(seen.nodes)
        about = CaptureAbout(
            source=printable(capture.path), density_g_m2=round(capture.density * 1e3, 6),
            rig=capture.rig.name, face=capture.face, views=len(capture.views),
            views_sha256=capture.digest,
            turns_deg=self.located and (  # no -0.0
                np.degrees(self.located.turns).round(1) + 0.0).tolist(),
            drape_coefficient_percent=round(100 * share, 1) if np.isfinite(share) else None,
            nodes=nodes, known=capture.known, labels=capture.labels)
        warnings = [*capture.warnings, *self.estimate.warnings, *self.estimate.contradictions,
                    *self.warnings]
        optional: dict[str, Any] = {"refined": self.refined} if self.refined else {}
        if advice := advice_of(capture.rig, share):
            optional["advice"] = advice
        if self.drape:
            warnings += self.drape.warnings(share)
            optional["resimulation"] = self.drape.as_dict()
        return EstimateDocument.from_estimate(
            self.estimate, capture=about, checkpoint=self.header.identity, warnings=warnings,
            **optional)


def estimate_capture(
    capture: Capture, header: Header, options: EstimateOptions, *, out: Path | None = None,
    scan: "CapturedShape | None" = None, progress: Progress | None = None,
    on_stage: Callable[[str, CaptureEstimate], None] = lambda name, result: None,
) -> CaptureEstimate:
    """Estimate a capture, refine the estimate and report it as the ``options`` say.

    Args:
        out: folder of the files, if any; the network's estimate is written before any simulation.
        scan: the surface whose rendered views are those of ``capture``.
        on_stage: called when the stages "refining" and "simulating" begin.
    """
    result = check(network_estimate(capture, header), options.strict)
    if out:
        remove_report(out)
        write_estimate(out, result.estimate, result.document)
        write_observation(out, result.observation)
    if options.refine:
        on_stage("refining", result)
        result = _attempt(refine, result, "the network's estimate is not refined", out,
                          settings=options.refine, scan=scan, progress=progress)
    if options.drapes:
        on_stage("simulating", result)
        result = _attempt(simulate, result, "the report shows no simulated drape", out,
                          drapes=options.drapes, edge=options.edge)
    if options.drapes and out and not capture.numbers:
        result = _attempt(report, result, "there is no report", out, folder=out)
    if out:
        write_estimate(out, result.estimate, result.document)
    return result


def _attempt(
    stage: Callable[..., CaptureEstimate], result: CaptureEstimate, loss: str, out: Path | None,
    **settings: Any,
) -> CaptureEstimate:
    """Outcome of a stage; if it fails, that of those before with a warning of the ``loss``, which
    names the file with the traceback."""
    try:
        return stage(result, **settings)
    except Exception as error:
        place = ""
        if not isinstance(error, InputError):  # a fault of the program
            if RAISE in os.environ:
                raise
            if out:
                replace_file(out / FAULTS, traceback.format_exc().encode())
                place = f"; please report it with the file {FAULTS} beside estimate.json"
        return result.with_warnings(f"{loss}: {type(error).__name__}, {one_line(error)}{place}")


def network_estimate(capture: Capture, header: Header) -> CaptureEstimate:
    """Estimate a capture by the network of ``header``; InputError for a tester unknown to it."""
    try:
        header.require_learned(capture.rig)
        require_directions(capture.warp_direction is not None, False,
                           [capture.known] if capture.known else [])
    except InputError as error:
        raise InputError(f"{capture.path}: {error}") from None
    located, marked = None, capture.warp_direction is not None
    if capture.outline:
        seen = Observation.of_outline(capture)
    elif capture.numbers:
        seen = Observation.of_numbers(capture.rig, capture.sign, marked, capture.known)
    else:
        located = LocatedViews.of(capture)
        seen = Observation.of_views(located, capture.sign, capture.warp_direction)
    evidence = CaptureEvidence(str(capture.path), seen, capture.known)
    try:
        draws, = predict(network_of(header), header, [evidence.observations], compared=True)
    except InputError as error:
        raise InputError(f"{capture.path}: {error}") from None
    return CaptureEstimate(capture, header, located, seen, draws)


def check(result: CaptureEstimate, strict: bool = False) -> CaptureEstimate:
    """Add the warnings of the views and of a drape that is unlike its estimate; InputError if the
    views show no drape, or if ``strict``."""
    path, located = result.capture.path, result.located
    if located:
        try:
            result = result.with_warnings(
                *view_warnings(located, result.observation.map, result.header.setups))
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
    unlike = [one.warning(result.capture.rig.specimen_size) for one in result.draws.likeness]
    result = result.with_warnings(*filter(None, unlike))
    require_sound([*result.warnings, *result.capture.warnings, *result.estimate.contradictions],
                  strict, str(path))
    return result


def require_sound(faults: list[str], strict: bool, what: str) -> None:
    """InputError if there are faults and the user wants none."""
    if strict and faults:
        raise InputError(f"{what}: refused because strict=true: {'; '.join(faults)}; strict=false "
                         "estimates it with a warning", max_length=MAX_LIST_LENGTH)


def refine(
    result: CaptureEstimate, *, settings: Mapping[str, Any], scan: "CapturedShape | None",
    progress: Progress | None,
) -> CaptureEstimate:
    """Refine the estimate by simulation, which keeps the network's if there is no improvement."""
    from drapenet.refine.refine import refine_capture

    capture = result.capture
    if capture.warp_direction is None or not result.located:
        missing = "give warp_direction_deg" if result.located else "it shows no depth"
        return result.with_warnings(f"the estimate is not refined: {missing}")
    outcome = refine_capture(result.draws.cloth, result.located, result.header,
                             density=capture.density, warp=capture.warp_direction,
                             face=capture.sign, scan=scan, settings=settings, progress=progress)
    if outcome is None:
        return result.with_warnings("no drape of the estimate converged; it is not refined")
    result = replace(result.with_warnings(*outcome.warnings),
                     refined=outcome.content | {"before": result.document.moduli})
    if not outcome.draws:
        return result
    return replace(result, draws=outcome.draws, drape=outcome.resimulation)


def simulate(result: CaptureEstimate, *, drapes: int, edge: Metres) -> CaptureEstimate:
    """Simulate drapes of the estimate, unless a refinement has, and keep that of the best fit."""
    from drapenet.report.drape import resimulate, resimulate_outline

    if result.drape is not None or result.capture.numbers:
        return result
    fabric, rig, outline = result.estimate.fabric, result.capture.rig, result.capture.outline
    settings = {"edge": edge, "drapes": drapes,
                "laws": result.estimate.nuisances.turned(result.capture.sign).laws}
    drape = (resimulate(fabric, result.located, **settings) if result.located else
             resimulate_outline(fabric, outline_of_curve(outline.curve, height=outline.height),
                                rig, **settings))
    if drape is None:
        return result.with_warnings("no drape of the estimate converged; the report shows none")
    return replace(result, drape=drape)


def report(result: CaptureEstimate, *, folder: Path) -> CaptureEstimate:
    """Write the report's files to a folder."""
    from drapenet.report.figures import draw_report, draw_torques
    from drapenet.report.report import ShownCapture, write_report
    from drapenet.report.shapes import drape_glb

    capture, document = result.capture, result.document
    name = fabric_name(document)
    picture = draw_report(result.estimate, document, capture, result.drape, title=name)
    replace_file(folder / REPORT, picture)
    replace_file(folder / TORQUES, draw_torques(result.estimate))
    replace_file(folder / SHAPES, drape_glb(capture.rig, result.located, result.drape))
    write_report(folder, name, document, [ShownCapture(name, document, picture)])
    return result
