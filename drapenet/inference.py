"""The way of a capture to its estimate and files: network, checks, refinement, drape, report.

An error in one of the last three leaves the estimate of those before, with a warning.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from common.errors import MAX_LIST_LENGTH, InputError, one_line
from common.files import replace_file
from common.types import Metres
from data.captures.capture import Capture
from drapenet.config import EstimateOptions
from drapenet.network.checkpoint import Header, load_model
from drapenet.network.predict import predict
from drapenet.result.document import CaptureAbout, EstimateDocument
from drapenet.result.estimate import Estimate, make_estimate
from drapenet.result.files import (
    PAGE,
    REPORT,
    SHAPES,
    TORQUES,
    last_parts,
    printable,
    remove_report,
    write_estimate,
)
from drapenet.views.checks import view_warnings
from drapenet.views.located import LocatedViews
from drapenet.views.radial_map import RadialMap, drape_coefficient, radial_map
from sim.material import REFERENCE_DENSITY

if TYPE_CHECKING:
    from drapenet.refine.surface import CapturedShape
    from drapenet.report.drape import Resimulation

Progress = Callable[[int, int, float], None]
"""Called with the simulated and the expected number of drapes, and the current misfit."""
network_of = lru_cache(maxsize=2)(load_model)  # one network for each tester


@dataclass(frozen=True)
class CaptureEstimate:
    """The estimate of one capture after one of its stages.

    Attributes:
        map: the network's input.
        known: properties of the cloth at 300 g/m², by :data:`data.fabrics.nuisances.NAMES`.
        warnings: beside those of capture, samples and drape.
        refined: outcome of a refinement, for the document.
    """

    capture: Capture
    header: Header
    located: LocatedViews
    map: RadialMap
    known: dict[str, float]
    estimate: Estimate
    warnings: tuple[str, ...] = ()
    refined: dict[str, Any] | None = None
    drape: "Resimulation | None" = None

    def with_warnings(self, *lines: str) -> "CaptureEstimate":
        """The same estimate with these warnings as well."""
        return replace(self, warnings=(*self.warnings, *lines))

    @cached_property
    def document(self) -> EstimateDocument:
        """The content of ``estimate.json``."""
        capture, share = self.capture, drape_coefficient(self.map, self.capture.rig)
        about = CaptureAbout(
            source=printable(capture.path), density_g_m2=round(capture.density * 1e3, 6),
            rig=capture.rig.name, face=capture.face, views=len(capture.views),
            views_sha256=capture.digest,
            turns_deg=(np.degrees(self.located.turns).round(1) + 0.0).tolist(),  # no -0.0
            drape_coefficient_percent=round(100 * share, 1) if np.isfinite(share) else None)
        warnings = [*capture.warnings, *self.estimate.warnings, *self.warnings]
        optional = {"refined": self.refined} if self.refined else {}
        if self.drape:
            warnings += self.drape.warnings
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
    result = check(network_estimate(capture, header, membrane=options.membrane), options.strict)
    if out:
        remove_report(out)
        write_estimate(out, result.estimate, result.document)
    if options.refine:
        on_stage("refining", result)
        result = _attempt(refine, result, "the network's estimate is not refined",
                          settings=options.refine, scan=scan, progress=progress)
    if options.drapes:
        on_stage("simulating", result)
        result = _attempt(simulate, result, "the report shows no simulated drape",
                          drapes=options.drapes, edge=options.edge)
    if options.drapes and out:
        result = _attempt(report, result, "there is no report", out=out)
    if out:
        write_estimate(out, result.estimate, result.document)
    return result


def _attempt(
    stage: Callable[..., CaptureEstimate], result: CaptureEstimate, loss: str, **settings: Any
) -> CaptureEstimate:
    """Outcome of a stage; if it fails, that of those before with a warning of the ``loss``."""
    try:
        return stage(result, **settings)
    except Exception as error:
        return result.with_warnings(f"{loss}: {type(error).__name__}, {one_line(error)}")


def network_estimate(
    capture: Capture, header: Header, *, membrane: float | None = None
) -> CaptureEstimate:
    """Estimate a capture by the network of ``header``; ``membrane`` as in EstimateOptions."""
    located = LocatedViews.of(capture)
    drape = radial_map(located)
    known = {} if membrane is None else {"membrane": membrane * REFERENCE_DENSITY / capture.density}
    draws, = predict(network_of(header), header, [drape], **known)
    estimate = make_estimate(draws, capture=capture, header=header)
    return CaptureEstimate(capture, header, located, drape, known, estimate)


def check(result: CaptureEstimate, strict: bool = False) -> CaptureEstimate:
    """Add the warnings of the views; InputError if they show no drape, or if ``strict``."""
    path = result.capture.path
    try:
        result = result.with_warnings(
            *view_warnings(result.located, result.map, result.header.setups))
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    if strict and (faults := [*result.warnings, *result.capture.warnings]):
        raise InputError(f"{path}: refused because strict=true: {'; '.join(faults)}; strict=false "
                         "estimates it with a warning", max_length=MAX_LIST_LENGTH)
    return result


def refine(
    result: CaptureEstimate, *, settings: Mapping[str, Any], scan: "CapturedShape | None",
    progress: Progress | None,
) -> CaptureEstimate:
    """Refine the estimate by simulation, which keeps the network's if there is no improvement."""
    from drapenet.refine.refine import refine_capture

    outcome = refine_capture(result.estimate, result.located, scan=scan,
                             known=result.known, settings=settings, progress=progress)
    if outcome is None:
        return result.with_warnings("no drape of the estimate converged; it is not refined")
    result = replace(result.with_warnings(*outcome.warnings),
                     refined=outcome.content | {"before": result.document.moduli})
    if not outcome.draws:
        return result
    estimate = make_estimate(outcome.draws, capture=result.capture, header=result.header)
    return replace(result, estimate=estimate, drape=outcome.resimulation)


def simulate(result: CaptureEstimate, *, drapes: int, edge: Metres) -> CaptureEstimate:
    """Simulate drapes of the estimate, unless a refinement has, and keep that of the best fit."""
    from data.fabrics.nuisances import Nuisances
    from drapenet.report.drape import resimulate

    if result.drape is not None:
        return result
    drape = resimulate(result.estimate.fabric, result.located, edge=edge, drapes=drapes,
                       laws=Nuisances(**result.known).laws)
    if drape is None:
        return result.with_warnings("no drape of the estimate converged; the report shows none")
    return replace(result, drape=drape)


def report(result: CaptureEstimate, *, out: Path) -> CaptureEstimate:
    """Write the report's files to ``out``."""
    from drapenet.report.figures import draw_report, draw_torques
    from drapenet.report.pages import render
    from drapenet.report.shapes import drape_glb

    capture, document = result.capture, result.document
    name = printable("/".join(last_parts(capture.path)))
    picture = draw_report(result.estimate, document, result.located.views, result.drape,
                          title=f"{name}: {document.capture.density_g_m2:g} g/m²")
    replace_file(out / REPORT, picture)
    replace_file(out / TORQUES, draw_torques(result.estimate))
    replace_file(out / SHAPES, drape_glb(result.located, result.drape))
    replace_file(out / PAGE, render("report.html", name=name, document=document, report=picture))
    return result
