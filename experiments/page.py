"""Sections of experiments that repeat those of papers, and their page docs/studies.md."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from experiments.figures.claims import slug
from experiments.result import ROOT, Report, table

PAGE = ROOT / "docs" / "studies.md"
TEMPLATE = Path(__file__).with_name("studies.md")
"""Text before and after the sections."""
ORDER = ("table3", "networks", "repeatability", "robustness", "views", "transfer", "hung", "skirt")
"""Experiments in the order of the page."""


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

    def text(self, name: str, report: Report) -> str:
        """The section of the experiment ``name``."""
        return "\n\n".join(filter(None, [
            f"## {self.title}", f"*Source*: {self.source}. {self.question} "
            f"*Command*: `python -m experiments {name}`.", self.summary(report),
            table(*self.rows(report)), f"![{self.title}](validation/{name}.png)",
            self.inputs and f"*Inputs*: {self.inputs}",
            f"*Paper*: {self.paper}", f"*Limits*: {self.limits}"]))


def page_text(sections: dict[str, Section], reports: dict[str, Report]) -> str:
    """Text of the page, from sections and reports by name."""
    contents = table(["study", "source"], [[f"[{section.title}](#{slug(section.title)})",
                                            section.source] for section in sections.values()])
    texts = [section.text(name, reports[name]) for name, section in sections.items()]
    return TEMPLATE.read_text(encoding="utf-8").replace(
        "<!-- sections -->", "\n\n".join([contents, *texts]))
