"""Batch inference: ``infer.py captures=ROOT out=OUT``.

Each capture is a part of its fabric with a folder of its own under OUT, made in processes. An
interrupted run is resumed and gives the same tables as an uninterrupted one.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path

import joblib
from tqdm import tqdm

from common.cases import in_processes
from common.errors import InputError, one_line
from common.files import by_number, remove_file, require_folder
from common.findings import Finding
from drapenet.config import EstimateOptions
from drapenet.fabric.entries import Entry, entries_of
from drapenet.fabric.estimate import estimate_fabric, require_one_fabric
from drapenet.fabric.part import PART, Part, Refusal, make_in_folder, part_key, stored_part
from drapenet.fabric.sources import Source
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
from drapenet.result.copies import first_with
from drapenet.result.document import EstimateDocument
from drapenet.result.files import ESTIMATE, PDF, SAMPLES


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
    earlier = {file.parent.relative_to(out) for file in out.rglob(PART)}
    if earlier and earlier.isdisjoint(entry.place for entry in entries):
        raise InputError(f"{out} has the estimates of other captures, such as {min(earlier)}, "
                         "whose tables would be replaced; choose another out=")
    header = read_header(checkpoint)
    options = replace(options, thumbnail=THUMBNAIL)
    fabrics_found = len({entry.fabric for entry in entries})
    print(f"{len(entries)} capture{'s' * (len(entries) > 1)} of {fabrics_found} "
          f"fabric{'s' * (fabrics_found > 1)}; before the first one the network is loaded, up to a "
          "minute", flush=True)
    failures = _make_parts(entries, out, header, options, workers or joblib.cpu_count())
    joined = _join_fabrics(out, entries, failures, header, options)
    write_overview(out, joined)
    fabrics = joined.fabrics
    apart = len({entry.fabric for entry, _ in joined.apart})
    if fabrics:
        print(fabrics_text(fabrics))
    print(f"captures: {len(entries) - len(failures)} estimated, {len(failures)} failed"
          + f"; {apart} fabrics not joined" * (apart > 0)
          + f", see {out / 'failures.csv'}" * (len(failures) + apart > 0))
    print(f"fabrics:  {out / RESULTS}, {out / 'summary.csv'}, {out / 'fabrics.csv'}\n"
          f"overview: {out / 'index.html'}")
    if len(failures) == len(entries):
        raise InputError(f"none of {len(entries)} captures could be estimated; see "
                         f"{out / 'failures.csv'}")
    return [out / fabric.place / ESTIMATE for fabric in fabrics]


def _source(entry: Entry) -> Source:
    """The source of a capture, whose part is in its folder of the fabric's."""
    part = entry.place.relative_to(entry.place.parts[0])
    return Source(place=entry.path, part=str(part), required=False)


def _make_parts(
    entries: Sequence[Entry], out: Path, header: Header, options: EstimateOptions, workers: int
) -> dict[Path, str]:
    """Make the parts of all captures that are missing; why captures failed, by their places."""
    keys = {entry.place: part_key(_source(entry), header, options) for entry in entries}
    tasks, failures = {}, {}
    for entry in entries:
        stored = stored_part(_source(entry), out / entry.place, keys[entry.place])
        if stored is None:
            tasks[entry.place] = (_source(entry), out / entry.place, keys[entry.place], options,
                                  header.path)
        elif isinstance(stored, Refusal):
            failures[entry.place] = str(stored.error)
    for place, outcome in in_processes(make_in_folder, tasks, total=len(entries), workers=workers,
                                       unit="capture"):
        if isinstance(outcome, Exception):
            outcome = f"{type(outcome).__name__}: {one_line(outcome)}; please report it"
        if outcome:
            tqdm.write(f"{place} failed: {outcome}")
            failures[place] = outcome
    return failures


def _join_fabrics(
    out: Path, entries: Sequence[Entry], failures: Mapping[Path, str], header: Header,
    options: EstimateOptions,
) -> Joined:
    """Estimates of the fabrics from the parts that are made, written to their folders."""
    rows = [dict(zip(FAILURE, (entry.fabric, entry.sample, entry.capture, str(entry.path),
                               failures[entry.place].removeprefix(f"{entry.path}: ")),
                     strict=True)) for entry in entries if entry.place in failures]
    failed = Counter(row["fabric"] for row in rows)
    ordered = sorted(entries, key=lambda entry: (by_number(entry.fabric), by_number(entry.place)))
    # A fault of the program leaves neither a part nor a refusal: its capture is only listed.
    parts = {entry.place: part for entry in ordered
             if (part := stored_part(_source(entry), out / entry.place, ""))}
    documents = {place: part.document for place, part in parts.items() if isinstance(part, Part)}
    twins = _twins_elsewhere(ordered, documents, _not_of_one(ordered, parts))
    fabrics, apart = [], []
    for name, group in groupby(ordered, key=lambda entry: entry.fabric):
        every = list(group)
        place = Path(every[0].place.parts[0])
        shown = [(entry, documents[entry.place].warned(*twins.get(entry.place, ())))
                 for entry in every if entry.place in documents]
        try:
            found = estimate_fabric(
                [_source(entry) for entry in every if entry.place in parts], header, options,
                folder=out / place,
                twins=[one for entry, _ in shown for one in twins.get(entry.place, ())],
                listed=True)
        except InputError as error:
            apart += shown
            for file in (ESTIMATE, SAMPLES, INDEX, PDF):  # of an earlier run
                remove_file(out / place / file)
            if shown:
                copied = [one.text for entry, _ in shown for one in twins.get(entry.place, ())]
                rows.append(dict.fromkeys(FAILURE, "") | {
                    "fabric": name, "reason": "; ".join([str(error), *copied])})
            continue
        fabrics.append(FabricEstimate(name, place, shown, found.document, found.scatter,
                                      failed=failed[name]))
    return Joined(fabrics, apart, rows)


def _not_of_one(entries: Sequence[Entry], parts: Mapping[Path, Part | Refusal]) -> set[str]:
    """Names of fabrics whose parts cannot be of one."""
    found = set()
    for name, group in groupby(entries, key=lambda entry: entry.fabric):
        try:
            require_one_fabric([part for entry in group
                                if isinstance(part := parts.get(entry.place), Part)])
        except InputError:
            found.add(name)
    return found


def _twins_elsewhere(
    entries: Sequence[Entry], documents: Mapping[Path, EstimateDocument], apart: set[str]
) -> dict[Path, list[Finding]]:
    """Findings of captures whose pictures another fabric has, too, by their place; one in a fabric
    ``apart`` is the copy, and has it alone."""
    first: dict[str, Entry] = {}
    found: dict[Path, list[Finding]] = {}
    for entry in sorted((entry for entry in entries if entry.place in documents),
                        key=lambda entry: entry.fabric in apart):
        other = first_with(first, documents[entry.place].capture.pictures_sha256, entry)
        if other and other.fabric != entry.fabric:
            for one, twin in ((entry, other), (other, entry)):
                if twin.fabric in apart and one.fabric not in apart:
                    continue
                found.setdefault(one.place, []).append(Finding("twin_elsewhere", {
                    "capture": documents[one.place].label, "other": documents[twin.place].label}))
    return found
