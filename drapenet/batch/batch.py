"""Batch inference: ``infer.py captures=ROOT out=OUT``.

Each capture is a case (:mod:`common.cases`) with a folder under OUT. An interrupted run is resumed
and gives the same tables as an uninterrupted one.
"""

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import groupby
from pathlib import Path

import joblib
import numpy as np

from common.cases import run_cases
from common.errors import InputError
from common.files import remove_file, replace_file, require_folder
from data.captures.capture import Capture, read_capture
from data.captures.preview import thumbnail
from data.strips.description import FILE as STRIPS
from data.strips.folder import read_strips
from drapenet.batch.captures import Entry, entries_of
from drapenet.config import EstimateOptions
from drapenet.network.checkpoint import Header, read_header
from drapenet.report.overview import (
    FAILURE,
    INDEX,
    RESULTS,
    THUMBNAIL,
    FabricEstimate,
    fabrics_text,
    write_overview,
)
from drapenet.result.files import (
    ESTIMATE,
    OBSERVATION,
    PDF,
    SAMPLES,
    read_estimate,
    remove_report,
    write_estimate,
)

DONE = "done"
"""Name of the case of a capture's folder; its file is ``done.json``."""
SOURCES = ("common", "data", "drapenet", "sim")


def estimate_fabrics(
    source: Path, out: Path, options: EstimateOptions, *, checkpoint: str = "",
    workers: int | None = None,
) -> list[Path]:
    """Estimate all captures and strips of ``source``; write tables, a page for each fabric and an
    overview to ``out``; return the fabrics' files ``estimate.json``.

    Args:
        checkpoint: empty: the bundled one.
        workers: None: one for each core.
    """
    entries = entries_of(source)
    require_folder(out)
    earlier = {file.parent.relative_to(out) for file in out.rglob(f"{DONE}.json")}
    if earlier and earlier.isdisjoint(entry.place for entry in entries):
        raise InputError(f"{out} has the estimates of other captures, such as {min(earlier)}, "
                         "whose tables would be replaced; choose another out=")
    header = read_header(checkpoint)
    cases = {f"{entry.place}/{DONE}": {
        "capture": entry.path, "folder": str((out / entry.place).resolve()), "options": options,
        "weights": header.path} for entry in entries}
    fabrics_found = len({entry.fabric for entry in entries})
    print(f"{len(entries)} capture{'s' * (len(entries) > 1)} of {fabrics_found} "
          f"fabric{'s' * (fabrics_found > 1)}; before the first one the network is loaded, up to a "
          "minute", flush=True)
    failures: dict[str, str] = {}
    run_cases(estimate_entry, cases, folder=out, workers=workers or joblib.cpu_count(),
              sources=SOURCES, failures=failures, unit="capture",
              title=lambda name: name.removesuffix(f"/{DONE}"))
    outcomes = [(entry, failures.get(f"{entry.place}/{DONE}", "")) for entry in entries]
    fabrics, rows = join_fabrics(out, outcomes, header, strict=options.strict)
    write_overview(out, fabrics, rows)
    apart = len({entry.fabric for entry, failure in outcomes if not failure}) - len(fabrics)
    if fabrics:
        print(fabrics_text(fabrics))
    print(f"captures: {len(outcomes) - len(failures)} estimated, {len(failures)} failed"
          + f"; {apart} fabrics not joined" * (apart > 0)
          + f", see {out / 'failures.csv'}" * (len(failures) + apart > 0))
    print(f"fabrics:  {out / RESULTS}, {out / 'summary.csv'}, {out / 'fabrics.csv'}\n"
          f"overview: {out / 'index.html'}")
    if len(failures) == len(entries):
        raise InputError(f"none of {len(entries)} captures could be estimated; see "
                         f"{out / 'failures.csv'}")
    return [out / fabric.place / ESTIMATE for fabric in fabrics]


def estimate_entry(
    capture: Path, folder: str, options: EstimateOptions, weights: Path
) -> None:
    """Estimate one capture, or the strips of a folder, into its folder of results."""
    out = Path(folder)
    for name in (ESTIMATE, SAMPLES, OBSERVATION, THUMBNAIL):
        remove_file(out / name)
    remove_report(out)
    source = read_strips(capture) if (capture / STRIPS).exists() else read_capture(capture)
    header = read_header(weights)
    from drapenet.inference import estimate_source  # torch, which faulty captures need not

    estimate_source(source, header, options, out=out)
    if isinstance(source, Capture):
        replace_file(out / THUMBNAIL, thumbnail(source))


def join_fabrics(
    out: Path, outcomes: Sequence[tuple[Entry, str]], header: Header, *, strict: bool
) -> tuple[list[FabricEstimate], list[dict[str, str]]]:
    """Estimates of the fabrics from their finished captures and strips, written to their folders,
    and rows of what failed, by :data:`~drapenet.report.overview.FAILURE`.

    Args:
        outcomes: captures and strips, each with the reason of its failure, or ''.
    """
    failures = [dict(zip(FAILURE, (entry.fabric, entry.sample, entry.capture, str(entry.path),
                                   failure.removeprefix(f"{entry.path}: ")), strict=True))
                for entry, failure in outcomes if failure]
    fabrics, failed = [], Counter(row["fabric"] for row in failures)
    ordered = sorted((entry for entry, failure in outcomes if not failure),
                     key=lambda entry: (entry.fabric, entry.place))
    twins = _twins(ordered, out)
    for name, entries in groupby(ordered, key=lambda entry: entry.fabric):
        try:
            fabric = _joined(name, list(entries), out, header, strict, twins.get(name, []))
            fabrics.append(replace(fabric, failed=failed[name]))
        except InputError as error:
            failures.append(dict.fromkeys(FAILURE, "") | {"fabric": name, "reason": str(error)})
    places = {Path(entry.place.parts[0]) for entry, _ in outcomes}
    for place in places - {fabric.place for fabric in fabrics}:  # of an earlier run
        for file in (ESTIMATE, SAMPLES, INDEX, PDF):
            remove_file(out / place / file)
    return fabrics, failures


def _twins(entries: Sequence[Entry], out: Path) -> dict[str, list[str]]:
    """A line for each capture whose pictures are those of another fabric, by fabric."""
    first: dict[str, Entry] = {}
    lines: dict[str, list[str]] = {}
    for entry in entries:
        digest = ""
        with suppress(InputError):  # of damaged files, which is said where they are joined
            capture = read_estimate(out / entry.place)[1].capture
            if capture.views or not (capture.known and capture.known.drape_coefficient_percent):
                digest = capture.views_sha256  # two fabrics may have the same numbers
        other = first.setdefault(digest, entry) if digest else entry
        if other.fabric != entry.fabric:
            for one, two in ((entry, other), (other, entry)):
                lines.setdefault(one.fabric, []).append(
                    f"{one.place} has the same pictures as {two.place}, of another fabric: one of "
                    "them is a copy in a wrong folder")
    return lines


def _joined(
    name: str, entries: Sequence[Entry], out: Path, header: Header, strict: bool,
    twins: Sequence[str]
) -> FabricEstimate:
    """Join the captures and strips of a fabric; write its estimate, with the lines of ``twins``."""
    from drapenet.inference import joint_estimate, read_part  # torch
    from drapenet.stages import require_sound

    require_sound(list(twins), strict, "the fabric")
    parts = [read_part(out / entry.place) for entry in entries]
    place, scatter = Path(entries[0].place.parts[0]), None
    if len(parts) == 1:
        estimate, document = read_estimate(out / entries[0].place)
    else:
        estimate, document = joint_estimate(parts, header, strict=strict)
        middles = [np.log([moduli.alpha_uN_m.median for moduli in part.document.moduli.values()])
                   for part in parts if part.observation]
        scatter = np.exp(np.std(middles, axis=0, ddof=1)) if len(middles) > 1 else None
    if twins:
        document = document.model_copy(update={"warnings": [*document.warnings, *twins]})
    write_estimate(out / place, estimate, document)
    return FabricEstimate(
        name, place, [(entry, part.document) for entry, part in zip(entries, parts, strict=True)],
        document, scatter)
