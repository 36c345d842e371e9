"""Files of an estimate: ``estimate.json``, its samples beside it, and those of its report."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from common.documents import read_arrays, read_json
from common.errors import InputError
from common.files import remove_file, replace_json, replacing, require_file
from drapenet.result.document import EstimateDocument
from drapenet.result.estimate import Estimate
from sim.material import MICRO

ESTIMATE, SAMPLES = "estimate.json", "samples.npz"
REPORT, PAGE, SHAPES, TORQUES = "report.png", "report.html", "drape.glb", "torque.svg"
SHOWN = (REPORT, PAGE, SHAPES, TORQUES)


def write_estimate(out: Path, estimate: Estimate, document: EstimateDocument) -> None:
    """Write the document of an estimate, and its samples beside it."""
    with replacing(out / SAMPLES) as stream:
        np.savez(stream, samples=estimate.samples, spread=estimate.spread)
    replace_json(out / ESTIMATE, document.content())


def remove_report(out: Path) -> None:
    """Remove the report files of an earlier estimate."""
    for name in SHOWN:
        remove_file(out / name)


def read_document(path: Path) -> EstimateDocument:
    """Read an ``estimate.json``."""
    return EstimateDocument.of(read_json(path, remedy=EstimateDocument.remedy), path)


def read_estimate(path: Path) -> tuple[Estimate, EstimateDocument]:
    """Read an ``estimate.json``, or that in a folder, with its samples."""
    path = path / ESTIMATE if path.is_dir() else path
    document = read_document(path)
    file = path.with_name(SAMPLES)
    arrays = read_arrays(file, ("samples", "spread"), expected="the samples of an estimate")
    samples, spread = arrays["samples"], arrays["spread"]
    estimate = Estimate(samples, document.names, np.radians(document.axis.direction_deg),
                        document.axis.probability, document.density, spread,
                        tuple(document.warnings))
    if samples.ndim != 2 or samples.shape[1:] != (6,) or spread.shape != (6,) or not np.allclose(
            np.median(estimate.moduli()[0], axis=0) / MICRO,
            [moduli.alpha_uN_m.median for moduli in document.moduli.values()], rtol=1e-6):
        raise InputError(f"{file} does not hold the samples of {path}; estimate the capture again")
    return estimate, document


def result_name(sources: Sequence[Path]) -> str:
    """Name of the results of captures: the end of their path, or of that of their common folder."""
    places = [Path(os.path.abspath(source)) for source in sources]
    several = len(places) > 1
    path = Path(os.path.commonpath([place.parent for place in places])) if several else places[0]
    if path.is_file():
        path = path.with_suffix("")
    if Path.cwd() in path.parents:
        path = path.relative_to(Path.cwd())
    return "_".join(last_parts(path) + ["joint"] * several)


def printable(path: str | Path) -> str:
    """The path with its bytes that are not UTF-8 replaced: neither JSON nor a page may hold them.
    """
    return os.fsencode(path).decode(errors="replace")


def last_parts(path: Path) -> list[str]:
    """The last three parts of a path: FABRIC, SAMPLE and CAPTURE."""
    named = path if path.name and ".." not in path.parts else path.resolve()
    return [part for part in named.parts if part != named.anchor][-3:]


def require_output(out: Path, sources: Sequence[Path] = ()) -> None:
    """InputError if results of ``sources`` cannot be written to ``out`` or would replace others."""
    for name in (ESTIMATE, SAMPLES, *SHOWN):
        require_file(out / name)
    if not sources:
        return
    try:
        capture = read_document(out / ESTIMATE).capture
    except InputError:  # none, or damaged
        return
    places = {printable(os.path.realpath(source)) for source in sources}
    for earlier in capture.sources or [capture.source]:
        if earlier and os.path.realpath(earlier) not in places:
            raise InputError(f"{out} holds the estimate of {earlier}, which would be overwritten; "
                             f"give another out=, or remove {out / ESTIMATE}")
