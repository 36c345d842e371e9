"""Blocks about estimates: the demo, the network, its accuracy and bounds, refinement, priors."""

import json
import re

from experiments.estimation.refine_views import METHODS
from experiments.figures.reports import (
    FOUR_VIEWS,
    OUTLINE,
    RIGS,
    Reports,
    coverage,
    percent,
    spread,
)
from experiments.result import REPORTS, ROOT, Report, table


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


def accuracy(reports: Reports) -> str:
    """Errors of single captures and of sets, and items: real cloth, limits."""
    squares, discs = reports.cell("squares"), reports.cell("discs")
    names = {"four depth views": FOUR_VIEWS, "an outline": OUTLINE,
             "outlines of four drapes": "outline, sets of 4",
             "drape coefficient and nodes alone": "drape coefficient and nodes"}
    rows = [[f"{kind[:-1]} of 300 mm, {what}", *_off(reports.cell(kind, name)),
             coverage(reports.cell(kind, name))]
            for what, name in names.items() for kind in ("discs", "squares")]
    drapes = reports["outlines"]["summary"]["parallel"]["flat"]["all"]
    bent = next(iter(reports["laboratory"]["summary"].values()))
    alone, known = reports["outlines_real"]["alone"], reports["numbers"]
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
        f"ends differ by a factor of {known['ratio']:.0f}. Simulated drape coefficients of these "
        f"fabrics are off by {bent['rms']:.0f} points rms. No depth capture of a fabric of known "
        f"moduli was at hand ([validation](docs/validation.md#real-cloth)).",
        f"- **Limits**: β/α is poorly constrained by a drape: its error is "
        f"{squares['beta_over_alpha']['rmse']:.2f} (squares) and "
        f"{discs['beta_over_alpha']['rmse']:.2f} (discs) of its spread over fabrics."])


def _off(found: Report) -> list[str]:
    """Median and ninth decile of the error of α."""
    return [percent(found["alpha"][key]) for key in ("median", "ninth_decile")]


def bands(reports: Reports) -> str:
    """Errors and coverage of single captures by drape coefficient and by stiffness."""
    found = reports["evaluation"]["bands"]
    names = [name for name in found if name != "drape coefficient and nodes"]
    return "\n\n".join(
        table([kind, "fabrics", *(f"{name}: {what}" for name in names for what in
                                  ("α off by, median", "9 of 10", "inside"))],
              [[label, min(found[name][kind][label]["fabrics"] for name in names
                           if label in found[name][kind]),
                *(cell for name in names for cell in
                  ([*_off(found[name][kind][label]), coverage(found[name][kind][label])]
                   if label in found[name][kind] else ["–"] * 3))]
               for label in found[names[0]][kind]])
        for kind in ("drape coefficient", "stiffness"))


def views(reports: Reports) -> str:
    """Error of log α by number of views and by number of drapes."""
    cells = {"1 view": "depth, 1 view", "2 views": "depth, 2 views", "4 views": FOUR_VIEWS,
             "8 views": "depth, 8 views", "2 drapes": "depth, sets of 2",
             "4 drapes": "depth, sets of 4"}
    return table(["error of log α", *cells], [
        [kind, *(f"{reports.cell(kind, name)['log_alpha']['rmse'] * spread():.2f}"
                 for name in cells.values())] for kind in RIGS])


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


def mats(reports: Reports) -> str:
    """Errors of photographs over the mat, by tester and by the camera's place."""
    return table(
        ["photographs", "number", "refused", "with a warning", "outline as seen, mm: median",
         "9 of 10", "from the axis: median", "9 of 10", "camera height: median", "α: median",
         "9 of 10", "α off by 15 %, no warning"],
        [[name, f"{found['photographs']}", f"{found['refused']}", f"{found['warned']}",
          *(f"{error:.2f}" for key in ("reading_mm", "outline_mm") for error in found[key]),
          f"{found['height_error'][0]:.1%}", *(f"{error:.1%}" for error in found["alpha"]),
          f"{found['wrong_in_silence']}"]
         for name, found in reports["mats"]["summary"].items()])


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
        return [", ".join(_off(found)),
                f"{found['log_alpha']['rmse']:.3f} ({low:.3f} to {high:.3f})",
                f"{found['beta_over_alpha']['rmse']:.2f}", least, coverage(found)]

    results = reports["evaluation"]["cells"]
    names = list(results[RIGS["squares"]])
    head = ["condition", *(f"{kind}: {what}" for kind in RIGS for what in
                           ("α off by, median, 9 of 10", "log α / spread (95 %)",
                            "β/α / spread", "bounds", "inside"))]
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
