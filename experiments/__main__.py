"""Run a study.

    python -m experiments                       # lists them
    python -m experiments NAME [key=value ...]  # NAME --help lists the keys
    python -m experiments NAME out=docs/validation/NAME.json  # replaces the tracked report

A study writes a report, outputs/experiments/NAME.json unless out= names another file; those of the
documentation, in docs/validation, are replaced only if out= names them. It prints what the
documentation claims and shows of it. An interrupted run resumes from its folder cases=."""

import sys
from functools import partial

from common.command import commands
from experiments import study
from experiments.report import REPORTS
from experiments.study import FILES


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
    from experiments.figures.pages import shown

    if {"-h", "--help"} & set(words):
        print(f"{study.about(name)}\n\nKeys:\n\n{study.study(name).keys.text()}")
        return
    out, report = study.run(name, words)
    documented = out.parent == REPORTS
    print(shown(out.stem if documented else name, report))
    print(f"report: {out}")


main = commands({name: partial(run_study, name) for name in FILES}, usage=usage())

if __name__ == "__main__":
    sys.argv[1:] = sys.argv[1:] or ["--help"]
    main()
