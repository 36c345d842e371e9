"""Task of a worker process: the estimate of a capture, or of all captures of a fabric."""

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from common.configs import read_option
from common.documents import read_json
from common.errors import InputError
from common.files import replace_file
from common.workers import end_with_parent
from drapenet.batch.captures import plain_name
from drapenet.config import EstimateOptions
from drapenet.service.database import DONE, FAILED, RUNNING, database_in

PREVIEW, UPLOADED = "preview.png", "uploaded"
CURVATURES = np.linspace(0.0, 400.0, 33)  # 1/m, of the curves of a comparison
_PROGRESS_INTERVAL = 0.25  # s between two reports of progress


def warm_up(checkpoint: str) -> None:
    """Import and cache, in a worker, what the first estimate needs."""
    end_with_parent()
    from data.render.rays import import_open3d
    from drapenet.inference import network_of
    from drapenet.network.checkpoint import read_header
    from drapenet.report.figures import draw_report  # noqa: F401
    from sim.drape import drape
    from sim.material import MICRO, Fabric

    network_of(read_header(checkpoint))
    import_open3d()
    drape(Fabric(alpha=[50 * MICRO] * 3, beta=[0.0] * 3), edge=3 * EstimateOptions().edge)


def work(folder: Path, checkpoint: str) -> None:
    """Make the estimate of ``folder``, of its upload or of all its members; the database records
    the result or an input error.
    """
    from drapenet.network.checkpoint import read_header
    from drapenet.result.document import torque_table
    from drapenet.result.files import ESTIMATE

    database, uploaded = database_in(folder.parent), folder / UPLOADED
    row, record = database.estimate(folder.name), partial(database.change, "estimate", folder.name)
    record(state=RUNNING, tries=row["tries"] + 1)
    try:
        make = _estimate if row["members"] is None else _estimate_jointly
        estimate, warnings = make(folder, row, read_header(checkpoint), record)
        record(state=DONE, warnings=warnings, estimate=read_json(folder / ESTIMATE),
               curves=torque_table(estimate, CURVATURES))
    except InputError as error:
        sentence = str(error).replace(f"{uploaded}/", "").replace(str(uploaded), row["name"])
        record(state=FAILED, error=sentence.replace(f"{folder.parent}/", ""))


def _estimate(
    folder: Path, row: dict[str, Any], header: Any, record: Callable
) -> tuple[Any, list[str]]:
    """The estimate of an upload, and its warnings."""
    from data.captures.capture import read_capture
    from data.captures.description import Specimen
    from drapenet.inference import estimate_capture
    from drapenet.result.files import ESTIMATE
    from drapenet.surface.registration import read_scan_capture

    task, registered = row["task"], None
    record(stage="reading")
    if scan := task["scan"]:
        specimen = Specimen.of(task["specimen"], "")
        capture, registered = read_scan_capture(folder / UPLOADED / scan, specimen)
    else:
        capture = read_capture(folder / UPLOADED)
    replace_file(folder / PREVIEW, preview(capture))
    # Results must not reveal paths of the server.
    capture = replace(capture, path=Path(*map(plain_name, (row["fabric_name"], row["name"]))))
    record(stage="estimating", warnings=list(capture.warnings))
    refine = task["refine"] and dict(read_option("refine", "simulation"))
    latest = 0.0

    def progress(made: int, expected: int) -> None:
        nonlocal latest
        if time.monotonic() - latest > _PROGRESS_INTERVAL:
            record(progress={"made": made, "expected": max(expected, made)})
            latest = time.monotonic()

    result = estimate_capture(
        capture, header, EstimateOptions(refine=refine or None), out=folder, scan=registered,
        on_stage=lambda stage, found: record(stage=stage, warnings=found.document.warnings,
                                             estimate=read_json(folder / ESTIMATE)),
        progress=progress)
    return result.estimate, result.document.warnings


def _estimate_jointly(
    folder: Path, row: dict[str, Any], header: Any, record: Callable
) -> tuple[Any, list[str]]:
    """The joint estimate of a fabric's captures, and its warnings."""
    from data.captures.capture import require_one_fabric
    from drapenet.inference import joint_estimate
    from drapenet.report.figures import draw_torques
    from drapenet.result import files

    record(stage="joining")
    places = [folder.parent / member for member in row["members"]]
    documents = [files.read_document(place / files.ESTIMATE) for place in places]
    require_one_fabric([document.density for document in documents], [
        (document.capture.source, document.capture.views_sha256) for document in documents])
    estimate, document = joint_estimate(
        [files.read_observation(place) for place in places], documents, header)
    files.write_estimate(folder, estimate, document)
    replace_file(folder / files.TORQUES, draw_torques(estimate))
    return estimate, document.warnings


def preview(capture: Any) -> bytes:
    """PNG of frames with the cloth outlined, of the cloth in each view, or of an outline."""
    from data.captures.preview import outline_picture, picture, thumbnail

    if capture.outline:
        return outline_picture(capture)
    if capture.cut:
        return picture(capture.cut, capture.intrinsics, capture.rig, turns=capture.turns)
    return thumbnail(capture, len(capture.views))
