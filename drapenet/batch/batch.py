"""Batch inference: ``infer.py captures=ROOT out=OUT``.

Each capture is a case (:mod:`common.cases`) with a folder under OUT. An interrupted run is resumed
and gives the same tables as an uninterrupted one.
"""

from pathlib import Path

import joblib

from common.cases import run_cases
from common.errors import InputError
from common.files import remove_file, replace_file, require_folder
from data.captures.capture import read_capture
from data.captures.preview import thumbnail
from drapenet.batch.captures import entries_of
from drapenet.config import EstimateOptions
from drapenet.network.checkpoint import read_header
from drapenet.report.overview import RESULTS, THUMBNAIL, fabrics_text, write_overview
from drapenet.result.files import ESTIMATE, OBSERVATION, SAMPLES, remove_report

DONE = "done"
"""Name of the case of a capture's folder; its file is ``done.json``."""
SOURCES = ("common", "data", "drapenet", "sim")


def estimate_fabrics(
    source: Path, out: Path, options: EstimateOptions, *, checkpoint: str = "",
    workers: int | None = None,
) -> list[Path]:
    """Estimate all captures of ``source``; write tables, a page for each fabric and an overview to
    ``out``; return the fabrics' files ``estimate.json``.

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
    print(f"{len(entries)} captures of {len({entry.fabric for entry in entries})} fabrics; before "
          "the first one the network is loaded, up to a minute", flush=True)
    failures: dict[str, str] = {}
    run_cases(estimate_entry, cases, folder=out, workers=workers or joblib.cpu_count(),
              sources=SOURCES, failures=failures, unit="capture")
    outcomes = [(entry, failures.get(f"{entry.place}/{DONE}", "")) for entry in entries]
    fabrics = write_overview(out, outcomes, header)
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
    """Estimate one capture into its folder."""
    out = Path(folder)
    for name in (ESTIMATE, SAMPLES, OBSERVATION, THUMBNAIL):
        remove_file(out / name)
    remove_report(out)
    source = read_capture(capture)
    header = read_header(weights)
    from drapenet.inference import estimate_capture  # torch, which faulty captures need not

    estimate_capture(source, header, options, out=out)
    replace_file(out / THUMBNAIL, thumbnail(source))
