"""Reports with figures that are computed from them, and numbers as the pages state them."""

from collections.abc import Callable
from math import sqrt

from drapenet.network.checkpoint import read_header
from experiments.report import Report, read_report

RIGS = {"squares": "square300_cylinder100", "discs": "disc300_support180",
        "wide": "disc360_support180", "tin": "disc254_support127"}
KINDS = ("squares", "discs")
"""Those of most tables."""
FOUR_VIEWS, OUTLINE = "depth, 4 views", "outline, parallel light"
"""Conditions of the claims; :data:`drapenet.network.evaluate.CELLS` has all."""


class Reports(dict[str, Report]):
    """Reports by name of the experiment, read when used, with the figures of :data:`DERIVED`."""

    def __missing__(self, name: str) -> Report:
        return self.add(name, read_report(name))

    def add(self, name: str, report: Report) -> Report:
        """Use this report in place of a stored one."""
        derived = DERIVED.get(name)
        self[name] = report | derived(report) if derived else report
        return self[name]

    def cell(self, kind: str, name: str = FOUR_VIEWS) -> Report:
        """Evaluation of the network for ``kind`` of specimens under the condition ``name``."""
        return self["evaluation"]["cells"][RIGS[kind]][name]


def spread() -> float:
    """Root mean square over directions of the standard deviation of log α over fabrics."""
    return sqrt(sum(one**2 for one in read_header().spread[:3]) / 3)


def percent(value: float, digits: int = 0) -> str:
    """A share as a percentage with ``digits`` decimals."""
    return f"{100 * value:.{digits}f} %"


def shares_inside(found: dict) -> list[float]:
    """Percentages of true values inside the 50, 68 and 90 % intervals."""
    return [100 * (one["mean"] if isinstance(one, dict) else one)
            for one in found["inside"].values()]


def coverage(found: dict) -> str:
    """Coverage of the 50, 68 and 90 % intervals, for a table."""
    return "{:.0f}, {:.0f}, {:.0f} %".format(*shares_inside(found))


def coverage_error(found: dict) -> tuple[float, float]:
    """How far the coverage of an interval is off, and its standard error, percentage points."""
    errors = [100 * one.get("error", 0) if isinstance(one, dict) else 0
              for one in found["inside"].values()]
    return max((abs(share - float(level.strip("%"))), error) for level, share, error in
               zip(found["inside"], shares_inside(found), errors, strict=True))


def strip_coverage(report: Report) -> Report:
    """Largest difference of the coverage of all intervals from their level, points."""
    return {"off": max(abs(share - float(level.strip("%")))
                       for modulus in ("alpha", "beta")
                       for level, share in report["summary"]["all"][modulus]["coverage"].items())}


def outline_folds(report: Report) -> Report:
    """Difference of the number of folds from that of real outlines."""
    flat = report["summary"]["parallel"]["flat"]
    bands = [band for band in report["summary"]["parallel"]["learned"]["bands"].values()
             if band["faces"]]
    return {"off": abs(flat["folds"] - flat["folds_real"]),
            "learned": max(abs(band["folds"] - band["folds_real"]) for band in bands),
            "limp": bands[0], "stiff": bands[1]}


def evaluated(report: Report) -> Report:
    """Results by kind of specimens and captures, and how far the coverage of single captures is off
    in the worst band of coefficient, stiffness or cloth, points."""
    kinds = {"depth": FOUR_VIEWS, "outline": OUTLINE, "views of four": "depth, sets of 4",
             "outlines of four": "outline, sets of 4"}
    bands = [band for name in (FOUR_VIEWS, OUTLINE)
             for bands in report.get("bands", {}).get(name, {}).values()
             for band in bands.values()]
    return {rig: {kind: report["cells"][tester][name] | {"coverage": coverage(
        report["cells"][tester][name])} for kind, name in kinds.items()}
        for rig, tester in RIGS.items() if tester in report["cells"]} | dict(zip(
            ("off", "off_error"), max(map(coverage_error, bands), default=(None, 0)), strict=True))


def detected_faults(report: Report) -> Report:
    """Kinds of faults, the share that is detected, and the share of warnings without fault."""
    found = dict(report["found"])
    sound = found.pop("sound")
    return {"sound": sound, "kinds": len(found), "share": sum(found.values()) / len(found)}


def refined(report: Report) -> Report:
    """Error of the refinement over the network's, and how far its coverage is off."""
    network, last = (report["summary"]["all"][who] for who in ("network", "refined"))
    return {"ratio": last["log_alpha"] / network["log_alpha"], "fabrics": last["fabrics"],
            "coverage": coverage(last), "off": coverage_error(last)[0]}


DERIVED: dict[str, Callable[[Report], Report]] = {
    "strip_photographs": strip_coverage,
    "outlines": outline_folds,
    "evaluation": evaluated,
    "evaluation_flat": evaluated,
    "faults": detected_faults,
    "refine_views": refined,
    "refine_views_real": refined,
    "refine_scans": refined}
"""Figures of claims that are computed from a report."""
