"""The benchmarks' reports in one file: ``python -m benchmarks.report [key=value ...]``.

Keys (``key=value``):

    folder   of the reports
    out      the file, JSON; reports that are not there are left out
"""

import json
from pathlib import Path

from benchmarks.common import REPORTS, parse_settings
from common.cli import run_command
from common.errors import InputError
from common.files import replace_file

NAMES = ("speed", "render", "throughput", "render_gpu")
DEFAULTS = {"folder": str(REPORTS), "out": str(REPORTS / "bench.json")}


def main(argv: list[str]) -> None:
    """Collect the reports by name."""
    config = parse_settings(DEFAULTS, argv)
    paths = {name: Path(config["folder"]) / f"{name}.json" for name in NAMES}
    found = {name: json.loads(path.read_text(encoding="utf-8"))
             for name, path in paths.items() if path.is_file()}
    if not found:
        raise InputError(f"no report of {', '.join(NAMES)} in {config['folder']}")
    out = Path(config["out"])
    replace_file(out, (json.dumps(found, indent=2, allow_nan=False) + "\n").encode())
    print(f"{', '.join(found)}: {out}")


if __name__ == "__main__":
    run_command(main, usage=__doc__)
