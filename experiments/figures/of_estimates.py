"""Blocks about estimates: the demo, the network, its accuracy and bounds, refinement, priors."""

import json

from experiments.figures.reports import (
    FOUR_VIEWS,
    KINDS,
    OUTLINE,
    RIGS,
    Reports,
    coverage,
    percent,
    spread,
)
from experiments.report import REPORTS, ROOT, Report, table


def demo(reports: Reports) -> str:
    """The moduli that ``make demo`` prints last, and the true ones."""
    printed = (REPORTS / "demo.txt").read_text(encoding="utf-8").rstrip()
    lines = printed[printed.index("joint estimate"):].splitlines()
    truth = json.loads((ROOT / "examples/captures/twill/truth.json").read_text(encoding="utf-8"))
    alpha, beta = (", ".join(f"{true[key]:.0f}" for true in truth["moduli"].values())
                   for key in ("alpha_uN_m", "beta_nN_m2"))
    shares = {kind: reports.cell(kind)["inside"]["68%"]["each"][3:] for kind in KINDS}
    contained = " and ".join(f"{percent(sum(each) / 3)} ({kind})" for kind, each in shares.items())
    shown = "\n".join([*lines[:6], "…", *lines[-2:]])
    return (f"```\n{shown}\n```\n\n"
            f"**These captures are simulated**: the true α are {alpha} µN·m, the true β {beta} "
            "nN·m². A drape says little about β, so its estimate is pulled towards the β/α of "
            f"typical fabrics: 68 % intervals of β/α contain {contained} of the true values, and "
            "one fabric can be missed in several directions at once.")


def fifteen_minutes(reports: Reports) -> str:
    """What the estimate of docs/fifteen_minutes.md prints last."""
    printed = (REPORTS / "fifteen_minutes.txt").read_text(encoding="utf-8").rstrip()
    lines = printed[printed.rindex("joint estimate"):].splitlines()
    strips = [line for line in lines if line.startswith("by strips")]
    return "\n".join(["```", *lines[:6], "…", *strips, "…", *lines[-3:], "```"])


def accuracy(reports: Reports) -> str:
    """Errors of single captures and of sets, and items: real cloth, limits."""
    squares = reports.cell("squares")
    discs = reports.cell("discs")
    names = {"four depth views": FOUR_VIEWS, "an outline": OUTLINE,
             "outlines of four drapes": "outline, sets of 4",
             "drape coefficient and nodes alone": "drape coefficient and nodes"}
    rows = [[f"{kind[:-1]} of 300 mm, {what}", *_off(reports.cell(kind, name)),
             coverage(reports.cell(kind, name))]
            for what, name in names.items() for kind in ("discs", "squares")]
    drapes = reports["outlines"]["summary"]["parallel"]["flat"]
    bent = next(iter(reports["laboratory"]["summary"].values()))
    alone = reports["outlines_real"]["alone"]
    known = reports["numbers"]
    return "\n".join([
        table(["fabrics never shown, simulated with the variation of real specimens and cameras",
               "α off by, half of them", "nine of ten", "inside 50, 68, 90 %"], rows), "",
        f"- **Real outlines** ({alone['of']} pictures of nine fabrics with unknown moduli): "
        f"estimates of α from one picture each agree within a factor of {alone['captures']:.2f} "
        f"between pictures of a sample, {alone['samples']:.2f} between samples and "
        f"{alone['faces']:.2f} between faces, in the median. The simulator gives them "
        f"{drapes['folds']:.1f} folds where they have {drapes['folds_real']:.1f}.",
        f"- **Laboratory fabrics**: from drape coefficient and nodes alone, the 90 % interval of "
        f"KES B contains the measured value for {known['inside']} of {known['of']} fabrics; its "
        f"ends differ by a factor of {known['ratio']:.0f}. Their simulated drape coefficients are "
        f"off by {bent['rms']:.0f} points rms. No depth capture of a fabric of known moduli was at "
        "hand ([validation](docs/validation.md#real-cloth)).",
        f"- **Limits**: β/α is poorly constrained by a drape: its error is "
        f"{squares['beta_over_alpha']['rmse']:.2f} (squares) and "
        f"{discs['beta_over_alpha']['rmse']:.2f} (discs) of its spread over fabrics."])


def _off(found: Report) -> list[str]:
    """Median and ninth decile of the error of α."""
    return [percent(found["alpha"][key]) for key in ("median", "ninth_decile")]


def _shares(found: Report) -> str:
    """The same in percent."""
    return ", ".join(_off(found)).replace(" %", "")


def _judged(found: Report) -> str:
    """The same, and coverage."""
    return f"{_shares(found)}; {coverage(found)}".removesuffix(" %")


def bands(reports: Reports) -> str:
    """Errors and coverage of single captures by drape coefficient, stiffness and cloth."""
    found = reports["evaluation"]["bands"]
    names = [name for name in found if name != "drape coefficient and nodes"]
    return "\n\n".join(
        table([f"{kind}; α off by, %: median, 9 of 10; inside 50, 68, 90 %", *names],
              [[label, *(_judged(found[name][kind][label]) for name in names)]
               for label in found[names[0]][kind]])
        for kind in found[names[0]])


def views_and_drapes(reports: Reports) -> str:
    """Error of log α by number of views and by number of drapes."""
    cells = {"1 view": "depth, 1 view", "2 views": "depth, 2 views", "4 views": FOUR_VIEWS,
             "8 views": "depth, 8 views", "2 drapes": "depth, sets of 2",
             "4 drapes": "depth, sets of 4"}
    return table(["error of log α", *cells], [
        [kind, *(f"{reports.cell(kind, name)['log_alpha']['rmse'] * spread():.2f}"
                 for name in cells.values())] for kind in KINDS])


def photographed(reports: Reports) -> str:
    """What to expect of a phone's picture."""
    one = next(iter(reports["mats"]["summary"].values()))
    half, most = map(percent, one["truth_error"])
    return ("From one picture by a phone over the printed mat, as it is read, half of the "
            f"estimates of α are within {half} of the truth, nine of ten within {most} (simulated "
            f"fabrics, evenly from limp to stiff, most hems hard to see); 68 % intervals contain "
            f"{percent(one['inside_68'])} of the true values.")


def cells(reports: Reports) -> str:
    """Errors and coverage of the network by condition."""
    kinds = (*KINDS, "tin")
    return table(["α off by, %: median, 9 of 10; inside 50, 68, 90 %", *kinds], [
        [name, *(_judged(reports.cell(kind, name)) for kind in kinds)]
        for name in reports["evaluation"]["cells"][RIGS["squares"]]])


def refinement(reports: Reports) -> str:
    """Errors of the network and of the refinement on simulated captures and scans."""
    sets = {"views, no nuisances": "refine_views", "views, all nuisances": "refine_views_real",
            "scans, all nuisances": "refine_scans"}
    rows = [[name, found[who]["fabrics"], who, f"{found[who]['log_alpha']:.3f}",
             f"{found[who]['log_alpha_median']:.3f}", f"{found[who]['log_alpha_worst_fabric']:.2f}",
             f"{found[who]['beta_over_alpha_mm']:.2f}", coverage(found[who])]
            for name, report in sets.items() for found in [reports[report]["summary"]["all"]]
            for who in ("network", "refined")]
    return table(["captures", "fabrics", "", "log α, rms", "median", "worst fabric", "β/α, mm",
                  "inside"], rows)
