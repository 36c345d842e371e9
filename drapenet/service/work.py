"""Tasks of worker processes: the estimate of a capture, strips or values, or of all of a fabric,
and the garment of an estimate."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from common.documents import read_json
from common.errors import InputError
from common.files import replace_file
from common.findings import records
from common.workers import end_with_parent
from drapenet.config import EstimateOptions
from drapenet.fabric.entries import plain_name
from drapenet.service.database import DONE, FAILED, RUNNING, database_in

if TYPE_CHECKING:
    from drapenet.fabric.estimate import FabricResult
    from drapenet.fabric.part import Part
    from drapenet.fabric.sources import Source

PREVIEW, UPLOADED = "preview.png", "uploaded"
CURVATURES = np.linspace(0.0, 400.0, 33)  # 1/m, of the curves of a comparison


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
    from drapenet.report.figures import draw_torques
    from drapenet.result.document import torque_table
    from drapenet.result.files import ESTIMATE, TORQUES

    database = database_in(folder.parent)
    row, record = database.estimate(folder.name), partial(database.change, "estimate", folder.name)
    assert row, "an estimate is not removed while it is under way"
    record(state=RUNNING, tries=row["tries"] + 1)
    try:
        make = _estimate if row["members"] is None else _estimate_jointly
        found = make(folder, row, read_header(checkpoint), address, record)
    except InputError as error:
        record(state=FAILED, error=str(error))
        return
    if not (folder / TORQUES).exists():  # without pictures of a drape
        replace_file(folder / TORQUES, draw_torques(found.estimate))
    record(state=DONE, warnings=records(found.document.warnings),
           estimate=read_json(folder / ESTIMATE), curves=torque_table(found.estimate, CURVATURES))


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


def _source(folder: Path, row: Mapping[str, Any], part: str = ".") -> "Source":
    """The upload of an estimate as a source, called as it is shown: results must not reveal paths
    of the server."""
    from drapenet.fabric.sources import Source

    task = row["task"]
    return Source(place=folder / UPLOADED / task["scan"], part=part, required=False,
                  kind="scan" if task["scan"] else "", stated=task["specimen"] or {},
                  name=str(_shown(row["fabric_name"], row["name"])))


def _shown(fabric: str, capture: str) -> Path:
    """FABRIC/CAPTURE, in place of a path of the server: the label of a capture in sentences."""
    return Path(plain_name(fabric), plain_name(capture))


def _estimate(
    folder: Path, row: dict[str, Any], header: Any, address: str, record: Callable
) -> "Part":
    """The estimate of an upload; InputError, which is kept, if it is refused."""
    from drapenet.fabric.part import Refusal, keep_refusal, make_part, part_key
    from drapenet.result.files import ESTIMATE

    source = _source(folder, row)
    options = EstimateOptions(address=address, picture=PREVIEW)
    key = part_key(source, header, options)

    record(stage="reading")
    try:
        measured = source.read()
        measured = measured.changed(labels=measured.labels.named(row["fabric_name"]))
        record(stage="estimating", warnings=records(measured.warnings))
        return make_part(
            measured, source, header, options, folder=folder, key=key,
            on_stage=lambda stage, found: record(
                stage=stage, warnings=records(found.document.warnings),
                estimate=read_json(folder / ESTIMATE)))
    except InputError as error:
        kept, said = (error.within(folder / UPLOADED, name).within(folder.parent)
                      for name in (source.label, row["name"]))
        keep_refusal(Refusal.of(source, kept), folder, key)
        raise said from None


def _estimate_jointly(
    folder: Path, row: dict[str, Any], header: Any, address: str, record: Callable
) -> "FabricResult":
    """The joint estimate of a fabric's captures and strips."""
    from drapenet.fabric.estimate import estimate_fabric

    record(stage="joining")
    members = filter(None, map(database_in(folder.parent).estimate, row["members"]))
    sources = [_source(folder.parent / each["id"], each, f"../{each['id']}") for each in members]
    try:
        return estimate_fabric(sources, header, EstimateOptions(address=address), folder=folder,
                               fabric=row["fabric_name"])
    except InputError as error:
        raise error.within(folder.parent) from None
