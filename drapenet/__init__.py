"""Bending moduli of fabrics from their drapes.

    import drapenet
    estimate = drapenet.estimate("examples/captures/twill")   # or several captures of a fabric
    alpha, beta = estimate.moduli()                            # N·m, N·m²: samples, by direction
    print(estimate.names, 1e6 * estimate.fabric.alpha, 1e6 * drapenet.interval(alpha))
    print(estimate.reading("bending_length_mm").mean(axis=0))  # mm
    print(*(found.text for found in estimate.warnings), sep="\n")
    print(*drapenet.next_measurements(estimate), sep="\n")    # what would narrow it
    again = drapenet.load("outputs/demo")                      # what infer.py has written
    drapenet.preview(again).write("outputs/demo")              # skirts of twelve samples
    fabrics = drapenet.estimate_fabrics("captures", "outputs/all")  # many, by name

The simulator is :mod:`sim`, captures are read by :mod:`data.captures`; values of testers without
any picture are converted to files for other tools by :func:`drapenet.convert.convert`.
"""

from pathlib import Path
from typing import TYPE_CHECKING

from common.errors import InputError
from common.late import late

if TYPE_CHECKING:
    from collections.abc import Mapping
    from typing import Any

    from data.captures.capture import Capture, DepthCapture
    from drapenet.config import EstimateOptions
    from drapenet.report.garment import preview
    from drapenet.result.document import NextMeasurement
    from drapenet.result.estimate import Estimate, interval

__all__ = ["Capture", "DepthCapture", "Estimate", "InputError", "estimate", "estimate_fabrics",
           "interval", "load", "next_measurements", "preview"]
__getattr__, __dir__ = late(__name__, {
    "data.captures.capture": ("Capture", "DepthCapture"),
    "drapenet.report.garment": ("preview",),
    "drapenet.result.estimate": ("Estimate", "interval")})


def load(path: str | Path) -> "Estimate":
    """The estimate of an ``estimate.json``, or of that in a folder, with its posterior samples.

    InputError if it is not sound.
    """
    from common.arguments import require
    from drapenet.result.files import read_estimate

    require(path=(path, str | Path))
    from dataclasses import replace

    from drapenet.fabric.estimate import captures_in

    found, _ = read_estimate(Path(path))
    folder = Path(path) if Path(path).is_dir() else Path(path).parent
    return replace(found, captures=captures_in(folder))


def next_measurements(estimate: "Estimate", *, checkpoint: str | Path = ""
                      ) -> "list[NextMeasurement]":
    """Further measurements of a fabric, those that narrow alpha most first: by how many per cent
    each would lower the standard deviations of log alpha and of beta, and minutes of work. A drape
    on another tester is simulated, which takes seconds.

    Args:
        checkpoint: that of the estimate; empty: the bundled one.

    InputError for an estimate whose captures are not at hand: load the folder that has them, or
    estimate them again.
    """
    from common.arguments import require
    from drapenet.fabric.next_measurements import next_measurements as found_next
    from drapenet.network.checkpoint import read_header
    from drapenet.result.estimate import Estimate

    require(estimate=(estimate, Estimate), checkpoint=(checkpoint, str | Path))
    if estimate.captures is None:
        raise InputError("the captures of this estimate are not at hand; load the folder that "
                         "infer.py has written, or estimate them again")
    return found_next(estimate, estimate.captures, read_header(checkpoint))


def estimate(
    *captures: "str | Path | Capture", strips: str | Path = "", tension: str | Path = "",
    checkpoint: str | Path = "", refine: bool = False,
    known: "Mapping[str, Any] | None" = None,
) -> "Estimate":
    """Estimate one fabric as ``infer.py`` does, without writing files; InputError for bad input.

    Args:
        captures: their folders, or folders of captures, or captures made of arrays. Of a folder of
            several, a capture that is refused is left out, with a warning.
        strips: folder of photographed strips, beside captures or alone.
        tension: folder of strips under weights (tension.yaml), likewise.
        checkpoint: FILE.safetensors of ``train.py``; empty: the bundled one.
        refine: whether captures are refined by simulation, half a minute each.
        known: values of the fabric, with the keys and checks of ``known`` in ``capture.yaml``; a
            drape coefficient is that of the first capture. None: what captures and strips state.
    """
    from common.arguments import require
    from data.captures.arrays import checked_capture
    from data.captures.capture import Capture
    from drapenet.fabric.estimate import estimate_fabric
    from drapenet.fabric.sources import sources_of
    from drapenet.network.checkpoint import read_header

    require(strips=(strips, str | Path), tension=(tension, str | Path),
            checkpoint=(checkpoint, str | Path))
    options = _options(refine)
    if not (captures or strips or tension):
        raise InputError("give a capture, or strips=FOLDER, or tension=FOLDER")
    if kinds := {type(each).__name__ for each in captures
                 if not isinstance(each, str | Path | Capture)}:
        raise InputError(f"a capture is a folder or a Capture, not {', '.join(sorted(kinds))}; "
                         "several captures are several arguments")
    given = [Path(each) if isinstance(each, str | Path) else checked_capture(each)
             for each in captures]
    sources = sources_of(given, strips=strips, tension=tension, known=known)
    return estimate_fabric(sources, read_header(checkpoint), options).estimate


def estimate_fabrics(
    source: str | Path, out: str | Path, *, checkpoint: str | Path = "", refine: bool = False,
    workers: int | None = None,
) -> "dict[str, Estimate]":
    """Estimate many fabrics as ``infer.py captures=`` does, in processes: a script calls this below
    ``if __name__ == "__main__":``. An interrupted call is resumed by the same one.

    Args:
        source: a folder with FABRIC/SAMPLE/CAPTURE below it, or a CSV list of captures.
        out: folder of the tables, of a page for each fabric, and of ``failures.csv``.
        checkpoint: FILE.safetensors of ``train.py``; empty: the bundled one.
        refine: whether captures are refined by simulation, half a minute each.
        workers: processes; None: one for each core.

    Returns:
        Estimates of the fabrics by the name of their folders in ``out``; those that failed are left
        out. InputError if all did, or for bad input.
    """
    from common.arguments import require, whole_number
    from common.files import folder_named, locked
    from drapenet.fabric.many import estimate_fabrics as estimate_all

    require(source=(source, str | Path), out=(out, str | Path), checkpoint=(checkpoint, str | Path))
    workers = None if workers is None else whole_number("workers", workers, 1)
    options, folder = _options(refine), folder_named(str(out))
    with locked(folder):
        files = estimate_all(Path(source), folder, options, checkpoint=str(checkpoint),
                             workers=workers)
    return {file.parent.name: load(file) for file in files}


def _options(refine: bool) -> "EstimateOptions":
    from common.arguments import require
    from common.configs import read_option
    from drapenet.config import EstimateOptions

    require(refine=(refine, bool, "True"))  # "no" would be true
    return EstimateOptions(refine=read_option("refine", "simulation") if refine else None, drapes=0)
