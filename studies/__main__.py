"""Run studies: ``python -m studies NAME|all [key=value ...]``; keys in ``configs/study/``."""

import benchmarks.one_thread  # noqa: F401

# isort: split
import json
import sys
from importlib import import_module
from pathlib import Path

from benchmarks.common import write_figure, write_report
from common.cli import parse_overrides, run_command
from common.configs import read_config
from common.errors import InputError
from common.files import replace_file, require_file
from studies.study import PAGE, Report, Study, page

ORDER = ("table3", "repeatability", "robustness", "views", "transfer", "recognition")
"""Of the sections."""


def study_named(name: str) -> Study:
    """The study ``name``."""
    return import_module(f"studies.{name}").STUDY


def reports() -> dict[str, Report]:
    """All reports that are there."""
    return {name: json.loads(study_named(name).report.read_text(encoding="utf-8"))
            for name in ORDER if study_named(name).report.exists()}


def main(argv: list[str]) -> None:
    """The command line."""
    if not argv or argv[0] not in (*ORDER, "all"):
        raise InputError(f"name a study: {', '.join(ORDER)} or all")
    for name in ORDER if argv[0] == "all" else argv[:1]:
        study = study_named(name)
        config = parse_overrides(read_config(f"study/{name}"), argv[1:])
        out = Path(config["out"]) if config["out"] else study.report
        require_file(out)
        report = {"settings": config, **study.run(config)}
        write_report(out, report)
        write_figure(out.with_suffix(".png"), study.draw(report))
        print(study.answer(report), file=sys.stderr)
        if out == study.report:
            known = {one: found for one, found in reports().items()}
            replace_file(PAGE, page([study_named(one) for one in ORDER], known).encode())


if __name__ == "__main__":
    run_command(main, usage=__doc__)
