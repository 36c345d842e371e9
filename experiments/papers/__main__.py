"""Run studies.

    python -m experiments.papers NAME [key=value ...]  # configs/study/NAME.yaml; --help: the keys
    python -m experiments.papers all [key=value ...]
    python -m experiments.papers page                  # page and figures from stored reports
"""

import experiments.one_thread  # noqa: F401

# isort: split
import json
import sys
from dataclasses import asdict
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from common.command import command, commands, schema_of
from common.errors import InputError
from common.files import replace_file, require_file
from experiments.common import write_figure, write_report
from experiments.papers.study import PAGE, Report, Study, page

ORDER = ("table3", "repeatability", "robustness", "views", "inputs", "heads", "space", "scaling",
         "transfer", "recognition", "optimisers", "curves", "hung")
"""Names of the studies in the order of the page."""


def study_named(name: str) -> Study:
    """Return the study ``name``."""
    return import_module(f"studies.{name}").STUDY


def reports() -> dict[str, Report]:
    """Stored reports by name of the study."""
    return {name: json.loads(study_named(name).report.read_text(encoding="utf-8"))
            for name in ORDER if study_named(name).report.exists()}


def write_page(*, figures: bool = False) -> None:
    """Write the page, and optionally the figures, from the existing reports."""
    stored = reports()
    for name in stored if figures else ():
        study = study_named(name)
        write_figure(study.report.with_suffix(".png"), study.draw(stored[name]))
    replace_file(PAGE, page([study_named(name) for name in ORDER], stored).encode())


def run_study(name: str, words: list[str]) -> None:
    """Run the study ``name`` with the overrides ``words``; write its report and figure."""

    @command(f"study/{name}", schema_of(f"study/{name}"), swept_out=f"{name}.json")
    def run(settings: Any) -> None:
        study, config = study_named(name), asdict(settings)
        out = Path(config["out"]) if config["out"] else study.report
        require_file(out)
        report = {"settings": config, **study.run(config)}
        write_report(out, report)
        write_figure(out.with_suffix(".png"), study.draw(report))
        print(study.summarise(report), file=sys.stderr)
        if out == study.report:
            write_page()

    run(words)


def run_all(words: list[str]) -> None:
    """Run all studies with the overrides ``words``."""
    for name in ORDER:
        run_study(name, words)


def draw_page(words: list[str]) -> None:
    """Write the page and all figures; accepts no ``words``."""
    if words:
        raise InputError(f"'{words[0]}': page takes no other words")
    write_page(figures=True)


main = commands({**{name: partial(run_study, name) for name in ORDER}, "all": run_all,
                 "page": draw_page}, usage=__doc__)

if __name__ == "__main__":
    main()
