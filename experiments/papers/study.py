"""Definition of a study, and the page docs/studies.md.

To add a study, write a module in this folder with a ``STUDY``, its keys in ``configs/study``, and
add its name to ``experiments.papers.__main__.ORDER``.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from experiments.common import ROOT, run_cases, table
from experiments.figures import slug

PAGE = ROOT / "docs" / "studies.md"
REPORTS = ROOT / "docs" / "studies"
_HEAD = """# Studies

Experiments of published papers, repeated with this system. The command of a study resumes after an
interruption and writes its section of this page; `make studies` runs all studies, and
`python -m experiments.papers page` writes page and figures from the stored reports. Unless stated
otherwise, errors of log α and β/α are root mean squares of posterior mean minus truth, in units of
the standard deviation over fabrics, and displacements are distances between the positions of the
same material point in two drapes, averaged over the specimen including its part on the plate. 002
is Feng et al. 2022, 000 Larionov et al., 001 DiffCloth, 004 Miguel et al. 2012.
[validation.md](validation.md) validates and times the simulator.
"""

Report = dict[str, Any]

_EXECUTION_KEYS = ("fabrics", "workers", "cases", "out", "learned")


def run_fabrics(
    case: Callable[..., dict], config: dict[str, Any], *, sources: Sequence[str],
    subfolder: str = "",
) -> dict[str, dict]:
    """Run ``case(number=k, ...)`` for every fabric that has no stored result.

    Args:
        config: of the study; all keys except :data:`_EXECUTION_KEYS` are passed to ``case``.
        sources: of the results, see :func:`experiments.common.run_cases`.
        subfolder: of the config's ``cases``, for the results.
    """
    settings = {key: value for key, value in config.items() if key not in _EXECUTION_KEYS}
    return run_cases(case, {f"fabric_{k:02}": settings | {"number": k}
                            for k in range(config["fabrics"])},
                     folder=Path(config["cases"]) / subfolder, workers=config["workers"],
                     sources=sources)


@dataclass(frozen=True)
class Study:
    """Definition of a study.

    Attributes:
        name: of the module, the config in ``configs/study`` and the report.
        title: of the section.
        source: paper and section of the repeated experiment.
        question: in one sentence.
        run: computes the report, of JSON types, from the config.
        summarise: text with the main results, from the report.
        rows: header and rows of the table, from the report.
        draw: figure, from the report.
        paper: results of the paper, and whether they are comparable.
        limits: limits of validity of the results.
        assumptions: inputs of each method, where they differ.
        second_table: from the report.
    """

    name: str
    title: str
    source: str
    question: str
    run: Callable[[dict[str, Any]], Report]
    summarise: Callable[[Report], str]
    rows: Callable[[Report], tuple[Sequence[str], list[list[object]]]]
    draw: Callable[[Report], Figure]
    paper: str
    limits: str
    assumptions: str = ""
    second_table: Callable[[Report], str] | None = None

    @property
    def report(self) -> Path:
        """Path of the report; the figure is beside it."""
        return REPORTS / f"{self.name}.json"

    def section(self, report: Report) -> str:
        """Section of the page, from the report."""
        return "\n\n".join(filter(None, [
            f"## {self.title}", f"*Source*: {self.source}. {self.question} "
            f"*Command*: `python -m experiments.papers {self.name}`.", self.summarise(report),
            table(*self.rows(report)), *([self.second_table(report)] if self.second_table else []),
            f"![{self.title}](experiments/papers/{self.name}.png)",
            self.assumptions and f"*Inputs*: {self.assumptions}",
            f"*Paper*: {self.paper}", f"*Limits*: {self.limits}"]))


def page(studies: Sequence[Study], reports: dict[str, Report]) -> str:
    """Text of the page, with a section for every study that has a report."""
    available = [study for study in studies if study.name in reports]
    contents = table(["study", "source"], [[f"[{study.title}](#{slug(study.title)})", study.source]
                                          for study in available])
    sections = [study.section(reports[study.name]) for study in available]
    return "\n".join([_HEAD, contents, "", "\n\n".join(sections), ""])


def error_cell(result: dict[str, Any] | None, name: str, *, interval: bool = False) -> str:
    """Error of a training (:func:`experiments.papers.learned.train`) on unseen fabrics, as a table
    cell."""
    if result is None:
        return "–"
    error = result["unseen"]["fabrics"][name]
    low, high = error["interval_95"]
    return f"{error['rmse']:.3f}" + (f" ({low:.3f} to {high:.3f})" if interval else "")


def error_figure(groups: dict[str, dict[str, dict[str, Any]]]) -> Figure:
    """Plot errors and 95 % intervals of trainings by name; groups of trainings by label."""
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
