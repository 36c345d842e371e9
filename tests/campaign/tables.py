"""The tables of a campaign's report."""

from typing import Any

from cases import FINDINGS

from benchmarks.common import table


def describe(content: dict[str, Any]) -> str:
    """The tables of a report."""
    rows = [[name, found["cases"], *(found["outcomes"].get(kind, 0)
                                     for kind in ("accepted", "refused")),
             sum(found["outcomes"].get(kind, 0) for kind in FINDINGS),
             f"{found['most_seconds']:.1f}", f"{found['most_megabytes']:.0f}"]
            for name, found in content["readers"].items()]
    text = table(["reader", "damaged", "accepted", "refused", "findings", "longest [s]",
                  "most memory [MB]"], rows)
    rows = [[name.replace("_", " "), found["kills"], found["runs"], found["same"]]
            for name, found in content["kills"].items()]
    text += "\n\n" + table(["SIGKILLs", "number", "runs", "with the bytes of one in peace"], rows)
    rows = [[name, found["cases"], found["cases"] - sum(found["wrong"].values())]
            for name, found in content["accidents"].items()]
    return text + "\n\n" + table(["accident to a dataset", "cases", "right"], rows)
