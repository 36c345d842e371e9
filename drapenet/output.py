"""What ``infer.py`` leaves in its folder: ``estimate.json`` and ``report.png``, of the same run; of
a capture among hundreds also what the tables and pages are made of.
"""

from pathlib import Path
from typing import Any

from common.files import remove_file, replace_file, replace_json, require_file, require_folder

ESTIMATE, REPORT = "estimate.json", "report.png"
DONE, SAMPLES, THUMBNAIL = "done.json", "samples.npz", "view.png"


def require_output(out: Path) -> None:
    """InputError where the two files cannot be written to ``out``; to be told before long work."""
    require_folder(out)
    require_file(out / REPORT)


def write_estimate(out: Path, content: dict[str, Any], lines: str) -> None:
    """Write ``content``, and print it as ``lines``; the report of an earlier run goes."""
    replace_json(out / ESTIMATE, content)
    remove_file(out / REPORT)
    print(lines)
    print(f"estimate: {out / ESTIMATE}")


def write_report(out: Path, picture: bytes) -> None:
    """Write a ``picture``, the bytes of a PNG."""
    replace_file(out / REPORT, picture)
    print(f"report:   {out / REPORT}")
