"""One capture: from views to an estimate, its JSON and its report."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from common.ctrl_c import require_interruption
from common.errors import InputError
from data.cameras import Camera
from data.captures import Capture
from drapenet.canonical import DrapeMap, drape_coefficient, drape_map, turn_doubts
from drapenet.checkpoint import Header, load_model
from drapenet.content import interval_table, to_json
from drapenet.estimate import Estimate, make_estimate
from drapenet.maps import located_camera
from drapenet.predict import predict
from drapenet.quality import measure, quality_doubts
from drapenet.registration import camera_doubts
from sim.scene import Rig

_network = lru_cache(maxsize=1)(load_model)  # of many captures, one header


@dataclass(frozen=True)
class Inferred:
    """What the network makes of one capture.

    Attributes:
        estimate: with its own warnings.
        camera: as located from the plate.
        found: the map that the network has seen, with the table's turns.
    """

    estimate: Estimate
    camera: Camera
    found: DrapeMap


def infer_capture(
    capture: Capture, header: Header, *, membrane: float | None = None,
    friction: float | None = None,
) -> Inferred:
    """Estimate a capture.

    Args:
        header: of a checkpoint for the capture's rig.
        membrane: N/m along the yarns, friction: N·m per metre; where they are known.
    """
    rig = Rig.from_name(header.rig)
    camera = located_camera(capture.views, capture.intrinsics, rig)
    found = drape_map(capture.views, camera, rig, turns=capture.turns)
    draws, = predict(_network(header), header, [found], membrane=membrane, friction=friction)
    return Inferred(make_estimate(draws, capture=capture, header=header), camera, found)


@dataclass(frozen=True)
class Result:
    """What is known of one capture.

    Attributes:
        estimate: with its own warnings.
        content: of ``estimate.json``.
        picture: the bytes of ``report.png``; None without one.
    """

    estimate: Estimate
    content: dict[str, Any]
    picture: bytes | None


def estimate_capture(
    capture: Capture, header: Header, *, seen: Any = None, refine: bool = False, drapes: int = 2,
    edge: float = 0.0, known: dict[str, float] | None = None, strict: bool = False,
) -> Result:
    """Estimate, and refine if wanted.

    Args:
        seen: a registered scan, :class:`drapenet.refine.search.CapturedScan`, of which ``capture``
            holds the views; None where these are all there is.
        refine: whether the simulator decides.
        drapes: simulated with the estimate, of which the report shows the best; 0: no report.
        edge: m, of the meshes for both; 0: as each has it.
        known: ``membrane``, N/m, and ``friction``, N·m per metre, where the user knows them.
        strict: whether to refuse what is else doubted.

    Raises:
        InputError: strict, and something is wrong with the capture.
    """
    known, rig = known or {}, Rig.from_name(header.rig)
    inferred = infer_capture(capture, header, **known)
    estimate, camera, found = inferred.estimate, inferred.camera, inferred.found
    doubts = [*camera_doubts(camera, header.setups), *turn_doubts(found.turns, capture.turns),
              *quality_doubts(measure(capture.views, camera, found, rig,
                                      turns=capture.turns))]
    if strict and (wrong := [*capture.warnings, *doubts]):
        more = f" (and {len(wrong) - 1} more)" if len(wrong) > 1 else ""
        raise InputError(f"{capture.path}: refused, for {wrong[0]}{more}; strict=false estimates "
                         "it nevertheless")
    content: dict[str, Any] = {}
    drape, picture = None, None
    if refine:
        from drapenet.refine.refined import refined_capture

        result = refined_capture(estimate, capture, camera, rig=rig, turns=found.turns, seen=seen,
                                 edge=edge, known=known)
        if result is None:
            doubts.append("no drape of the estimate converged; it is not refined")
        else:
            doubts += result.doubts
            before = interval_table(estimate, estimate.density)
            content["refined"], drape = result.content | {"before": before}, result.resimulation
            if result.draws:
                estimate = make_estimate(result.draws, capture=capture, header=header)
    try:
        if drapes and not drape:
            from drapenet.resimulate import EDGE, resimulate

            drape = resimulate(estimate.fabric, capture.views, camera, rig=rig,
                               edge=edge or EDGE, drapes=drapes, turns=found.turns)
            doubts += [] if drape else ["no drape of the estimate converged; the report shows none"]
        if drape:
            content["resimulation"] = drape.as_dict()
            doubts += drape.doubts
        if drapes:
            from drapenet.report import draw_report

            picture = draw_report(
                estimate, capture.views, drape, warnings=[*estimate.warnings, *doubts],
                title=f"{capture.path.resolve().name}: {capture.density * 1e3:g} g/m²")
    except (KeyboardInterrupt, SystemError) as error:
        require_interruption(error)
        # A minute of refinement must not be lost for it.
        doubts.append("interrupted: there is no report")
    share = drape_coefficient(found, rig)
    about = {"source": str(capture.path), "density_g_m2": round(capture.density * 1e3, 6),
             "rig": capture.rig, "views": len(capture.views),
             "turns_deg": (np.degrees(found.turns).round(1) + 0.0).tolist(),  # no -0.0
             "drape_coefficient_percent": round(100 * share, 1) if np.isfinite(share) else None}
    content = to_json(estimate, capture=about, source={"checkpoint": header.identity, **content})
    content["warnings"] += doubts
    return Result(estimate, content, picture)
