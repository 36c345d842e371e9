"""Files of an estimate: ``estimate.json``, its samples beside it, and those of its report."""

import os
from collections.abc import Iterable, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from common.documents import read_arrays, read_json, reading
from common.errors import InputError
from common.files import printable, remove_file, replace_json, replacing, require_file
from common.findings import Finding, texts
from data.fabrics.fabrics import ClothProperties
from drapenet.result.document import EstimateDocument
from drapenet.result.estimate import Estimate
from drapenet.views.observation import Observation
from drapenet.views.outline import DrapeOutline
from drapenet.views.pictures import DepthPictures
from drapenet.views.radial_map import RadialMap
from sim.material import MICRO
from sim.rig import Rig

ESTIMATE, SAMPLES, OBSERVATION = "estimate.json", "samples.npz", "observation.npz"
FAULTS = "faults.txt"
"""Traceback of a stage that failed."""
REPORT, PAGE, PDF = "report.png", "report.html", "report.pdf"
STRIPS = "strips.png"
"""Picture of strips as they were read."""
SHAPES, TORQUES = "drape.glb", "torque.svg"
SHOWN = (REPORT, STRIPS, PAGE, PDF, SHAPES, TORQUES)
GARMENTS = ("garment.png", "garment.glb")
"""Of a preview."""
MAX_NAME = 255  # bytes, which file systems take
_PARTS = {"rig": Rig, "map": RadialMap, "outline": DrapeOutline, "pictures": DepthPictures}
"""Of an observation."""


def write_estimate(out: Path, estimate: Estimate, document: EstimateDocument) -> None:
    """Write the document of an estimate, and its samples beside it."""
    with replacing(out / SAMPLES) as stream:
        np.savez(stream, spread=estimate.spread, **vars(estimate.cloth))
    replace_json(out / ESTIMATE, document.content())


def write_observation(out: Path, seen: Observation) -> None:
    """Write what the network reads of a capture, for joint estimates with others."""
    arrays = {f"{name}.{key}": value for name in _PARTS if (part := getattr(seen, name))
              for key, value in vars(part).items() if value is not None}
    numbers = {name: value for name, value in vars(seen).items() if name not in _PARTS}
    with replacing(out / OBSERVATION) as stream:
        np.savez_compressed(stream, **arrays, **numbers)


def read_observation(out: Path) -> Observation:
    """Read the file of :func:`write_observation`, one of this project's results, to the last bit.
    """
    file = out / OBSERVATION
    values: dict[str, dict[str, Any]] = {name: {} for name in ("", *_PARTS)}
    with reading(file, "estimate the capture again"), np.load(file, allow_pickle=False) as content:
        for key, array in content.items():
            name, _, field = key.rpartition(".")
            values[name][field] = array if array.ndim else array.item()
        parts = {name: kind(**values[name]) for name, kind in _PARTS.items() if values[name]}
        return Observation(**parts, **values[""])


def remove_report(out: Path) -> None:
    """Remove the report and preview of an earlier estimate, and what it says of its faults."""
    for name in (*SHOWN, *GARMENTS, FAULTS):
        remove_file(out / name)


def pictures_of_strips(folders: Iterable[Path]) -> list[bytes]:
    """Pictures of the strips whose estimates are in the folders."""
    return [file.read_bytes() for folder in folders if (file := folder / STRIPS).exists()]


def read_document(path: Path) -> EstimateDocument:
    """Read an ``estimate.json``."""
    return EstimateDocument.of(read_json(path, remedy=EstimateDocument.remedy), path)


def read_estimate(path: Path) -> tuple[Estimate, EstimateDocument]:
    """Read an ``estimate.json``, or that in a folder, with its samples."""
    path = path / ESTIMATE if path.is_dir() else path
    document = read_document(path)
    file = path.with_name(SAMPLES)
    names = [field.name for field in fields(ClothProperties)]
    arrays = read_arrays(file, ("spread", *names), expected="the samples of an estimate")
    spread = arrays.pop("spread")
    count = len(arrays["theta"]) if arrays["theta"].ndim else 0
    shapes = {"theta": (count, 6), "curl": (count, 2)}
    fault = InputError(f"{file} does not hold the samples of {path}; estimate the capture again")
    if spread.shape == (6,):  # as results were before the ratio of the yarns was told
        spread = np.append(spread, np.inf)
    if spread.shape != (7,) or not count or any(
            arrays[name].shape != shapes.get(name, (count,)) for name in names):
        raise fault
    estimate = Estimate(ClothProperties(**arrays), document.names, document.density, spread,
                        tuple(document.warnings))
    if not np.allclose(np.median(estimate.moduli()[0], axis=0) / MICRO,
                       [moduli.alpha_uN_m.median for moduli in document.moduli.values()],
                       rtol=1e-6):
        raise fault
    return estimate, document


def result_name(sources: Sequence[Path]) -> str:
    """Name of the results of captures: the end of their path, or of that of their common folder."""
    path = _place(sources)
    if path.is_file():
        path = path.with_suffix("")
    if Path.cwd() in path.parents:
        path = path.relative_to(Path.cwd())
    name = "_".join(last_parts(path) + ["joint"] * (len(sources) > 1))
    data = os.fsencode(name)
    return name if len(data) <= MAX_NAME else data[-MAX_NAME:].decode(errors="ignore")


def fabric_name(document: EstimateDocument) -> str:
    """Name of a fabric: the stated one, or that of the folder of its captures or strips."""
    return document.capture.labels.fabric or _place(_sources(document)).name or "fabric"


def capture_names(document: EstimateDocument) -> list[str]:
    """Names of the captures of a joint estimate: their paths below the common folder."""
    sources = [Path(source) for source in document.capture.sources or []]
    return [os.path.relpath(source, _place(sources)) if len(sources) > 1 else source.name
            for source in sources]


def shown_texts(document: EstimateDocument, found: Iterable[Finding]) -> list[str]:
    """The lines of findings of an estimate as customers read them: with the names of captures in
    place of their paths on this computer."""
    sources = [Path(source) for source in _sources(document) if source]
    if not sources:
        return texts(found)
    names = capture_names(document) if document.capture.sources else [fabric_name(document)]
    place = _place(sources)
    named = {str(path): name for path, name in zip(sources, names, strict=False)} | {
        f"{place}{os.sep}": "", f"{place.parent}{os.sep}": ""}
    lines = texts(found)
    for path in sorted(named, key=len, reverse=True):  # a capture before its folder
        if len(Path(path).parts) > 1:  # neither a name alone nor the root
            lines = [line.replace(path, named[path]) for line in lines]
    return lines


def _sources(document: EstimateDocument) -> list[Path]:
    about = document.capture
    beside = [record.source for record in document.records]
    return [Path(source) for source in
            about.sources or ([about.source] if about.source else beside or [""])]


def _place(sources: Sequence[Path]) -> Path:
    """A capture's path, or the common folder of several."""
    places = [Path(os.path.abspath(source)) for source in sources]
    return (places[0] if len(places) == 1 else
            Path(os.path.commonpath([place.parent for place in places])))


def last_parts(path: Path) -> list[str]:
    """The last three parts of a path: FABRIC, SAMPLE and CAPTURE."""
    named = path if path.name and ".." not in path.parts else path.resolve()
    return [part for part in named.parts if part != named.anchor][-3:]


def require_output(out: Path, sources: Sequence[Path] = ()) -> None:
    """InputError if results of ``sources`` cannot be written to ``out`` or would replace others."""
    for name in (ESTIMATE, SAMPLES, OBSERVATION, *SHOWN, *GARMENTS):
        require_file(out / name)
    if not sources:
        return
    try:
        capture = read_document(out / ESTIMATE).capture
    except InputError:  # none, or damaged
        return
    places = {printable(os.path.realpath(source)) for source in sources}
    for earlier in capture.sources or [capture.source or ""]:
        if earlier and os.path.realpath(earlier) not in places:
            raise InputError(f"{out} holds the estimate of {earlier}, which would be overwritten; "
                             f"give another out=, or remove {out / ESTIMATE}")
