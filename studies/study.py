"""What a study is, and the page that all of them make.

A study of your own: a module of this folder with a ``STUDY``, its keys in ``configs/study``, its
name in ``studies.__main__.ORDER``.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from benchmarks.common import ROOT, run_cases, table

PAGE = ROOT / "docs" / "studies.md"
REPORTS = ROOT / "docs" / "studies"
_HEAD = """# Studies

Experiments of the papers, repeated with this system. Each has a command that resumes where it was
interrupted and writes its section of this page; `make studies` runs all, `python -m studies page`
writes the page and its pictures from the reports alone. Errors of log α and β/α are root mean
squares of the difference between the posterior's mean and the truth, in units of the standard
deviation over fabrics, unless stated otherwise. 002 is Feng et al. 2022, 000 is Larionov et al.
Timings and validations of the simulator are in [validation.md](validation.md).
"""

Report = dict[str, Any]


_OF_THE_RUN = ("fabrics", "workers", "cases", "out", "scans")


def over_fabrics(
    case: Callable[..., dict], config: dict[str, Any], *, sources: Sequence[str], inside: str = ""
) -> dict[str, dict]:
    """Results of ``case(number=k, ...)`` for every fabric, those that are finished from before.

    Args:
        config: of the study; all keys but those of the run itself go to ``case``.
        sources: that the results depend on, :func:`benchmarks.common.run_cases`.
        inside: folder for them in that of the config.
    """
    settings = {key: value for key, value in config.items() if key not in _OF_THE_RUN}
    return run_cases(case, {f"fabric_{k:02}": settings | {"number": k}
                            for k in range(config["fabrics"])},
                     folder=Path(config["cases"]) / inside, workers=config["workers"],
                     sources=sources)


@dataclass(frozen=True)
class Study:
    """An experiment.

    Attributes:
        name: of its module, its config in ``configs/study`` and its report.
        title: of its section.
        after: the experiment that it repeats.
        question: in one sentence.
        run: from the config to the report, in JSON's types.
        answer: sentences, from the report.
        rows: head and rows of the table, from the report.
        draw: its picture, from the report.
        paper: what the paper has found, and whether it can be compared.
        limits: of the answer.
        given: what each method knows, where they differ.
    """

    name: str
    title: str
    after: str
    question: str
    run: Callable[[dict[str, Any]], Report]
    answer: Callable[[Report], str]
    rows: Callable[[Report], tuple[Sequence[str], list[list[object]]]]
    draw: Callable[[Report], Figure]
    paper: str
    limits: str
    given: str = ""

    @property
    def report(self) -> Path:
        """Its JSON; the picture is beside it."""
        return REPORTS / f"{self.name}.json"

    def section(self, report: Report) -> str:
        """Its part of the page."""
        return "\n\n".join(filter(None, [
            f"## {self.title}", f"*After* {self.after}. {self.question} "
            f"*Command*: `python -m studies {self.name}`.", self.answer(report),
            table(*self.rows(report)),
            f"![{self.title}](studies/{self.name}.png)",
            self.given and f"*Given*: {self.given}",
            f"*Paper*: {self.paper}", f"*Limits*: {self.limits}"]))


def page(studies: Sequence[Study], reports: dict[str, Report]) -> str:
    """The page with a section for every study that has a report."""
    sections = [study.section(reports[study.name]) for study in studies if study.name in reports]
    return "\n".join([_HEAD, "\n\n".join(sections), ""])
