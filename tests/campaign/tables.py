"""The tables of a campaign's report."""

from pathlib import Path
from typing import Any

from cases import FINDINGS

from common.files import replace_file
from experiments.result import table

BEGIN, END = "<!-- campaign -->\n", "\n<!-- end of campaign -->"
KILLS = {"kills": "SIGKILL: datasets, one to four processes",
         "pool_kills": "SIGKILL: datasets, worker processes",
         "training_kills": "SIGKILL: trainings"}


def describe(content: dict[str, Any]) -> str:
    """The tables of a report."""
    rows = [[name, found["cases"], *(found["outcomes"].get(kind, 0)
                                     for kind in ("accepted", "refused")),
             sum(found["outcomes"].get(kind, 0) for kind in FINDINGS),
             f"{found['most_seconds']:.2f}", f"{found['most_megabytes']:.0f}"]
            for name, found in content["readers"].items()]
    text = table(["reader", "damaged", "accepted", "refused", "findings", "longest [s]",
                  "most memory [MB]"], rows)
    rows = [[KILLS[name], found["kills"], found["runs"], found["same"]]
            for name, found in content["kills"].items()]
    rows += [[f"dataset: {name}", found["cases"], found["cases"],
              found["cases"] - sum(found["wrong"].values())]
             for name, found in content["accidents"].items()]
    return text + "\n\n" + table(["accident", "number", "runs", "correct result"], rows)


def place(content: dict[str, Any], page: Path) -> None:
    """Put the tables where the page ``page`` has those of an earlier report."""
    before, _, rest = page.read_text(encoding="utf-8").partition(BEGIN)
    replace_file(page, f"{before}{BEGIN}{describe(content)}{END}{rest.partition(END)[2]}".encode())
