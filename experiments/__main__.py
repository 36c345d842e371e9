"""Run a study.

    python -m experiments                       # lists them
    python -m experiments NAME [key=value ...]  # NAME --help lists the keys
    python -m experiments NAME out=docs/validation/NAME.json  # replaces the tracked report
    python -m experiments papers                # all of docs/studies.md with code, hours of CPU
    python -m experiments page                  # docs/studies.md and its figures from the reports

A study writes a report, outputs/experiments/NAME.json unless out= names another file, and some a
figure beside it; those of the documentation, in docs/validation, are replaced only if out= names
them. It prints what the documentation claims and shows of it. An interrupted run resumes from its
folder cases=."""

import sys
from collections.abc import Sequence
from functools import partial

from common.command import commands
from common.errors import InputError
from experiments import study
from experiments.report import REPORTS, read_report, write_figure
from experiments.study import FILES

PAPERS = ("table3", "views")
"""Studies that repeat those of papers, in the order of docs/studies.md."""


def usage() -> str:
    """Module docstring followed by one line per study."""
    lines, folder = [__doc__], ""
    for name, file in FILES.items():
        if file.parent.name != folder:
            folder = file.parent.name
            lines.append(f"\n{folder}:")
        lines.append(f"  {name:18}{study.about(name).partition(chr(10))[0]}")
    return "\n".join(lines)


def run_study(name: str, words: list[str]) -> None:
    """Run a study, and print what the documentation shows of it."""
    from experiments.figures.pages import fill_pages, shown

    if {"-h", "--help"} & set(words):
        print(f"{study.about(name)}\n\nKeys:\n\n{study.study(name).keys.text()}")
        return
    out, report = study.run(name, words)
    documented = out.parent == REPORTS
    print(shown(out.stem if documented else name, report))
    for case, reason in report.get("refused", {}).items():
        print(f"left out: {case}: {reason}")
    print(f"report: {out}")
    if documented and name in PAPERS:
        fill_pages()


def run_papers(words: list[str]) -> None:
    """Run the studies of the page with the words ``words``; replace their reports."""
    for name in PAPERS:
        run_study(name, [f"out={REPORTS / name}.json", *words])


def write_page(words: Sequence[str]) -> None:
    """Write docs/studies.md and its figures from the stored reports."""
    from experiments.figures.pages import fill_pages

    if words:
        raise InputError(f"'{words[0]}': page takes no other words")
    for name in PAPERS:
        if (draw := study.study(name).draw) and (figure := draw(read_report(name))):
            write_figure(REPORTS / f"{name}.png", figure)
    fill_pages()


main = commands({**{name: partial(run_study, name) for name in FILES}, "papers": run_papers,
                 "page": write_page}, usage=usage())

if __name__ == "__main__":
    sys.argv[1:] = sys.argv[1:] or ["--help"]
    main()
