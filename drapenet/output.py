"""What ``infer.py`` leaves in its folder: ``estimate.json`` and the files that show it, of the same
run; of a capture among hundreds also what the tables and pages are made of.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from common.errors import InputError
from common.files import remove_file, replace_file, replace_json, require_file, require_folder

ESTIMATE = "estimate.json"
REPORT, PAGE, SHAPES, TORQUES = "report.png", "report.html", "drape.glb", "torque.svg"
SHOWN = (REPORT, PAGE, SHAPES, TORQUES)
DONE, SAMPLES, THUMBNAIL = "done.json", "samples.npz", "view.png"


def require_output(out: Path) -> None:
    """InputError where the files cannot be written to ``out``; to be known before long work."""
    require_folder(out)
    for name in SHOWN:
        require_file(out / name)


def keep_estimate(out: Path, content: dict[str, Any]) -> None:
    """Write ``content``; what shows an earlier estimate goes."""
    replace_json(out / ESTIMATE, content)
    for name in SHOWN:
        remove_file(out / name)


def write_estimate(out: Path, content: dict[str, Any], lines: str) -> None:
    """Write ``content`` (:func:`keep_estimate`), and print it as ``lines``."""
    keep_estimate(out, content)
    print(lines)
    print(f"estimate: {out / ESTIMATE}")


def write_files(out: Path, files: Mapping[str, bytes]) -> None:
    """Write what shows an estimate (:class:`drapenet.inference.Result`); a failure is a warning."""
    written = []
    for name, data in files.items():
        try:
            replace_file(out / name, data)
            written.append(str(out / name))
        except InputError as error:
            print(f"warning: no report: {error}")
    if written:
        print(f"report:   {', '.join(written)}")
