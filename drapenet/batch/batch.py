"""Batch inference: ``infer.py captures=ROOT out=OUT``.

Each capture is a case (:mod:`common.cases`) with a folder under OUT. An interrupted run is resumed
and gives the same tables as an uninterrupted one.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import groupby
from pathlib import Path

import joblib
import numpy as np

from common.cases import run_cases
from common.errors import InputError
from common.files import by_number, remove_file, replace_file, require_folder
from common.findings import Finding
from data.captures.capture import Capture
from data.captures.preview import show
from drapenet.batch.captures import Entry, entries_of
from drapenet.config import EstimateOptions
from drapenet.estimator.read import read_source
from drapenet.network.checkpoint import Header, read_header
from drapenet.report.overview import (
    FAILURE,
    INDEX,
    RESULTS,
    THUMBNAIL,
    FabricEstimate,
    Joined,
    fabrics_text,
    write_overview,
)
from drapenet.result.copies import first_with, left_out
from drapenet.result.document import EstimateDocument
from drapenet.result.files import (
    ESTIMATE,
    OBSERVATION,
    PDF,
    SAMPLES,
    read_document,
    read_estimate,
    remove_report,
    write_estimate,
)

DONE = "done"
"""Name of the case of a capture's folder; its file is ``done.json``."""
SOURCES = (__name__, "configs/camera.yaml", "data/weights/*", "drapenet/report/pages/*.html")


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
    joined = join_fabrics(out, outcomes, header, strict=options.strict)
    write_overview(out, joined)
    fabrics, apart = joined.fabrics, len({entry.fabric for entry, _ in joined.apart})
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
    source = read_source(capture)
    header = read_header(weights)
    from drapenet.estimator.estimate import estimate_source  # torch, which faulty captures need not

    estimate_source(source, header, options, out=out)
    if isinstance(source, Capture):
        replace_file(out / THUMBNAIL, show(source, small=True))


def join_fabrics(
    out: Path, outcomes: Sequence[tuple[Entry, str]], header: Header, *, strict: bool
) -> Joined:
    """Estimates of the fabrics from their finished captures and strips, written to their folders.

    Args:
        outcomes: captures and strips, each with the reason of its failure, or ''.
    """
    failures = [dict(zip(FAILURE, (entry.fabric, entry.sample, entry.capture, str(entry.path),
                                   failure.removeprefix(f"{entry.path}: ")), strict=True))
                for entry, failure in outcomes if failure]
    fabrics, apart, failed = [], [], Counter(row["fabric"] for row in failures)
    ordered = sorted((entry for entry, failure in outcomes if not failure),
                     key=lambda entry: (by_number(entry.fabric), by_number(entry.place)))
    twins = _twins_elsewhere(ordered, out)
    refused: dict[str, list[Path]] = {}
    for entry, failure in outcomes:
        refused.setdefault(entry.fabric, []).extend([entry.path] * bool(failure))
    for name, group in groupby(ordered, key=lambda entry: entry.fabric):
        entries = list(group)
        try:
            fabric = _joined(name, entries, refused[name], out, header, strict, twins)
            fabrics.append(replace(fabric, failed=failed[name]))
        except InputError as error:
            apart += _apart(entries, out)
            failures.append(dict.fromkeys(FAILURE, "") | {"fabric": name, "reason": str(error)})
    places = {Path(entry.place.parts[0]) for entry, _ in outcomes}
    for place in places - {fabric.place for fabric in fabrics}:  # of an earlier run
        for file in (ESTIMATE, SAMPLES, INDEX, PDF):
            remove_file(out / place / file)
    return Joined(fabrics, apart, failures)


def _twins_elsewhere(entries: Sequence[Entry], out: Path) -> dict[Path, list[Finding]]:
    """Findings of captures whose pictures another fabric has, too, by their place."""
    first: dict[str, tuple[Entry, str]] = {}
    found: dict[Path, list[Finding]] = {}
    for entry in entries:
        try:
            document = read_document(out / entry.place / ESTIMATE)
        except InputError:  # of damaged files, which is said where they are joined
            continue
        own = entry, document.label
        other = first_with(first, document.capture.pictures_sha256, own)
        if other and other[0].fabric != entry.fabric:
            for (one, label), (_, twin) in ((own, other), (other, own)):
                found.setdefault(one.place, []).append(Finding("twin_elsewhere", {
                    "capture": label, "other": twin}))
    return found


def _joined(
    name: str, entries: Sequence[Entry], refused: Sequence[Path], out: Path, header: Header,
    strict: bool, twins: Mapping[Path, Sequence[Finding]]
) -> FabricEstimate:
    """Join the captures and strips of a fabric but copies, and what is known by those that are
    ``refused``; write its estimate, with those findings and its ``twins`` in other fabrics."""
    from drapenet.estimator.estimate import join, known_parts, read_part  # torch
    from drapenet.estimator.stages import require_sound

    parts = [read_part(out / entry.place) for entry in entries]
    repeated = left_out([part.document for part in parts])
    joined = [part for k, part in enumerate(parts) if k not in repeated]
    known, lost = known_parts(refused, joined, header)
    joined += known
    faults = [*repeated.values(),
              *(one for entry in entries for one in twins.get(entry.place, ())), *lost]
    require_sound(faults, strict, "the fabric")
    place, scatter = Path(entries[0].place.parts[0]), None
    if len(joined) == 1:
        estimate, document = read_estimate(out / entries[0].place)
    else:
        estimate, document = join(
            joined, header, strict=strict,
            ahead=any(part.document.next_measurements for part in joined))
        middles = [np.log([moduli.alpha_uN_m.median for moduli in
                           part.document.moduli_at_300_g_m2.values()])
                   for part in joined if part.observation]
        scatter = np.exp(np.std(middles, axis=0, ddof=1)) if len(middles) > 1 else None
    document = document.warned(*faults)
    write_estimate(out / place, estimate, document)
    return FabricEstimate(
        name, place, [(entry, part.document.warned(*twins.get(entry.place, ())))
                      for entry, part in zip(entries, parts, strict=True)], document, scatter)


def _apart(entries: Sequence[Entry], out: Path) -> list[tuple[Entry, EstimateDocument]]:
    """The captures of a fabric that are not joined, but those whose files are damaged."""
    found = []
    for entry in entries:
        with suppress(InputError):
            found.append((entry, read_document(out / entry.place / ESTIMATE)))
    return found
