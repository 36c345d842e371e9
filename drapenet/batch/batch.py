"""Batch inference: ``infer.py captures=ROOT out=OUT``.

Each capture is estimated in a worker process and has its folder under OUT; a file
``done.json`` is written last, with a digest of all that the result depends on. An interrupted run
is resumed from these files and gives the same tables as an uninterrupted one.
"""

import hashlib
import json
import os
from collections.abc import Mapping
from concurrent.futures import as_completed
from functools import cache
from pathlib import Path
from typing import Any

import joblib

from common.cases import progress_bar
from common.documents import Schema, read_json
from common.errors import InputError, one_line
from common.files import remove_file, replace_file, replace_json, require_folder
from common.provenance import code_state
from common.workers import worker_pool
from data.captures.capture import read_capture
from data.render.shade import thumbnails
from drapenet.batch.captures import entries_of
from drapenet.network.checkpoint import header_for, read_header
from drapenet.report.overview import write_overview
from drapenet.result.output import (
    DONE,
    ESTIMATE,
    SAMPLES,
    SHOWN,
    THUMBNAIL,
    write_result,
    write_samples,
)
from drapenet.result.table import format_fabrics

_BLOCK = 1 << 20  # bytes


class Done(Schema):
    """Content of ``done.json``."""

    stamp: str
    failure: str


def estimate_tree(
    source: Path, out: Path, *, checkpoint: str = "", workers: int | None = None, **options: Any
) -> list[Path]:
    """Estimate all captures of ``source`` (:func:`drapenet.batch.captures.entries_of`); write
    tables, a page for each fabric and an overview to ``out``; return the fabrics' files
    ``estimate.json``.

    Args:
        checkpoint: for all captures; empty: the bundled one of each capture's rig.
        workers: processes, one thread each; None: one for each core.
        options: of :func:`drapenet.inference.estimate_capture`, serialisable as JSON.

    Raises:
        InputError: no captures, an invalid checkpoint, a folder that is not writable, or no capture
            that can be estimated.
    """
    entries = entries_of(source)
    require_folder(out)
    earlier = {file.parent.relative_to(out) for file in out.rglob(DONE)}
    if earlier and earlier.isdisjoint(entry.place for entry in entries):
        raise InputError(f"{out} has the estimates of other captures, such as {min(earlier)}, "
                         "whose tables would be replaced; choose another out=")
    chosen = str(read_header(checkpoint).path) if checkpoint else ""
    stamps = {entry.place: stamp_of(entry.path, chosen, options) for entry in entries}
    known = [_failure(out / entry.place, stamps[entry.place]) for entry in entries]
    missing = [entry for entry, failure in zip(entries, known, strict=True) if failure is None]
    print(f"{len(entries)} captures of {len({entry.fabric for entry in entries})} fabrics: "
          f"{known.count('')} estimated, {len(entries) - known.count('') - len(missing)} failed, "
          f"{len(missing)} to go. If interrupted, the same command goes on.", flush=True)
    if missing:
        count = min(workers or joblib.cpu_count(), len(missing))
        with worker_pool(count) as pool, progress_bar(total=len(missing), unit="capture") as bar:
            futures = {pool.submit(_estimate, entry.path, out / entry.place, stamps[entry.place],
                                   chosen, options): entry for entry in missing}
            for future in as_completed(futures):
                if failure := future.result():
                    path = str(futures[future].path)
                    bar.write(f"failed: {failure if path in failure else f'{path}: {failure}'}")
                bar.update()
    outcomes = [(entry, _failure(out / entry.place) or "") for entry in entries]
    fabrics, apart = write_overview(out, outcomes)
    failed = sum(bool(failure) for _, failure in outcomes)
    if fabrics:
        print(format_fabrics([(one.name, len(one.captures), one.content, one.warnings)
                              for one in fabrics]))
    print(f"captures: {len(outcomes) - failed} estimated, {failed} failed"
          + f"; {apart} fabrics not joined" * (apart > 0)
          + f", see {out / 'failures.csv'}" * (failed + apart > 0))
    print(f"fabrics:  {out / 'summary.csv'}, {out / 'fabrics.csv'}\noverview: {out / 'index.html'}")
    if all(failure for _, failure in outcomes):
        raise InputError(f"none of {len(outcomes)} captures could be estimated; see "
                         f"{out / 'failures.csv'}")
    return [out / one.place / ESTIMATE for one in fabrics]


def stamp_of(capture: Path, checkpoint: str, options: Mapping[str, Any]) -> str:
    """Digest of a capture's files and of everything else that its estimate depends on."""
    digest = hashlib.sha256(json.dumps([_identity(checkpoint), options], sort_keys=True).encode())
    try:
        for file in sorted(capture.iterdir()):
            digest.update(b"\0" + os.fsencode(file.name) + b"\0")
            if file.is_file():  # pipes and devices may be endless
                with file.open("rb") as stream:
                    while block := stream.read(_BLOCK):
                        digest.update(block)
    except OSError as error:  # reported when the capture is read
        digest.update(type(error).__name__.encode())
    return digest.hexdigest()


@cache
def _identity(checkpoint: str) -> Any:
    """Identity of the code and of the checkpoint, or of all bundled checkpoints."""
    files = [Path(checkpoint)] if checkpoint else sorted(
        (Path(__file__).parents[1] / "weights").glob("*.safetensors"))
    return [code_state(), *(read_header(file).identity for file in files)]


def _failure(folder: Path, stamp: str | None = None) -> str | None:
    """Why a finished capture has no estimate, empty if it has one; None if it is not finished, or
    has another ``stamp``.
    """
    try:
        content = Done.of(read_json(folder / DONE), folder / DONE)
        return content.failure if stamp in (None, content.stamp) else None
    except InputError:
        return None


def _estimate(
    capture: Path, folder: Path, stamp: str, checkpoint: str, options: dict[str, Any]
) -> str:
    """Estimate one capture and write its folder; return the failure in one line, or ''.

    ``stamp`` was computed before, so that a capture changed meanwhile is estimated by the next run.
    """
    failure = ""
    for name in (DONE, ESTIMATE, SAMPLES, THUMBNAIL, *SHOWN):
        remove_file(folder / name)
    try:
        _write(capture, folder, checkpoint, options)
    except InputError as error:
        failure = str(error)
    except Exception as error:  # a failing capture must not end the batch
        failure = f"{type(error).__name__}: {one_line(error)}; please report this capture"
    replace_json(folder / DONE, {"stamp": stamp, "failure": failure})
    return failure


def _write(path: Path, folder: Path, checkpoint: str, options: dict[str, Any]) -> None:
    from drapenet.inference import estimate_capture

    capture = read_capture(path)
    result = estimate_capture(capture, header_for([capture], checkpoint), **options)
    write_samples(folder, result.estimate)
    replace_file(folder / THUMBNAIL, thumbnails(capture.views[:1]))
    write_result(folder, result)
