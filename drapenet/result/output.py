"""Output files of ``infer.py``: ``estimate.json`` and the report files; with ``captures=`` also the
inputs of tables and pages.
"""

import os
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from common.documents import read_json
from common.errors import InputError
from common.files import (
    remove_file,
    replace_file,
    replace_json,
    replacing,
    require_file,
    require_folder,
)
from drapenet.result.content import Result
from drapenet.result.estimate import Estimate
from drapenet.result.table import format_table

ESTIMATE = "estimate.json"
REPORT, PAGE, SHAPES, TORQUES = "report.png", "report.html", "drape.glb", "torque.svg"
SHOWN = (REPORT, PAGE, SHAPES, TORQUES)
NAMED_PARTS = 3  # parts of a path that name its results
DONE, SAMPLES, THUMBNAIL = "done.json", "samples.npz", "view.png"


def result_name(sources: Sequence[Path]) -> str:
    """Name of the results of captures: the last parts of their path (FABRIC, SAMPLE, CAPTURE); of
    several captures, those of their common folder.
    """
    places = [Path(os.path.abspath(source)) for source in sources]
    several = len(places) > 1
    path = Path(os.path.commonpath([one.parent for one in places])) if several else places[0]
    if path.is_file():
        path = path.with_suffix("")
    if Path.cwd() in path.parents:
        path = path.relative_to(Path.cwd())
    return "_".join(last_parts(path) + ["joint"] * several)


def last_parts(path: Path) -> list[str]:
    """The last parts of a path: FABRIC, SAMPLE and CAPTURE."""
    named = path if path.name and ".." not in path.parts else path.resolve()
    return [part for part in named.parts if part != named.anchor][-NAMED_PARTS:]


def require_output(out: Path, sources: Sequence[Path] = ()) -> None:
    """Check, before any long computation, that results of ``sources`` can be written to ``out``.

    Raises:
        InputError: ``out`` is not writable, or contains the estimate of another source.
    """
    require_folder(out)
    for name in SHOWN:
        require_file(out / name)
    if not sources:
        return
    try:
        found = read_json(out / ESTIMATE)["capture"]
        there = found.get("sources") or [found["source"]]
        others = {os.path.realpath(one): one for one in there}
    except (InputError, KeyError, TypeError, AttributeError, ValueError):  # none, or damaged
        return
    for source in sources:
        others.pop(os.path.realpath(source), None)
    if others:
        raise InputError(f"{out} holds the estimate of {next(iter(others.values()))}, which would "
                         f"be overwritten; give another out=, or remove {out / ESTIMATE}")


def keep_estimate(out: Path, content: dict[str, Any]) -> None:
    """Write ``content`` and remove the report files of an earlier estimate."""
    replace_json(out / ESTIMATE, content)
    for name in SHOWN:
        remove_file(out / name)


def show_result(out: Path, result: Result) -> None:
    """Write ``result`` and print it; a report file that cannot be written gives a warning."""
    keep_estimate(out, result.content)
    print(f"{format_table(result.content)}\nestimate: {out / ESTIMATE}")
    written = []
    for name, data in result.files.items():
        try:
            replace_file(out / name, data)
            written.append(str(out / name))
        except InputError as error:
            print(f"warning: no report: {error}")
    if written:
        print(f"report:   {', '.join(written)}")


def write_result(out: Path, result: Result) -> None:
    """Write ``result``, ``estimate.json`` last: if it exists, the result is complete."""
    for name, data in result.files.items():
        replace_file(out / name, data)
    replace_json(out / ESTIMATE, result.content)


def write_samples(out: Path, estimate: Estimate) -> None:
    """Write the samples of a capture's ``estimate``, from which the joint estimate is made."""
    with replacing(out / SAMPLES) as stream:
        np.savez(stream, **vars(estimate))


def read_result(out: Path) -> Result:
    """Read the result of one capture, without report files; InputError if it is damaged."""
    try:
        content = read_json(out / ESTIMATE)
        with np.load(out / SAMPLES, allow_pickle=False) as file:
            kept = dict(file)
        texts = {name: tuple(kept.pop(name).tolist()) for name in ("names", "warnings")}
        numbers = {name: float(kept.pop(name)) for name in ("axis", "certainty", "density")}
        return Result(Estimate(**kept, **texts, **numbers), content)
    except (OSError, EOFError, ValueError, KeyError, TypeError, zipfile.BadZipFile) as error:
        raise InputError(f"{out} is damaged ({type(error).__name__}); remove it and run the "
                         "same command again") from None
