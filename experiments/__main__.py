"""Run an experiment.

    python -m experiments                       # lists them
    python -m experiments NAME [key=value ...]  # NAME --help lists the keys
    python -m experiments NAME out=docs/validation/NAME.json  # replaces the tracked report
    python -m experiments papers                # all of docs/studies.md, hours of CPU
    python -m experiments page                  # docs/studies.md and its figures from the reports

An experiment writes a report, outputs/experiments/NAME.json unless out= names another file, and
most a figure beside it; those of the documentation, in docs/validation, are replaced only if out=
names them. It prints what the documentation claims and shows of it. An interrupted run
resumes from its folder cases=."""

import ast
import sys
from dataclasses import asdict
from functools import partial, wraps
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

from common.command import command, commands, schema_of
from common.errors import InputError
from common.files import replace_file, require_file, require_folder
from experiments.result import FILES


def usage() -> str:
    """Module docstring followed by one line per experiment."""
    lines, folder = [__doc__], ""
    for name, file in FILES.items():
        if file.parent.name != folder:
            folder = file.parent.name
            lines.append(f"\n{folder}:")
        about = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""
        lines.append(f"  {name:18}{about.partition(chr(10))[0]}")
    return "\n".join(lines)


def module_of(name: str) -> ModuleType:
    """The module of an experiment."""
    return import_module(f"experiments.{FILES[name].parent.name}.{name}")


def run_experiment(name: str, words: list[str]) -> None:
    """Run an experiment with the overrides ``words``; write report, figure and section."""
    module = module_of(name)

    @command(f"experiment/{name}", schema_of(f"experiment/{name}"))
    @wraps(module.run)  # the help is the docstring of its module
    def run(settings: Any) -> None:
        from experiments.figures.pages import shown
        from experiments.result import EXECUTION_KEYS, REPORTS, write_figure, write_report

        config, stored = asdict(settings), REPORTS / f"{name}.json"
        out = Path(config["out"] or f"outputs/experiments/{name}.json").resolve()
        require_file(out)
        for folder in {"cases", "work"} & set(config):
            require_folder(Path(config[folder]))
        result, section = module.run(config), getattr(module, "SECTION", None)
        kept = {key: value for key, value in config.items() if key not in EXECUTION_KEYS}
        report = {"settings": kept, **result.report}
        write_report(out, report)
        if figure := section.draw(report) if section else result.figure:
            write_figure(out.with_suffix(".png"), figure)
        print(section.summary(report) if section else shown(
            out.stem if out.parent == REPORTS else name, report))
        for case, reason in report.get("failures", {}).items():
            print(f"left out: {case}: {reason}")
        print(f"report: {out}")
        if section and out == stored:
            write_page()

    run(words)


def run_papers(words: list[str]) -> None:
    """Run all experiments of the page with the overrides ``words``; replace their reports."""
    from experiments.page import ORDER
    from experiments.result import REPORTS

    for name in ORDER:
        run_experiment(name, [f"out={REPORTS / name}.json", *words])


def write_page(words: list[str] = (), *, figures: bool = False) -> None:
    """Write docs/studies.md, and optionally its figures, from the stored reports."""
    from experiments.page import ORDER, PAGE, page_text
    from experiments.result import REPORTS, read_report, write_figure

    if words:
        raise InputError(f"'{words[0]}': page takes no other words")
    sections = {name: module_of(name).SECTION for name in ORDER}
    reports = {name: read_report(name) for name in ORDER}
    for name, section in sections.items() if figures else ():
        write_figure(REPORTS / f"{name}.png", section.draw(reports[name]))
    replace_file(PAGE, page_text(sections, reports).encode())


main = commands({**{name: partial(run_experiment, name) for name in FILES}, "papers": run_papers,
                 "page": partial(write_page, figures=True)}, usage=usage())

if __name__ == "__main__":
    sys.argv[1:] = sys.argv[1:] or ["--help"]
    main()
