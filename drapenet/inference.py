"""The way of a capture to its estimate and files: network, checks, refinement, drape, report.

An error in one of the last three leaves the estimate of those before, with a warning.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from common.errors import MAX_LIST_LENGTH, InputError, one_line
from common.files import replace_file
from common.types import Metres
from data.captures.capture import Capture, require_one_fabric
from data.captures.description import Labels
from data.captures.known import Known
from drapenet.config import EstimateOptions
from drapenet.evidence import (
    ROUNDS,
    Normal,
    contradicting_strips,
    prior_estimate,
    require_marked,
    with_refined,
    with_strips,
)
from drapenet.known import weigh
from drapenet.network.checkpoint import Header, load_model
from drapenet.network.predict import predict
from drapenet.result.document import (
    CaptureAbout,
    CaptureRecord,
    EstimateDocument,
    StripsRecord,
)
from drapenet.result.estimate import Estimate, make_estimate
from drapenet.result.files import (
    REPORT,
    SHAPES,
    TORQUES,
    capture_names,
    fabric_name,
    printable,
    remove_report,
    require_output,
    write_estimate,
    write_observation,
)
from drapenet.sets import contradictions
from drapenet.views.checks import view_warnings
from drapenet.views.located import LocatedViews
from drapenet.views.observation import Observation
from drapenet.views.outline import outline_of_curve
from sim.rig import Rig

if TYPE_CHECKING:
    from data.strips.folder import StripSet
    from drapenet.report.drape import Resimulation
    from drapenet.surface.shape import CapturedShape

Progress = Callable[[int, int], None]
"""Called with the simulated and the expected number of drapes."""
network_of = lru_cache(maxsize=2)(load_model)


@dataclass(frozen=True)
class CaptureEstimate:
    """The estimate of one capture after one of its stages.

    Attributes:
        observation: the network's input.
        warnings: beside those of capture, samples and drape.
        refined: outcome of a refinement, for the document.
    """

    capture: Capture
    header: Header
    located: LocatedViews | None  # None: a photograph
    observation: Observation
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
        capture = self.capture
        seen = self.observation
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
        warnings = [*capture.warnings, *self.estimate.warnings, *self.warnings]
        optional = {"refined": self.refined} if self.refined else {}
        if self.drape:
            warnings += self.drape.warnings(share)
            optional["resimulation"] = self.drape.as_dict()
        return EstimateDocument.from_estimate(
            self.estimate, capture=about, checkpoint=self.header.identity, warnings=warnings,
            **optional)


def estimate_fabric(
    sources: Sequence[tuple[Capture, "CapturedShape | None"]], header: Header,
    options: EstimateOptions, *, strips: "StripSet | None" = None, out: Path | None = None,
    on_estimate: Callable[[EstimateDocument, Path | None], None] = lambda document, folder: None,
) -> Estimate:
    """Estimate each capture of a fabric, and several, or strips as well, together.

    Args:
        sources: captures, each with its scan, if it is one.
        out: folder of the files, if any; several captures have folders in it.
        on_estimate: called with each document and its folder.
    """
    captures, documents, observations = [capture for capture, _ in sources], [], []
    require_one_fabric([part.density for part in (*captures, strips) if part],
                       [(str(capture.path), capture.digest) for capture in captures])
    if strips:
        require_marked(all(capture.warp_direction is not None for capture in captures))
    together = strips is not None or len(captures) > 1
    folders = [out / f"capture_{k}" if out and together else out for k in range(len(captures))]
    for folder in filter(None, folders):
        require_output(folder)
    for (capture, scan), folder in zip(sources, folders, strict=True):
        result = estimate_capture(capture, header, options, out=folder, scan=scan)
        estimate, document = result.estimate, result.document
        documents.append(document)
        observations.append(result.observation)
        on_estimate(document, folder)
    if together:
        estimate, document = joint_estimate(observations, documents, header, strips)
        if out:
            remove_report(out)
            write_estimate(out, estimate, document)
            if options.drapes:
                joint_report(document, documents, folders, out=out)
        on_estimate(document, out)
    return replace(estimate, warnings=tuple(document.warnings))


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
        result = _attempt(refine, result, "the network's estimate is not refined",
                          settings=options.refine, scan=scan, progress=progress)
    if options.drapes:
        on_stage("simulating", result)
        result = _attempt(simulate, result, "the report shows no simulated drape",
                          drapes=options.drapes, edge=options.edge)
    if options.drapes and out and not capture.numbers:
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


def network_estimate(capture: Capture, header: Header) -> CaptureEstimate:
    """Estimate a capture by the network of ``header``; InputError for a tester unknown to it."""
    try:
        header.require_learned(capture.rig)
    except InputError as error:
        raise InputError(f"{capture.path}: {error}") from None
    located, seen = None, []
    if capture.outline:
        seen = [Observation.of_outline(capture)]
    elif not capture.numbers:
        located = LocatedViews.of(capture)
        seen = [Observation.of_views(located, capture.sign, capture.warp_direction)]
    seen += _reported(capture.known, capture.rig, capture.sign, capture.warp_direction is not None)
    draws, = predict(network_of(header), header, [seen])
    estimate = make_estimate(draws, density=capture.density, header=header)
    if capture.known:
        estimate = weigh(estimate, capture.known)
    observation = seen[0]
    return CaptureEstimate(capture, header, located, observation, estimate)


def _reported(known: Known | None, rig: Rig, face: int, marked: bool) -> list[Observation]:
    """The drape coefficient that a capture states, as an observation; ``marked``: whether the
    direction of the warp is known."""
    if known is None or known.drape_coefficient_percent is None:
        return []
    return [Observation.of_numbers(rig, face, marked, known)]


def joint_estimate(
    observations: Sequence[Observation], documents: Sequence[EstimateDocument], header: Header,
    strips: "StripSet | None" = None,
) -> tuple[Estimate, EstimateDocument]:
    """The posterior of captures and strips of one fabric, and its document with the moduli of each.

    Without captures the fabric prior takes their place. Where the direction of the warp is not
    stated for all captures, it is taken as unknown for all; strips need it.
    """
    density = documents[0].density if documents else strips.density
    labels = [document.capture.source or "" for document in documents]
    estimate = (_of_captures(observations, documents, labels, header) if documents else
                prior_estimate(density, header.spread))
    sections, lines = {}, []
    if strips:
        measured = strips.posteriors(rounds=ROUNDS if strips.complete else 0)
        sections["strips"] = StripsRecord.of(printable(strips.folder), len(strips), measured,
                                             estimate if documents else None)
        alone, estimate = estimate, with_strips(estimate, measured)
        lines = [*strips.warnings, *(contradicting_strips(alone, measured) * bool(documents))]
    warnings = [*estimate.warnings, *lines, *(
        f"{label} has {len(document.warnings)} warning{'s' * (len(document.warnings) > 1)} by "
        f"itself: {document.warnings[0]}"
        for label, document in zip(labels, documents, strict=True) if document.warnings)]
    if any(document.density != density for document in documents):
        warnings.append("the captures state different densities: moduli are those at "
                        f"{1e3 * density:g} g/m²")
    rigs = dict.fromkeys(document.capture.rig for document in documents)
    stated = [set(document.capture.labels.stated().items()) for document in documents] or [set()]
    if documents:
        sections["captures"] = [
            CaptureRecord(capture=document.capture, moduli=document.moduli,
                          warnings=document.warnings) for document in documents]
    return estimate, EstimateDocument.from_estimate(
        estimate, capture={"sources": labels, "rig": ", ".join(rigs),
                           "labels": Labels(**dict(set.intersection(*stated))),
                           "density_g_m2": round(density * 1e3, 6)},
        checkpoint=header.identity, warnings=warnings, **sections)


def _of_captures(
    observations: Sequence[Observation], documents: Sequence[EstimateDocument],
    labels: Sequence[str], header: Header,
) -> Estimate:
    """The posterior of one capture or several, with warnings of those that contradict others.

    Refined captures are evidence by themselves; the network reads the others.
    """
    known = all(part.known for part in observations)
    stated = [document.capture.known for document in documents]
    seen = [replace(part, known=known) for part in observations]
    also = [part for one, values in zip(seen, stated, strict=True) if np.isnan(one.coefficient)
            for part in _reported(values, one.rig, one.face, known)]
    network, density = network_of(header), documents[0].density
    refined = [known and document.refined and document.refined.posterior
               for document in documents]
    read = [part for part, better in zip(seen, refined, strict=True) if not better] + also
    draws, *alone = predict(network, header, [read or seen, *([part] for part in seen)])
    estimate = (make_estimate(draws, density=density, header=header) if read else
                prior_estimate(density, header.spread))
    if any(refined):
        estimate = with_refined(estimate, [Normal(np.array(part.mean), np.array(part.covariance))
                                           for part in refined if part])
    for values in dict.fromkeys(str(part) for part in stated if part):
        estimate = weigh(estimate, next(part for part in stated if str(part) == values))
    lines = contradictions(
        [part.cloth.theta for part in alone],
        lambda numbers: predict(network, header, [[seen[k] for k in numbers]])[0].cloth.theta,
        labels, names=estimate.names, spread=estimate.spread, density=density)
    return replace(estimate, warnings=(*estimate.warnings, *lines))


def check(result: CaptureEstimate, strict: bool = False) -> CaptureEstimate:
    """Add the warnings of the views; InputError if they show no drape, or if ``strict``."""
    path, located = result.capture.path, result.located
    if located:
        try:
            result = result.with_warnings(
                *view_warnings(located, result.observation.map, result.header.setups))
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

    capture = result.capture
    if capture.warp_direction is None or not result.located:
        missing = "give warp_direction_deg" if result.located else "it shows no depth"
        return result.with_warnings(f"the estimate is not refined: {missing}")
    outcome = refine_capture(result.estimate, result.located, warp=capture.warp_direction,
                             face=capture.sign, scan=scan, settings=settings, progress=progress)
    if outcome is None:
        return result.with_warnings("no drape of the estimate converged; it is not refined")
    result = replace(result.with_warnings(*outcome.warnings),
                     refined=outcome.content | {"before": result.document.moduli})
    if not outcome.draws:
        return result
    estimate = make_estimate(outcome.draws, density=result.capture.density, header=result.header)
    return replace(result, estimate=estimate, drape=outcome.resimulation)


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


def report(result: CaptureEstimate, *, out: Path) -> CaptureEstimate:
    """Write the report's files to ``out``."""
    from drapenet.report.figures import draw_report, draw_torques
    from drapenet.report.report import ShownCapture, write_report
    from drapenet.report.shapes import drape_glb

    capture, document = result.capture, result.document
    name = fabric_name(document)
    picture = draw_report(result.estimate, document, capture, result.drape, title=name)
    replace_file(out / REPORT, picture)
    replace_file(out / TORQUES, draw_torques(result.estimate))
    replace_file(out / SHAPES, drape_glb(capture.rig, result.located, result.drape))
    write_report(out, name, document, [ShownCapture(name, document, picture)])
    return result


def joint_report(
    document: EstimateDocument, documents: Sequence[EstimateDocument], folders: Sequence[Path],
    *, out: Path,
) -> None:
    """Write the report of a joint estimate, with the pictures in its captures' ``folders``."""
    from drapenet.report.report import ShownCapture, write_report

    files = [folder / REPORT for folder in folders]
    captures = [ShownCapture(name, part, file.read_bytes() if file.exists() else b"")
                for name, part, file in zip(capture_names(document), documents, files,
                                            strict=True)]
    write_report(out, fabric_name(document), document, captures)
