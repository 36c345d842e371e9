"""Figures of the documentation from the reports: ``python -m experiments.figures``.

In README.md and docs/*.md, the text between ``<!-- figures: NAME -->`` and ``<!-- end -->`` is
replaced by the block NAME of :data:`BLOCKS`, made from docs/validation/*.json. A test compares
pages and reports; ``make docs`` updates the pages. An experiment prints its claims and its block.
"""

import json
import operator
import re
from collections.abc import Callable, Iterable, Iterator
from math import exp, sqrt
from pathlib import Path
from string import Formatter
from typing import Any

from common.command import run_command
from common.errors import InputError
from common.files import replace_file
from drapenet.network.checkpoint import read_header
from experiments.estimation.refine_views import METHODS
from experiments.result import REPORTS, ROOT, Report, read_report, table

PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
CLAIMS = Path(__file__).with_name("claims.md")
MARK = re.compile(r"(<!-- figures: (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)
RIGS = {"squares": "square300_cylinder100", "discs": "disc300_support180"}
COMMANDS = {
    "evaluation": "drapenet.network.evaluate",
    "refine_views_real": "experiments refine_views variation=real "
                         "out=docs/validation/refine_views_real.json"}
"""Commands of reports with another name."""
FOUR_VIEWS = "depth, 4 views"
"""The condition of the claims; :data:`drapenet.network.evaluate.CELLS` has all."""
MISSED = "**missed**"
"""Mark of a target that is not reached."""
_RELATIONS = {"<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge,
              "==": operator.eq}


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


def coverage_error(found: dict) -> float:
    """How far the coverage of an interval is off, percentage points."""
    return max(abs(share - float(level.strip("%")))
               for level, share in zip(found["inside"], shares_inside(found), strict=True))


def slug(title: str) -> str:
    """Anchor that GitHub gives a heading."""
    return re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-")


def markdown(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Markdown table without aligned columns."""
    lines = [list(head), *rows]
    lines.insert(1, ["---"] * len(lines[0]))
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


# --- Claims -----------------------------------------------------------------------------------


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
        yield [f"[{claim}](#{slug(section)})", text, target if met else f"{target}: {MISSED}",
               f"`{COMMANDS.get(name, f'experiments {name}')}`"]


def strip_coverage(report: Report) -> Report:
    """Largest difference of the coverage of all intervals from their level, points."""
    return {"off": max(abs(share - float(level.strip("%")))
                       for modulus in ("alpha", "beta")
                       for level, share in report["summary"]["all"][modulus]["coverage"].items())}


def strips(report: Report) -> Report:
    """Largest deviations of both kinds of strips, and those of plates by their cells a side."""
    plates = [pair for pairs in report["plates"].values() for pair in pairs]
    return {name: max(abs(row["deviation"]) for row in report[kind])
            for name, kind in (("bent", "nonlinear"), ("cut", "angled"))} | {
            "plates": {str(cells): max(abs(error) for number, error in plates if number == cells)
                       for cells, _ in plates}}


def lowering_cost(report: Report) -> Report:
    """CPU-seconds of a lowered drape more than of one from a ring start."""
    cost = report["cost"]
    return {"more": cost["lowered"]["seconds"] - cost["ring"]["seconds"]}


def outline_folds(report: Report) -> Report:
    """Difference of the number of folds from that of real outlines."""
    flat = report["summary"]["parallel"]["flat"]["all"]
    return {"off": abs(flat["folds"] - flat["folds_real"])}


def render_speed(report: Report) -> Report:
    """Speed of the rasteriser relative to ray casting."""
    speeds = report["views_per_second"]["240x180"]
    return {"ratio": speeds["rasteriser"] / speeds["rays"]}


def evaluated(report: Report) -> Report:
    """Results by kind of specimens, with the coverage and its largest error in points."""
    found = {kind: report["cells"][rig][FOUR_VIEWS] for kind, rig in RIGS.items()}
    return {kind: cell | {"coverage": coverage(cell), "off": coverage_error(cell)}
            for kind, cell in found.items()}


def tree_tables(report: Report) -> Report:
    """Whether the tables of both runs are the same."""
    same = all(report["same_tables"].values())
    return {"same": same, "tables": "the same" if same else "other"}


def detected_faults(report: Report) -> Report:
    """Kinds of faults, the share that is detected, and the share of warnings without fault."""
    found = dict(report["found"])
    sound = found.pop("sound")
    return {"sound": sound, "kinds": len(found), "share": sum(found.values()) / len(found)}


def refined(report: Report) -> Report:
    """Error of the refinement over the network's, and how far its coverage is off."""
    network, last = (report["summary"]["all"][who] for who in (METHODS[0], METHODS[-1]))
    return {"ratio": last["log_alpha"] / network["log_alpha"], "fabrics": last["fabrics"],
            "coverage": coverage(last), "off": coverage_error(last)}


DERIVED: dict[str, Callable[[Report], Report]] = {
    "strips": strips, "strip_photographs": strip_coverage,
    "lowering": lowering_cost, "outlines": outline_folds, "render": render_speed,
    "evaluation": evaluated, "tree": tree_tables, "faults": detected_faults,
    "refine_views": refined, "refine_views_real": refined}
"""Figures of claims that are computed from a report."""


def shown(name: str, report: Report) -> str:
    """The claims and the block of an experiment, from a new report."""
    reports = Reports()
    try:
        reports.add(name, report)
        parts = [f"{claim.partition('](')[0].lstrip('[')}: {text} (target: {target})"
                 for claim, text, target, _ in claim_rows(reports, name)]
        return "\n".join([*parts, BLOCKS[name](reports)] if name in BLOCKS else parts)
    except (KeyError, IndexError, TypeError, ValueError, ZeroDivisionError, StopIteration):
        return "The settings are too small for the claims of the documentation; see the report."


# --- Blocks -----------------------------------------------------------------------------------


def claims(reports: Reports) -> str:
    """Table of claims."""
    return markdown(["claim", "figure", "target", "`python -m …`"], claim_rows(reports))


def demo(reports: Reports) -> str:
    """Joint estimate that ``make demo`` prints last, and a table of true and estimated moduli."""
    printed = (REPORTS / "demo.txt").read_text(encoding="utf-8").rstrip()
    printed = printed[printed.index("joint estimate"):]
    truth = json.loads((ROOT / "examples/captures/twill/truth.json").read_text(encoding="utf-8"))
    rows = []
    for direction, true in truth["moduli"].items():
        alpha, low, high, beta, least, most = re.search(
            rf"^{direction} +(\S+) +(\S+) to (\S+) +(\S+) +(\S+) to (\S+)$", printed,
            re.MULTILINE).groups()
        rows.append([direction, f"{true['alpha_uN_m']:.0f}", f"{alpha} ({low} to {high})",
                     f"{true['beta_nN_m2']:.0f}", f"{beta} ({least} to {most})"])
    known = table(["", "α true, µN·m", "estimate (68 %)", "β true, nN·m²", "estimate (68 %)"], rows)
    shares = {kind: reports.cell(kind)["inside"]["68%"]["each"][3:] for kind in RIGS}
    contained = " and ".join(f"{percent(sum(each) / 3)} ({kind})" for kind, each in shares.items())
    return (f"```\n{printed}\n```\n\n"
            "**The captures of the demo are simulated**, so that the true moduli are known:\n\n"
            f"{known}\n\nA drape says little about β, so its estimate is pulled towards the β/α of "
            f"typical fabrics: the 68 % intervals of β/α contain {contained} of the true values of "
            "unseen fabrics, and one fabric can be missed in several directions at once.")


def views(reports: Reports) -> str:
    """Error of log α by number of views and by number of drapes."""
    cells = {"1 view": "depth, 1 view", "2 views": "depth, 2 views", "4 views": FOUR_VIEWS,
             "8 views": "depth, 8 views", "2 drapes": "depth, sets of 2",
             "4 drapes": "depth, sets of 4"}
    return table(["error of log α", *cells], [
        [kind, *(f"{reports.cell(kind, name)['log_alpha']['rmse'] * spread():.2f}"
                 for name in cells.values())] for kind in RIGS])


def testers(reports: Reports) -> str:
    """Errors of the cantilever estimators."""
    def share(value: float) -> str:
        return f"{value:.0f} %" if value >= 10 else f"{value:.2g} %"

    names = {"noisy": "guided, 0.3 mm noise,", "corrected": "table, corrected"}
    rows = [[" ".join(names.get(word, word) for word in strips.split()),
             *(share(found[name][key]) for name in ("alpha", "beta")
               for key in ("median", "rms", "largest"))]
            for strips, found in reports["testers"]["errors_percent"].items()]
    return table(["strips, estimator", "α: median", "rms", "largest", "β: median", "rms",
                  "largest"], rows)


def strip_photographs(reports: Reports) -> str:
    """Errors of moduli from photographs of strips, and their coverage."""
    return table(
        ["strips", "directions", "curve, mm", "α: median", "9 of 10", "β: median", "9 of 10",
         "α inside 68, 90 %", "β inside"],
        [[name, found["directions"], f"{found['curve_mm']['median']:.2f}",
          *(f"{found[modulus][key]:.2g} %" for modulus in ("alpha", "beta")
            for key in ("median", "quantile_90")),
          *(", ".join(f"{share:.0f}" for share in found[modulus]["coverage"].values())
            for modulus in ("alpha", "beta"))]
         for name, found in reports["strip_photographs"]["summary"].items()])


def default_mesh(reports: Reports) -> str:
    """Displacements of drapes on the default and other meshes from a fine mesh."""
    kinds = reports["default_mesh"]["meshes"]
    rows = []
    for kind, rig in RIGS.items():
        for row in kinds[rig]:
            if kind == "discs" and not row["mesh"].startswith("default"):
                continue
            name = row["mesh"] if row["mesh"].startswith("default") else f"{row['mesh']} mm"
            rows.append([kind, name, *(f"{row[f'{key}_mm']:.2f}"
                                       for key in ("mean", "median", "largest")),
                         f"{row['within_limit']} of {row['same_folds']}",
                         f"{row['mean_cpu_seconds']:.2f}"])
    return table(["specimens", "edges at the rim", "mean, mm", "median", "largest",
                  "within 0.8 mm", "CPU-seconds a drape"], rows)


def cutouts(reports: Reports) -> str:
    """Errors of cut-outs by sensor, medians and worst cases."""
    rows = [[name, f"{found['iou'][1]:.3f}",
             *("{:.2f}, {:.2f}".format(*found[key]) for key in ("across_mm", "tilt_deg",
                                                                "turn_deg", "shift"))]
            for name, found in reports["cutouts"]["summary"].items()
            if name in ("smooth", "paper", "tof")]
    return table(["sensor", "intersection over union, worst",
                  *(f"{what}: median, worst" for what in
                    ("plate's centre, mm", "tilt, °", "turn, °", "log α, standard deviations"))],
                 rows)


def information(reports: Reports) -> str:
    """Posterior bounds by unknown nuisances."""
    rows = [[name.replace("_", " along "), f"{found['log_alpha']:.3f}",
             f"{1e3 * found['beta_over_alpha']:.2f}",
             f"{found['standardised_log_alpha']:.3f}",
             f"{found['standardised_beta_over_alpha']:.3f}"]
            for name, found in reports["information"]["rms"].items()]
    return table(["unknown", "log α", "β/α, mm", "log α, of the spread", "β/α, of the spread"],
                 rows)


def cells(reports: Reports) -> str:
    """Errors and coverage of the network by condition, and errors on all testers."""
    def columns(found: Report) -> list[str]:
        low, high = found["log_alpha"]["interval_95"]
        bound = found["bound"]
        least = f"{bound['log_alpha']:.3f}, {bound['beta_over_alpha']:.2f}" if bound else "–"
        return [f"{found['log_alpha']['rmse']:.3f} ({low:.3f} to {high:.3f})",
                f"{found['beta_over_alpha']['rmse']:.2f}", least, coverage(found)]

    results = reports["evaluation"]["cells"]
    names = list(results[RIGS["squares"]])
    head = ["condition", *(f"{kind}: {what}" for kind in RIGS for what in
                           ("log α / spread (95 %)", "β/α / spread", "bounds", "inside"))]
    return "\n\n".join((
        table(head, [[name, *(cell for kind in RIGS for cell in columns(reports.cell(kind, name)))]
                     for name in names]),
        table(["log α / spread", *(tester.replace("_", " ") for tester in results)],
              [[name, *(f"{found[name]['log_alpha']['rmse']:.3f}" for found in results.values())]
               for name in names])))


def refinement(reports: Reports) -> str:
    """Errors of the network and of the refinement on simulated captures and scans."""
    sets = {"views, no nuisances": reports["refine_views"]["summary"]["all"],
            "views, all nuisances": reports["refine_views_real"]["summary"]["all"],
            "views, all nuisances, other folds":
                reports["refine_views_real"]["summary"]["other folds"],
            "scans, all nuisances": reports["refine_scans"]["summary"]}
    rows = [[name, found[who]["fabrics"], who, f"{found[who]['log_alpha']:.3f}",
             f"{found[who]['log_alpha_median']:.3f}", f"{found[who]['log_alpha_worst_fabric']:.2f}",
             f"{found[who]['beta_over_alpha_mm']:.2f}", coverage(found[who])]
            for name, found in sets.items() for who in METHODS if who in found]
    return table(["captures", "fabrics", "", "log α, rms", "median", "worst fabric", "β/α, mm",
                  "inside"], rows)


def causes(reports: Reports) -> str:
    """Errors of the search in worlds without some nuisances."""
    names = {"all": "all of these", "none": "nothing", "friction": "hysteresis"}
    rows = [[names.get(world, world), found["search"]["fabrics"],
             *(f"{found[who]['log_alpha']:.3f}" for who in METHODS), coverage(found["search"])]
            for world, found in reports["refine_causes"]["summary"].items()]
    return table(["world without", "fabrics", *(f"{who}, log α, rms" for who in METHODS),
                  "inside of the search"], rows)


def additions(reports: Reports) -> str:
    """What each further measurement of a fabric adds to one drape."""
    rows = []
    for name, found in reports["additions"]["rows"].items():
        least = found["bound"]
        rows.append([
            name, f"{found['log_alpha']:.2f}", f"{least['log_alpha']:.2f}" if least else "–",
            f"{found['log_alpha_yarns']:.2f}", f"{found['beta_over_alpha_yarns']:.2f}",
            coverage(found)])
    return table(["measured", "error of α", "smallest possible", "… along warp and weft",
                  "… of β/α along warp and weft", "inside"], rows)


def outlines(reports: Reports) -> str:
    """Folds, radii and spectra of real and simulated outlines at equal drape coefficient."""
    starts = {"flat": "lowered", "curled": "lowered, natural curvature from both faces",
              "specimens": "lowered, nuisances of specimens",
              "fabrics": "lowered, fabrics of the prior with nuisances", "ring": "ring"}
    rows = [[{"parallel": "parallel light", "camera": "camera 0.7 m above"}[reading], label,
             *(f"{found[key]:.{digits}f}" for key, digits in (
                 ("folds_real", 2), ("folds", 2), ("folds_rms", 2), ("deviation_real_mm", 1),
                 ("deviation_mm", 1), ("spectrum", 2)))]
            for reading, each in reports["outlines"]["summary"].items()
            for name, label in starts.items() for found in [each[name]["all"]]]
    return table(["pictures read as", "start", "folds, real", "simulated", "rms difference",
                  "deviation of the radius, mm, real", "simulated",
                  "spectra differ by, deviations"], rows)


def laboratory(reports: Reports) -> str:
    """Drape coefficients and nodes of laboratory fabrics, measured and simulated."""
    rows = [[one["fabric"], one["composition"], one["tester"].replace("_", " "), one["membrane"],
             one["hysteresis"], f"{one['measured']:.1f}",
             f"{one['coefficient']:.1f} ({one['coefficient'] - one['measured']:+.1f})",
             "" if one["nodes_measured"] is None else f"{one['nodes_measured']:.0f}",
             f"{one['nodes']:.1f}"] for one in reports["laboratory"]["fabrics"]]
    return table(["fabric", "", "tester", "stretch and shear", "2HB", "DC measured, %",
                  "simulated", "nodes measured", "simulated"], rows)


def lowering(reports: Reports) -> str:
    """Folds and drape coefficients of lowered drapes, one setting changed at a time."""
    found = reports["lowering"]
    rows = [[row["variant"], *(f"{folds:.1f}, {dc:.1f}" for folds, dc in zip(
        row["folds"], row["coefficients"], strict=True))] for row in found["variants"]]
    return table(["folds, drape coefficient in %",
                  *(f"{alpha:g} µN·m" for alpha in found["settings"]["alphas"])], rows)


def prior(reports: Reports) -> str:
    """Likelihoods and distances of the priors on fitted and unseen fabrics."""
    found = reports["prior"]
    names = {**{f"gmm{k}": f"mixture of {k} normal distributions" for k in (3, 7)},
             **{f"vae{k}": f"VAE-{k}" for k in range(1, 5)}, "gaussian": "one normal distribution"}
    keys = ("log_likelihood_fitted", "log_likelihood_unseen", "wasserstein")
    rows = [[names[name], *("{:.2f} ± {:.2f}".format(*model[key]) for key in keys),
             "{:.2f} ± {:.2f}".format(*found["by_row"][name]["log_likelihood_unseen"])]
            for name, model in found["models"].items() if name in names]
    return table(["model", "fitted fabrics, nats", "unseen fabrics", "Wasserstein distance",
                  "split by row"], rows)


def accuracy(reports: Reports) -> str:
    """List of items: errors, what was compared with real cloth, limits."""
    squares, discs = reports.cell("squares"), reports.cell("discs")

    def errors(name: str) -> str:
        found = [reports.cell(kind, name)["log_alpha"]["rmse"] * spread() for kind in RIGS]
        return " and ".join(f"{percent(exp(error) - 1)} for {kind}"
                            for kind, error in zip(RIGS, found, strict=True))

    drapes = reports["outlines"]["summary"]["parallel"]["flat"]["all"]
    bent = next(iter(reports["laboratory"]["summary"].values()))
    alone, known = reports["outlines_real"]["alone"], reports["numbers"]
    return "\n".join([
        f"- **Simulated fabrics** outside the training set, with the variation of real "
        f"specimens and cameras: the typical error of α is {errors(FOUR_VIEWS)} with four depth "
        f"views, {errors('outline, parallel light')} with an outline. The 68 % intervals contain "
        f"{percent(squares['inside']['68%']['mean'])} and "
        f"{percent(discs['inside']['68%']['mean'])} of the true moduli with four depth views.",
        f"- **Real outlines** ({alone['of']} pictures of nine fabrics with unknown moduli): "
        f"estimates of α from one picture each agree within a factor of {alone['captures']:.2f} "
        f"between pictures of a sample, {alone['samples']:.2f} between samples and "
        f"{alone['faces']:.2f} between faces, in the median. The simulator gives them "
        f"{drapes['folds']:.1f} folds where they have {drapes['folds_real']:.1f}.",
        f"- **Laboratory fabrics**: from drape coefficient and nodes alone, the 90 % interval of "
        f"KES B contains the measured value for {known['inside']} of {known['of']} fabrics; its "
        f"ends differ by a factor of {known['ratio']:.0f}. Simulated drape coefficients of these "
        f"fabrics are off by {bent['rms']:.0f} points rms. No depth capture of a fabric of known "
        f"moduli was at hand ([validation](docs/validation.md#real-cloth)).",
        f"- **Limits**: β/α is poorly constrained by a drape: its error is "
        f"{squares['beta_over_alpha']['rmse']:.2f} (squares) and "
        f"{discs['beta_over_alpha']['rmse']:.2f} (discs) of its spread over fabrics."])


BLOCKS: dict[str, Callable[[Reports], str]] = {
    block.__name__: block for block in (
        demo, accuracy, views, claims, testers, strip_photographs, default_mesh, cutouts,
        information, cells, refinement, causes, additions, prior, outlines, laboratory, lowering)
}


def fill_blocks(text: str) -> str:
    """Replace all blocks of ``text``."""
    reports = Reports()

    def block(mark: re.Match[str]) -> str:
        if mark[2] not in BLOCKS:
            raise InputError(f"figures: {mark[2]} is not a block; known: {', '.join(BLOCKS)}")
        return f"{mark[1]}{BLOCKS[mark[2]](reports)}\n{mark[3]}"

    return MARK.sub(block, text)


def main(argv: list[str]) -> None:
    """Update all pages; print the names of those that changed."""
    if argv in (["-h"], ["--help"]):
        print(__doc__)
        return
    if argv:
        raise InputError(f"{' '.join(argv)}: this command takes no settings")
    for page in PAGES:
        old = page.read_text(encoding="utf-8")
        if (new := fill_blocks(old)) != old:
            replace_file(page, new.encode())
            print(page.relative_to(ROOT))


if __name__ == "__main__":
    run_command(main)
