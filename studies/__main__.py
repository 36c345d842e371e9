"""Run studies: ``python -m studies NAME|all [key=value ...]``; keys in ``configs/study/``.

``python -m studies page`` runs nothing: it writes the page and the pictures from the reports.
"""

import benchmarks.one_thread  # noqa: F401

# isort: split
import json
import sys
from importlib import import_module
from pathlib import Path

from benchmarks.common import write_figure, write_report
from common.cli import parse_overrides, run_command
from common.errors import InputError
from common.files import replace_file, require_file
from studies.study import PAGE, Report, Study, default_config, page

ORDER = ("table3", "repeatability", "robustness", "views", "inputs", "heads", "space", "scaling",
         "transfer", "recognition", "optimisers", "curves", "hung", "friction")
"""Of the sections."""


def study_named(name: str) -> Study:
    """The study ``name``."""
    return import_module(f"studies.{name}").STUDY


def reports() -> dict[str, Report]:
    """All reports that are there."""
    return {name: json.loads(study_named(name).report.read_text(encoding="utf-8"))
            for name in ORDER if study_named(name).report.exists()}


def write_page(*, pictures: bool = False) -> None:
    """Write the page, and the pictures if wanted, from the reports that are there."""
    known = reports()
    for name in known if pictures else ():
        study = study_named(name)
        write_figure(study.report.with_suffix(".png"), study.draw(known[name]))
    replace_file(PAGE, page([study_named(name) for name in ORDER], known).encode())


def main(argv: list[str]) -> None:
    """The command line."""
    if argv == ["page"]:
        write_page(pictures=True)
        return
    if not argv or argv[0] not in (*ORDER, "all"):
        raise InputError(f"name a study: {', '.join(ORDER)}, all, or page alone")
    for name in ORDER if argv[0] == "all" else argv[:1]:
        study = study_named(name)
        config = parse_overrides(default_config(name), argv[1:])
        out = Path(config["out"]) if config["out"] else study.report
        require_file(out)
        report = {"settings": config, **study.run(config)}
        write_report(out, report)
        write_figure(out.with_suffix(".png"), study.draw(report))
        print(study.answer(report), file=sys.stderr)
        if out == study.report:
            write_page()


if __name__ == "__main__":
    run_command(main, usage=__doc__)
