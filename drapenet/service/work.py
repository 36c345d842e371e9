"""Task of a worker process: one estimate, with its progress in state.json of its folder."""

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from common.configs import read_option
from common.documents import read_json
from common.errors import InputError
from common.files import replace_file, replace_json
from common.workers import end_with_parent
from drapenet.config import EstimateOptions

if TYPE_CHECKING:
    from data.captures.description import Specimen

STATE, PREVIEW, UPLOADED = "state.json", "preview.png", "uploaded"
QUEUED, RUNNING, DONE, FAILED, LOST = "queued", "running", "done", "failed", "interrupted"
ENDED = (DONE, FAILED, LOST)
_PROGRESS_INTERVAL = 0.25  # s between two reports of progress


def read_state(folder: Path) -> dict[str, Any] | None:
    """The state of an estimate; None where there is none."""
    try:
        state = read_json(folder / STATE)
    except InputError:
        return None
    return state if isinstance(state, dict) and "state" in state else None


def change_state(folder: Path, **values: object) -> None:
    """Change keys of an estimate's state, which after its end has neither stage nor progress."""
    if values.get("state") in ENDED:
        values = {"stage": None, "progress": None, "ended": time.time()} | values
    replace_json(folder / STATE, (read_state(folder) or {}) | values)


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


def estimate_upload(
    folder: Path, *, refine: bool, scan: str, name: str, specimen: "Specimen | None",
    checkpoint: str,
) -> None:
    """Estimate the upload in ``folder``; input errors are recorded in its state."""
    from data.captures.capture import read_capture
    from drapenet.inference import CaptureEstimate, estimate_capture
    from drapenet.network.checkpoint import read_header
    from drapenet.refine.registration import read_scan_capture

    uploaded, registered = folder / UPLOADED, None
    change_state(folder, state=RUNNING, stage="reading")

    def note_stage(stage: str, result: CaptureEstimate) -> None:
        change_state(folder, stage=stage, warnings=result.document.warnings)

    try:
        if scan:
            capture, registered = read_scan_capture(uploaded / scan, specimen)
        else:
            capture = read_capture(uploaded)
        replace_file(folder / PREVIEW, preview(capture))
        # Results must not reveal paths of the server.
        capture = replace(capture, path=Path(name))
        change_state(folder, stage="estimating", warnings=list(capture.warnings))
        settings = dict(read_option("refine", "simulation")) if refine else None
        result = estimate_capture(
            capture, read_header(checkpoint), EstimateOptions(refine=settings), out=folder,
            scan=registered, on_stage=note_stage, progress=_throttled(folder))
        change_state(folder, state=DONE, warnings=result.document.warnings)
    except InputError as error:
        sentence = str(error).replace(f"{uploaded}/", "").replace(str(uploaded), name)
        change_state(folder, state=FAILED, error=sentence)


def preview(capture: Any) -> bytes:
    """PNG of frames with the cloth outlined, of the cloth in each view, or of an outline."""
    from data.captures.preview import outline_picture, picture, thumbnail

    if capture.outline:
        return outline_picture(capture)
    if capture.cut:
        return picture(capture.cut, capture.intrinsics, capture.rig, turns=capture.turns)
    return thumbnail(capture, len(capture.views))


def _throttled(folder: Path) -> Callable[[int, int, float], None]:
    """Callback that writes the progress of a refinement to a folder's state."""
    last = 0.0

    def progress(made: int, expected: int, misfit: float) -> None:
        nonlocal last
        if time.monotonic() - last > _PROGRESS_INTERVAL:
            change_state(folder, progress={"made": made, "expected": max(expected, made)})
            last = time.monotonic()

    return progress
