"""Inference for one capture: estimate, content of ``estimate.json`` and report files."""

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from common.errors import MAX_LIST_LENGTH, InputError, one_line
from data.captures.capture import Capture
from data.fabrics.nuisances import Nuisances, at_density
from drapenet.network.checkpoint import Header, load_model
from drapenet.network.predict import predict
from drapenet.report.pages import render
from drapenet.result.content import Result, interval_table, to_json
from drapenet.result.estimate import Estimate, make_estimate
from drapenet.result.output import PAGE, REPORT, SHAPES, TORQUES, last_parts
from drapenet.views.checks import view_warnings
from drapenet.views.located import LocatedViews
from drapenet.views.radial_map import RadialMap, drape_coefficient, radial_map
from sim.material import REFERENCE_DENSITY

if TYPE_CHECKING:
    from drapenet.refine.refine import Refined
    from drapenet.report.drape import Resimulation

Progress = Callable[[int, int, float], None]
"""Called with the simulated and the expected number of drapes, and the current misfit."""
network_of = lru_cache(maxsize=2)(load_model)  # one network for each tester


@dataclass(frozen=True)
class Inferred:
    """The network's estimate of one capture.

    Attributes:
        estimate: with its warnings.
        located: the views with the estimated pose and turns.
        drape: the network's input map.
    """

    estimate: Estimate
    located: LocatedViews
    drape: RadialMap


def infer_capture(
    capture: Capture, header: Header, *, membrane: float | None = None
) -> Inferred:
    """Estimate a capture with the network.

    Args:
        header: of a checkpoint for the capture's rig.
        membrane: N/m along the yarns, of the fabric at its own density; None if unknown.
    """
    located = LocatedViews.of(capture)
    drape = radial_map(located)
    known = {} if membrane is None else at_density({"membrane": membrane}, capture.density,
                                                   REFERENCE_DENSITY)
    draws, = predict(network_of(header), header, [drape], **known)
    return Inferred(make_estimate(draws, capture=capture, header=header), located, drape)


def estimate_capture(
    capture: Capture, header: Header, *, seen: Any = None, refine: Mapping[str, Any] | bool = False,
    drapes: int = 2, edge: float | None = None, known: dict[str, float] | None = None,
    strict: bool = False, first: Callable[[dict[str, Any]], None] | None = None,
    progress: Progress | None = None,
) -> Result:
    """Estimate a capture and optionally refine the estimate by simulation.

    Args:
        seen: a registered scan, :class:`drapenet.refine.search.CapturedScan`, whose rendered views
            are those of ``capture``; None for captured views.
        refine: whether to refine with defaults, or the content of a file of ``configs/refine``.
        drapes: number simulated with the estimate; the report shows the best. 0: no report.
        edge: m, mesh edge of these simulations at the plate's rim; None: the default.
        known: ``membrane``, N/m, of the fabric at its own density, if known.
        strict: raise an error instead of giving warnings.
        first: called with the content of ``estimate.json`` by the network alone, before any
            simulation.
        progress: of the refinement, :func:`drapenet.refine.refine.refined_capture`.

    An error during refinement leaves the network's estimate, with a warning.

    Raises:
        InputError: strict, and something is wrong with the capture.
    """
    known = known or {}
    inferred = infer_capture(capture, header, **known)
    estimate, located = inferred.estimate, inferred.located
    try:
        warnings = view_warnings(located, inferred.drape, header.setups)
    except InputError as error:
        raise InputError(f"{capture.path}: {error}") from None
    if strict and (wrong := [*warnings, *capture.warnings]):  # pixels left out are the least of it
        raise InputError(f"{capture.path}: refused because strict=true: {'; '.join(wrong)}; "
                         "strict=false estimates it with a warning", max_length=MAX_LIST_LENGTH)
    source: dict[str, Any] = {"checkpoint": header.identity}
    about = _about(capture, inferred)

    def result(files: dict[str, bytes]) -> Result:
        """The result with the present estimate and warnings."""
        known_so_far = replace(estimate, warnings=(*estimate.warnings, *warnings))
        return Result(known_so_far, to_json(known_so_far, capture=about, source=source), files)

    if first:
        first(result({}).content)
    drape, files = None, {}
    if refine and (refine is True or refine["by"] != "none"):
        refined = _refined(inferred, capture, warnings, seen=seen, known=known, progress=progress,
                           settings=None if refine is True else refine)
        if refined:
            warnings += refined.warnings
            before = interval_table(estimate, estimate.density)
            source["refined"] = refined.content | {"before": before}
            if refined.draws:  # else the network's estimate is kept, and simulated below
                estimate = make_estimate(refined.draws, capture=capture, header=header)
                drape = refined.resimulation
    try:
        if drapes and not drape:
            from drapenet.report.drape import EDGE, resimulate

            stated = Nuisances(**at_density(known, capture.density, REFERENCE_DENSITY))
            drape = resimulate(estimate.fabric, located, edge=EDGE if edge is None else edge,
                               drapes=drapes, laws=stated.laws)
            if not drape:
                warnings.append("no drape of the estimate converged; the report shows none")
        if drape:
            source["resimulation"] = drape.as_dict()
            warnings += drape.warnings
        if drapes:
            files = _shown(result({}), inferred, capture, drape)
    except InputError:  # a word that is out of range
        raise
    except Exception as error:  # the estimate must not be lost for a font or a full memory
        warnings.append(f"there is no report: {type(error).__name__}, {one_line(error)}")
    return result(files)


def _refined(
    inferred: Inferred, capture: Capture, warnings: list[str], **options: Any
) -> "Refined | None":
    """The refinement of an estimate; None, with a line in ``warnings``, where there is none.

    ``options``: of :func:`drapenet.refine.refine.refined_capture`.
    """
    from drapenet.refine.refine import refined_capture

    try:
        refined = refined_capture(inferred.estimate, capture, inferred.located, **options)
    except InputError:  # a word that is out of range
        raise
    except Exception as error:  # the network's estimate must not be lost for it
        warnings.append(f"refinement failed: {type(error).__name__}, {one_line(error)}; the "
                      "network's estimate is given")
        return None
    if refined is None:
        warnings.append("no drape of the estimate converged; it is not refined")
    return refined


def _shown(
    result: Result, inferred: Inferred, capture: Capture, drape: "Resimulation | None"
) -> dict[str, bytes]:
    """Report files of a result, bytes by name."""
    from drapenet.report.figures import draw_report, draw_torques
    from drapenet.report.shapes import drape_glb

    name = os.fsencode("/".join(last_parts(capture.path))).decode(errors="replace")
    report = draw_report(result.estimate, capture.views, drape,
                         title=f"{name}: {capture.density * 1e3:g} g/m²")
    return {REPORT: report, TORQUES: draw_torques(result.estimate),
            SHAPES: drape_glb(inferred.located, drape),
            PAGE: render("report.html", name=name, content=result.content, report=report)}


def _about(capture: Capture, inferred: Inferred) -> dict[str, Any]:
    """Description of the capture for ``estimate.json``."""
    share = drape_coefficient(inferred.drape, capture.rig)
    return {"source": str(capture.path), "density_g_m2": round(capture.density * 1e3, 6),
            "rig": capture.rig.name, "face": capture.face, "views": len(capture.views),
            "views_sha256": capture.digest,
            "turns_deg": (np.degrees(inferred.located.turns).round(1) + 0.0).tolist(),  # no -0.0
            "drape_coefficient_percent": round(100 * share, 1) if np.isfinite(share) else None}
