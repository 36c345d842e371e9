"""Definition of a study, and the page docs/studies.md.

To add a study, write a module in this folder with a ``STUDY``, its keys in ``configs/study``, and
add its name to ``studies.__main__.ORDER``.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.common import ROOT, run_cases, table
from benchmarks.figures import slug

PAGE = ROOT / "docs" / "studies.md"
REPORTS = ROOT / "docs" / "studies"
_HEAD = """# Studies

Experiments of published papers, repeated with this system. Each has a command that can be resumed
and writes its section of this page; `make studies` runs all, `python -m studies page` writes page
and pictures from the stored reports. Unless stated otherwise, errors of log α and β/α are root mean
squares of posterior mean minus truth, in units of the standard deviation over fabrics, and
displacements are distances between the positions of the same material point in two drapes, averaged
over the specimen including its part on the plate.
002 is Feng et al. 2022, 000 Larionov et al., 001 DiffCloth, 004 Miguel et al. 2012.
[validation.md](validation.md) validates and times the simulator.
"""

Report = dict[str, Any]


_EXECUTION_KEYS = ("fabrics", "workers", "cases", "out", "scans", "learned")


def over_fabrics(
    case: Callable[..., dict], config: dict[str, Any], *, sources: Sequence[str], inside: str = ""
) -> dict[str, dict]:
    """Results of ``case(number=k, ...)`` for every fabric; finished ones are not repeated.

    Args:
        config: of the study; all keys but those of the run itself go to ``case``.
        sources: that the results depend on, :func:`benchmarks.common.run_cases`.
        inside: folder for them in that of the config.
    """
    settings = {key: value for key, value in config.items() if key not in _EXECUTION_KEYS}
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
        more: another table, from the report.
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
    more: Callable[[Report], str] | None = None

    @property
    def report(self) -> Path:
        """Its JSON; the picture is beside it."""
        return REPORTS / f"{self.name}.json"

    def section(self, report: Report) -> str:
        """Section of the page."""
        return "\n\n".join(filter(None, [
            f"## {self.title}", f"*After* {self.after}. {self.question} "
            f"*Command*: `python -m studies {self.name}`.", self.answer(report),
            table(*self.rows(report)), *([self.more(report)] if self.more else []),
            f"![{self.title}](studies/{self.name}.png)",
            self.given and f"*Given*: {self.given}",
            f"*Paper*: {self.paper}", f"*Limits*: {self.limits}"]))


def page(studies: Sequence[Study], reports: dict[str, Report]) -> str:
    """The page with a section for every study that has a report."""
    there = [study for study in studies if study.name in reports]
    contents = table(["study", "after"], [[f"[{study.title}](#{slug(study.title)})", study.after]
                                          for study in there])
    sections = [study.section(reports[study.name]) for study in there]
    return "\n".join([_HEAD, contents, "", "\n\n".join(sections), ""])


def error_cell(result: dict[str, Any] | None, name: str, *, interval: bool = False) -> str:
    """An error of a training (:func:`studies.learned.learn`) on unseen fabrics, for a table."""
    if result is None:
        return "–"
    found = result["unseen"]["fabrics"][name]
    low, high = found["interval_95"]
    return f"{found['rmse']:.3f}" + (f" ({low:.3f} to {high:.3f})" if interval else "")


def error_picture(groups: dict[str, dict[str, dict[str, Any]]]) -> Figure:
    """Errors of trainings by name, with their intervals; groups, by label, one above the other."""
    names = list(dict.fromkeys(name for group in groups.values() for name in group))
    figure = Figure(figsize=(9, 1.2 + 0.32 * len(names)), layout="constrained")
    for axes, (key, title) in zip(figure.subplots(1, 2, sharey=True), (
            ("log_alpha", "log α"), ("beta_over_alpha", "β/α")), strict=True):
        for k, (label, group) in enumerate(groups.items()):
            found = [one["unseen"]["fabrics"][key] for one in group.values()]
            middle = np.array([one["rmse"] for one in found])
            low, high = np.transpose([one["interval_95"] for one in found])
            places = np.array([names.index(name) for name in group])
            axes.errorbar(middle, places + 0.25 * (k - (len(groups) - 1) / 2),
                          xerr=[middle - low, high - middle], fmt="o", ms=4, label=label or None)
        axes.set(title=title, xlabel="error, in deviations over fabrics", xlim=(0, None))
        axes.set_yticks(range(len(names)), names)
        axes.grid(axis="x", color="0.9")
    axes.invert_yaxis()
    if len(groups) > 1:
        axes.legend(fontsize=8)
    return figure
