"""Run studies.

    python -m studies NAME [key=value ...]  # configs/study/NAME.yaml; NAME --help lists the keys
    python -m studies all [key=value ...]
    python -m studies page                  # only write the page and the figures from the reports
"""

import benchmarks.one_thread  # noqa: F401

# isort: split
import json
import sys
from dataclasses import asdict
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from benchmarks.common import write_figure, write_report
from common.command import command, commands, schema_of
from common.errors import InputError
from common.files import replace_file, require_file
from studies.study import PAGE, Report, Study, page

ORDER = ("table3", "repeatability", "robustness", "views", "inputs", "heads", "space", "scaling",
         "transfer", "recognition", "optimisers", "curves", "hung", "friction")
"""Of the sections."""


def study_named(name: str) -> Study:
    """The study ``name``."""
    return import_module(f"studies.{name}").STUDY


def reports() -> dict[str, Report]:
    """Existing reports by name."""
    return {name: json.loads(study_named(name).report.read_text(encoding="utf-8"))
            for name in ORDER if study_named(name).report.exists()}


def write_page(*, pictures: bool = False) -> None:
    """Write the page, and optionally the figures, from the existing reports."""
    known = reports()
    for name in known if pictures else ():
        study = study_named(name)
        write_figure(study.report.with_suffix(".png"), study.draw(known[name]))
    replace_file(PAGE, page([study_named(name) for name in ORDER], known).encode())


def run_study(name: str, words: list[str]) -> None:
    """Run the study ``name`` under the overrides ``words``; write its report and picture."""

    @command(f"study/{name}", schema_of(f"study/{name}"), swept_out=f"{name}.json")
    def run(settings: Any) -> None:
        study, config = study_named(name), asdict(settings)
        out = Path(config["out"]) if config["out"] else study.report
        require_file(out)
        report = {"settings": config, **study.run(config)}
        write_report(out, report)
        write_figure(out.with_suffix(".png"), study.draw(report))
        print(study.answer(report), file=sys.stderr)
        if out == study.report:
            write_page()

    run(words)


def run_all(words: list[str]) -> None:
    """Run all studies, each under the overrides ``words``."""
    for name in ORDER:
        run_study(name, words)


def draw_page(words: list[str]) -> None:
    """Write the page and all figures; takes no ``words``."""
    if words:
        raise InputError(f"'{words[0]}': page takes no other words")
    write_page(pictures=True)


main = commands({**{name: partial(run_study, name) for name in ORDER}, "all": run_all,
                 "page": draw_page}, usage=__doc__)

if __name__ == "__main__":
    main()
