"""Tasks of worker processes: the estimate of a capture, strips or values, or of all of a fabric,
and the garment of an estimate."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from common.configs import read_option
from common.documents import read_json
from common.errors import InputError
from common.files import replace_file
from common.findings import Finding, records
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
    from drapenet.network.checkpoint import read_header
    from drapenet.network.predict import network_of
    from drapenet.report.figures import draw_report  # noqa: F401
    from sim.draping import drape
    from sim.material import MICRO, Fabric

    network_of(read_header(checkpoint))
    drape(Fabric(alpha=[50 * MICRO] * 3, beta=[0.0] * 3), edge=3 * EstimateOptions().edge)


def work(folder: Path, checkpoint: str, address: str) -> None:
    """Make the estimate of ``folder``, of its upload or of all its members; the database records
    the result or an input error. ``address``: of its page.
    """
    from drapenet.network.checkpoint import read_header
    from drapenet.result.document import torque_table
    from drapenet.result.files import ESTIMATE

    database, uploaded = database_in(folder.parent), folder / UPLOADED
    row, record = database.estimate(folder.name), partial(database.change, "estimate", folder.name)
    assert row, "an estimate is not removed while it is under way"
    record(state=RUNNING, tries=row["tries"] + 1)
    try:
        make = _estimate if row["members"] is None else _estimate_jointly
        estimate, warnings = make(folder, row, read_header(checkpoint), address, record)
        record(state=DONE, warnings=records(warnings), estimate=read_json(folder / ESTIMATE),
               curves=torque_table(estimate, CURVATURES))
    except InputError as error:
        record(state=FAILED, error=str(error.within(uploaded, row["name"]).within(folder.parent)))


def preview(folder: Path) -> None:
    """Simulate the garment of the estimate in ``folder``; the database records progress and end.
    """
    from drapenet.report.garment import SAMPLES
    from drapenet.report.garment import preview as simulate
    from drapenet.result.files import read_estimate

    database, made = database_in(folder.parent), count(1)
    record = partial(database.change, "garment", folder.name)

    def run(work: Callable, plans: Sequence[Mapping[str, Any]]) -> Iterator[Any]:
        for plan in plans:
            yield work(**plan)
            record(progress={"made": next(made), "expected": 1 + SAMPLES})

    record(state=RUNNING)
    try:
        garments = simulate(read_estimate(folder)[0], run=run)
    except InputError as error:
        record(state=FAILED, error=str(error.within(folder.parent)))
        return
    if database.garment(folder.name):  # not removed or replaced meanwhile
        garments.write(folder)
        record(state=DONE)


def _estimate(
    folder: Path, row: dict[str, Any], header: Any, address: str, record: Callable
) -> tuple[Any, list[Finding]]:
    """The estimate of an upload, and its warnings."""
    from drapenet.estimator.estimate import estimate_source
    from drapenet.report.figures import draw_torques
    from drapenet.result.files import ESTIMATE, TORQUES

    task = row["task"]
    record(stage="reading")
    source = _read(folder, row)
    record(stage="estimating", warnings=records(source.warnings))
    refine = task["refine"] and dict(read_option("refine", "simulation"))
    latest = 0.0

    def progress(made: int, expected: int) -> None:
        nonlocal latest
        if time.monotonic() - latest > _PROGRESS_INTERVAL:
            record(progress={"made": made, "expected": max(expected, made)})
            latest = time.monotonic()

    estimate, part = estimate_source(
        source, header, EstimateOptions(refine=refine or None, address=address), out=folder,
        on_stage=lambda stage, found: record(
            stage=stage, warnings=records(found.document.warnings),
            estimate=read_json(folder / ESTIMATE)),
        progress=progress)
    if not (folder / TORQUES).exists():  # without pictures of a drape
        replace_file(folder / TORQUES, draw_torques(estimate))
    return estimate, part.document.warnings


def _read(folder: Path, row: dict[str, Any]) -> Any:
    """The capture, scan or strips of an upload, named as they are shown: results must not reveal
    paths of the server."""
    from data.captures.capture import Capture, ReportedCapture
    from data.captures.description import Description
    from data.captures.preview import show
    from drapenet.estimator.read import read_source
    from drapenet.report.strips import draw_strips
    from drapenet.surface.registration import read_scan_capture

    task, uploaded = row["task"], folder / UPLOADED
    shown = _place(row["fabric_name"], row["name"])
    if scan := task["scan"]:
        stated = Description.of(task["specimen"], "")
        source = replace(read_scan_capture(uploaded / scan, stated), known=stated.known,
                         labels=stated.labels)
    else:
        source = read_source(uploaded)
    if isinstance(source, Capture):
        replace_file(folder / PREVIEW, show(source))
        if not isinstance(source, ReportedCapture):
            others = database_in(folder.parent).same_pictures(source.digests, row["fabric"])
            source = replace(source, warnings=(*source.warnings, *(
                Finding("twin_elsewhere", {"capture": str(shown), "other": str(_place(*other))})
                for other in others[:1])))
    elif picture := draw_strips(source):
        replace_file(folder / PREVIEW, picture)
    return replace(source, path=shown, labels=_named(source.labels, row["fabric_name"]))


def _place(fabric: str, capture: str) -> Path:
    """FABRIC/CAPTURE, in place of a path of the server: the label of a capture in sentences."""
    return Path(plain_name(fabric), plain_name(capture))


def _named(labels: Any, fabric: str) -> Any:
    """Labels with the name that the fabric has here, under which its report is filed."""
    from data.captures.description import Labels

    return Labels(**labels.stated() | ({"fabric": fabric} if fabric else {}))


def _as_named(part: Any, fabric: str) -> Any:
    """A part with the present name of its fabric, which may have changed since its estimate."""
    about = part.document.capture
    about = about.model_copy(update={"labels": _named(about.labels, fabric)})
    return replace(part, document=part.document.model_copy(update={"capture": about}))


def _estimate_jointly(
    folder: Path, row: dict[str, Any], header: Any, address: str, record: Callable
) -> tuple[Any, list[Finding]]:
    """The joint estimate of a fabric's captures and strips, and its warnings."""
    from drapenet.estimator.estimate import join, read_part, write_joint
    from drapenet.report.figures import draw_torques
    from drapenet.result.copies import left_out
    from drapenet.result.files import TORQUES

    record(stage="joining")
    places = [folder.parent / member for member in row["members"]]
    every = [_as_named(read_part(place), row["fabric_name"]) for place in places]
    repeated = left_out([part.document for part in every])
    kept = [k for k in range(len(every)) if k not in repeated]
    parts, places = [every[k] for k in kept], [places[k] for k in kept]
    estimate, document = join(parts, header, ahead=True)
    document = document.warned(*repeated.values())
    write_joint(folder, estimate, document, parts, places, drawn=True, address=address)
    replace_file(folder / TORQUES, draw_torques(estimate))
    return estimate, document.warnings

