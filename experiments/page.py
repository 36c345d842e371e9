"""Sections of experiments that repeat those of papers, and their page docs/studies.md."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from matplotlib.figure import Figure

from experiments.figures import slug
from experiments.result import ROOT, Report, table

PAGE = ROOT / "docs" / "studies.md"
ORDER = ("table3", "repeatability", "robustness", "views", "inputs", "space", "scaling", "transfer",
         "recognition", "optimisers", "hung", "skirt")
"""Experiments in the order of the page."""
_HEAD = """# Studies

Experiments of published papers, repeated with this system. The command of a study resumes after an
interruption and writes its section of this page; `make studies` runs all studies, and
`python -m experiments page` writes page and figures from the stored reports. Unless stated
otherwise, errors of log α and β/α are root mean squares of posterior mean minus truth, in units of
the standard deviation over fabrics, and displacements are distances between the positions of the
same material point in two drapes, averaged over the specimen including its part on the plate. 002
is Feng et al. 2022, 000 Larionov et al., 001 DiffCloth, 004 Miguel et al. 2012.
[validation.md](validation.md) validates and times the simulator. The first study and the last use
the bundled network; figures of a bundled network in the others are of earlier networks, of squares
from artificial starts.
"""


@dataclass(frozen=True)
class Section:
    """Section of the page: texts, and functions of the report.

    Attributes:
        source: paper and section of the repeated experiment.
        question: in one sentence.
        summary: the main results in sentences.
        rows: header and rows of the table.
        paper: results of the paper, and whether they are comparable.
        limits: of the validity of the results.
        inputs: of each method, where they differ.
    """

    title: str
    source: str
    question: str
    summary: Callable[[Report], str]
    rows: Callable[[Report], tuple[Sequence[str], list[list[object]]]]
    draw: Callable[[Report], Figure]
    paper: str
    limits: str
    inputs: str = ""
    second_table: Callable[[Report], str] | None = None

    def text(self, name: str, report: Report) -> str:
        """The section of the experiment ``name``."""
        return "\n\n".join(filter(None, [
            f"## {self.title}", f"*Source*: {self.source}. {self.question} "
            f"*Command*: `python -m experiments {name}`.", self.summary(report),
            table(*self.rows(report)), *([self.second_table(report)] if self.second_table else []),
            f"![{self.title}](validation/{name}.png)",
            self.inputs and f"*Inputs*: {self.inputs}",
            f"*Paper*: {self.paper}", f"*Limits*: {self.limits}"]))


def page_text(sections: dict[str, Section], reports: dict[str, Report]) -> str:
    """Text of the page, from sections and reports by name."""
    contents = table(["study", "source"], [[f"[{section.title}](#{slug(section.title)})",
                                            section.source] for section in sections.values()])
    texts = [section.text(name, reports[name]) for name, section in sections.items()]
    return "\n".join([_HEAD, contents, "", "\n\n".join(texts), ""])
