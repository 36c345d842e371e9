"""The table of claims, from claims.md and the reports."""

import operator
import re
from collections.abc import Iterator
from pathlib import Path
from string import Formatter
from typing import Any

from experiments.figures.reports import Reports
from experiments.report import Report, markdown
from experiments.study import FILES

CLAIMS = Path(__file__).with_name("claims.md")
COMMANDS = {
    "evaluation": "evaluate",
    "evaluation_flat": "evaluate generate=[nuisances=flat,dataset.rounded_rims=0]"}
"""Commands, with their keys, of reports with another name."""
MISSED = "**missed**"
"""Mark of a target that is not reached."""
_RELATIONS = {"<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge,
              "==": operator.eq}


class Figures(Formatter):
    """Format texts with figures of a report: ``{default[mean_cpu_seconds]:.2f}``.

    In addition to Python's format, ``.1%`` gives 12.3 %, ``.1mm`` converts metres and ``.1M``
    divides by a million.
    """

    def get_field(self, field_name: str, args: Any, kwargs: Any) -> tuple[Any, str]:
        value = kwargs
        for key in re.findall(r"[^\[\]]+", field_name):
            value = value[int(key)] if isinstance(value, list) else value[key]
        return value, field_name

    def format_field(self, value: Any, format_spec: str) -> str:
        for unit, factor, name in (("%", 1e2, " %"), ("mm", 1e3, " mm"), ("M", 1e-6, "")):
            if format_spec.endswith(unit):
                return f"{factor * value:{format_spec.removesuffix(unit)}f}{name}"
        return super().format_field(value, format_spec)

    def holds(self, condition: str, report: Report) -> bool:
        """Whether a figure is true, or is in a relation to a number or to another figure."""
        field, *relation = condition.rsplit(" ", 2)
        value = self.get_field(field, (), report)[0]
        if not relation:
            return bool(value)
        number = re.fullmatch(r"[\d.]+", relation[1])
        limit = float(number[0]) if number else self.get_field(relation[1], (), report)[0]
        return _RELATIONS[relation[0]](value, limit)


def claim_rows(reports: Reports, only: str = "") -> Iterator[list[str]]:
    """Rows of the table of claims, of all reports or of one; missed targets are marked."""
    figures = Figures()
    for line in CLAIMS.read_text(encoding="utf-8").splitlines():
        if not line.startswith("| ") or line.startswith(("| claim |", "| --- |")):
            continue
        claim, section, text, target, conditions, name = line.strip("| ").split(" | ")
        if name != (only or name):
            continue
        text, target = (figures.vformat(part, (), reports[name]) for part in (text, target))
        met = conditions == "–" or all(figures.holds(condition, reports[name])
                                       for condition in conditions.split(", "))
        settled = "" if name in COMMANDS or name in FILES else " §"
        yield [f"[{claim}](#{slug(section)})", text, target if met else f"{target}: {MISSED}",
               f"`{COMMANDS.get(name, name)}`{settled}"]


def claims(reports: Reports) -> str:
    """Table of claims."""
    return markdown(["claim", "figure", "target", "study"], claim_rows(reports))


def slug(title: str) -> str:
    """Anchor that GitHub gives a heading."""
    return re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-")
