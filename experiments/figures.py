"""Write the figures of the documentation from the reports: ``python -m experiments.figures``.

In README.md and docs/*.md, the text between ``<!-- figures: NAME -->`` and ``<!-- end -->`` is
replaced by the block NAME of :data:`BLOCKS`, made from docs/validation/*.json. A test compares
pages and reports; ``make docs`` updates the pages.
"""

import json
import re
from collections.abc import Callable, Iterable
from functools import cache
from math import exp, sqrt

from common.cli import run_command
from common.errors import InputError
from common.files import replace_file
from drapenet.network.checkpoint import bundled, read_header
from experiments.result import REPORTS, ROOT, read_report, table
from sim.rig import Rig

PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
MARK = re.compile(r"(<!-- figures: (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)
RIGS = {"squares": "square300_cylinder100", "discs": "disc300_support180"}
MISSED = "**missed**"
"""Mark of a target that is not reached."""


report = cache(read_report)


def cell(kind: str, name: str = "as trained") -> dict:
    """Evaluation of the network for ``kind`` of specimens under the condition ``name``."""
    return report(f"evaluation_{RIGS[kind]}")["cells"].get(name)


def spread(kind: str) -> float:
    """Root mean square over directions of the standard deviation of log α over fabrics."""
    std = read_header(bundled(Rig.from_name(RIGS[kind]))).scale.std[:3]
    return sqrt(sum(one**2 for one in std) / 3)


def percent(value: float, digits: int = 0) -> str:
    """A share as a percentage with ``digits`` decimals."""
    return f"{100 * value:.{digits}f} %"


def coverage(found: dict) -> str:
    """Coverage of the 50, 68 and 90 % intervals, for a table."""
    shares = [one["mean"] if isinstance(one, dict) else one for one in found["inside"].values()]
    return "{:.0f}, {:.0f}, {:.0f} %".format(*(100 * share for share in shares))


def slug(title: str) -> str:
    """Anchor that GitHub gives a heading."""
    return re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-")


def markdown(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Markdown table without aligned columns."""
    lines = [list(head), *rows]
    lines.insert(1, ["---"] * len(lines[0]))
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def claims() -> str:
    """Table of claims; missed targets are marked."""
    rows: list[list[str]] = []

    def add(claim: str, section: str, figure: str, target: str, command: str, *,
            met: bool = True) -> None:
        module = "" if command.startswith("drapenet.") else "experiments "
        rows.append([f"[{claim}](#{slug(section)})", figure,
                     target if met else f"{target}: {MISSED}", f"`{module}{command}`"])

    found = report("elastica")
    add("Hanging strips have the shape of the elastica", "Strips against the heavy elastica",
        f"ratio of drop to reach within {percent(found['largest_deviation'], 2)} for Γ from 0.1 to "
        "1000, on four triangulations", "0.5 %", "elastica", met=found["passed"])

    found = report("strips")
    bent = max(abs(row["deviation"]) for row in found["nonlinear"])
    cut = max(abs(row["deviation"]) for row in found["angled"])
    add("… also with quadratic moduli and off-axis",
        "Non-linear and anisotropic strips, and plates",
        f"{percent(bent, 2)} (non-linear); {percent(cut, 2)} of the modulus at five angles",
        "1 %; 2 %", "strips", met=bent < 0.01 and cut < 0.02)
    rates = found["plate_rates"].values()
    add("The element converges to plate theory", "Non-linear and anisotropic strips, and plates",
        f"order {min(rates):.1f} to {max(rates):.1f} on three plates", "2", "strips",
        met=min(rates) > 1.9)

    found = report("testers")["errors_percent"]["guided regression"]
    worst = [found[name]["largest"] for name in ("alpha", "beta")]
    add("Cantilever estimators recover the moduli of guided strips", "Cantilever estimators",
        f"α within {worst[0]:.1f} %, β within {worst[1]:.1f} % in {found['alpha']['readings']} of "
        "60 directions", "2 %; 10 %", "testers", met=worst[0] <= 2 and worst[1] <= 10)

    found = report("meshes")
    midedge, hinge = (found["summary"][law]["largest_mean_mm"] for law in ("midedge", "hinge"))
    add("On fine meshes a drape does not depend on the mesh †", "Mesh independence",
        f"three kinds of meshes agree within {midedge:.2f} mm (hinge model {hinge:.1f} mm)",
        f"{found['limit_mm']} mm", "meshes", met=found["passed"])

    found = report("default_mesh")
    free, placed = found["meshes"][RIGS["squares"]][:2]
    add("The default mesh is close to a fine one", "The default mesh",
        f"{free['mean_mm']:.2f} mm as draped, {placed['mean_mm']:.2f} mm in the fine mesh's "
        "minimum", f"{found['limit_mm']} mm as draped", "default_mesh",
        met=free["mean_mm"] <= found["limit_mm"])

    found = report("convergence")
    drapes = found["all"]
    deepest = drapes["deepest_entry_of_accepted_mm"]
    add("Drapes converge", "Convergence",
        f"{percent(drapes['share_reached'], 1)} of {drapes['drapes']}, "
        f"{drapes['accepted_that_intersect_themselves']} intersect themselves, at most "
        f"{deepest:.3f} mm inside the cylinder", "99 %; 0; 0.2 mm", "convergence",
        met=found["passed"])

    found = report("speed")["default"]
    mean, median = found["mean_cpu_seconds"], found["median_cpu_seconds"]
    add("A drape from `sine` costs one to two CPU-seconds", "Speed",
        f"mean {mean:.2f}, median {median:.2f} (the paper's took 19.8 on other hardware)",
        "1.2; 1.0", "speed", met=mean <= 1.2 and median <= 1.0)

    cost = report("lowering")["cost"]
    more = cost["lowered"]["seconds"] - cost["ring"]["seconds"]
    add("A lowered drape costs little more than a `ring` one", "Real cloth",
        f"{more:+.2f} CPU-seconds (means of 32: {cost['lowered']['seconds']:.2f} and "
        f"{cost['ring']['seconds']:.2f})", "0.7", "lowering", met=more <= 0.7)

    found = report("outlines")["summary"]["parallel"]
    plain, fabrics, ring = (found[name]["all"] for name in ("flat", "fabrics", "ring"))
    off = abs(plain["folds"] - plain["folds_real"])
    add("Lowered drapes have the folds of real outlines", "Real cloth",
        f"{plain['folds']:.2f} folds where nine fabrics have {plain['folds_real']:.2f} (ring start "
        f"{ring['folds']:.2f})", "within 0.4", "outlines", met=off <= 0.4)
    add("… and their spectra", "Real cloth",
        f"differ by {plain['spectrum']:.2f} deviations of repeats for isotropic cloth, "
        f"{fabrics['spectrum']:.2f} for fabrics of the prior", "1 for isotropic cloth", "outlines",
        met=plain["spectrum"] <= 1)
    found = next(iter(report("laboratory")["summary"].values()))
    add("Laboratory fabrics with measured hysteresis drape as measured", "Real cloth",
        f"drape coefficient off by {found['rms_hysteresis']:.1f} points rms (four fabrics), all "
        f"ten {found['rms']:.1f}, rank correlation {found['rank']:.2f}", "8 points", "laboratory",
        met=found["rms_hysteresis"] <= 8)

    worst = report("membranes")["scaling_worst_mm"]
    add("A drape depends on moduli over density alone", "Membrane",
        f"{worst:.0e} mm, if the membrane scales as well", "0.01 mm", "membranes",
        met=worst < 0.01)

    found = report("sensitivity")
    cost = found["share_of_the_drape"]["backward"]["largest"]
    add("Derivatives of a drape are right", "Derivatives of a drape",
        "forward {:.1e}, adjoint {:.1e} from central differences; backward pass at most "
        "{} of a drape".format(*found["worst"].values(), percent(cost, 1)), "1e-3; 15 %",
        "sensitivity", met=found["passed"])

    found = report("throughput")
    add("Two cores double the throughput †", "Speed",
        f"{found['ratio']:.2f} times; {found['ratio_from_their_start']:.2f} with the start of the "
        "processes", "2", "throughput", met=found["ratio_from_their_start"] >= 2)

    agreement = report("render")["agreement"]["rasteriser"]
    speeds = report("render")["views_per_second"]["240x180"]
    add("The rasteriser agrees with ray casting †", "Rendering",
        f"{agreement['silhouette_pixels_that_differ']} of "
        f"{1e-6 * agreement['cloth_pixels']:.1f} million pixels differ, depth within "
        f"{agreement['largest_mm']:.3f} mm; {speeds['rasteriser'] / speeds['rays']:.1f} times as "
        "fast", "1 pixel; 0.05 mm", "render", met=agreement["largest_mm"] < 0.05)

    bounds = report("information")["rms"]
    bound = bounds["all nuisances unknown"]
    ideal = bounds["no nuisances"]
    add("Smallest possible error with four views of a drape", "What a drape determines",
        f"log α to {ideal['log_alpha']:.2f} and β/α to {1e3 * ideal['beta_over_alpha']:.1f} mm "
        f"without nuisances; {bound['log_alpha']:.2f} and {1e3 * bound['beta_over_alpha']:.1f} mm "
        "with all unknown", "–", "information")

    for kind in RIGS:
        found = cell(kind)
        error, ratio = found["log_alpha"]["rmse"], found["beta_over_alpha"]["rmse"]
        low, high = found["log_alpha"]["interval_95"]
        limit = {"squares": 0.84, "discs": None}[kind]
        add(f"The network's error on unseen {kind}", "The estimator",
            f"log α {error:.3f} ({low:.3f} to {high:.3f}) and β/α {ratio:.2f} of the spread",
            f"β/α {limit}" if limit else "–", f"drapenet.network.evaluate rig={RIGS[kind]}",
            met=limit is None or ratio <= limit)
        off = max(abs(100 * one["mean"] - float(level.strip("%")))
                  for level, one in found["inside"].items())
        add(f"… and the coverage of its 50, 68 and 90 % intervals ({kind})", "The estimator",
            coverage(found), "3 points", f"drapenet.network.evaluate rig={RIGS[kind]}",
            met=off <= 3)

    found = report("tree")
    same = all(found["same_tables"].values())
    add("A killed run of many captures gives the same tables", "Whole scenes and faulty captures",
        f"{found['captures']} simulated captures in one command, {found['failures']} failures, "
        f"killed twice with {'the same' if same else 'other'} tables", "the same", "tree", met=same)

    found = report("cutouts")["summary"]["all"]
    add("Cloth is cut out of whole scenes", "Whole scenes and faulty captures",
        "intersection over union {:.3f}, worst {:.3f}; plate within {:.1f} mm (worst {:.1f}), "
        "tilt {:.2f}° ({:.2f}), turns {:.2f}° ({:.1f})".format(
            *found["iou"], *found["across_mm"], *found["tilt_deg"], *found["turn_deg"]),
        "0.985, 0.96; worst 1.5 mm, 0.3°, 0.7°", "cutouts",
        met=found["across_mm"][1] <= 1.5 and found["tilt_deg"][1] <= 0.3)

    found = dict(report("faults")["found"])
    sound = found.pop("sound")
    share = sum(found.values()) / len(found)
    add("Faults of captures are detected", "Whole scenes and faulty captures",
        f"{percent(share, 1)} of {len(found)} kinds corrected, refused or reported; "
        f"{percent(sound)} of sound captures have a warning", "95 %; 2 %", "faults",
        met=share >= 0.95 and sound <= 0.02)

    for name, text, words in (
            ("refine_views", "without", ""),
            ("refine_views_real", "with",
             " variation=real out=docs/validation/refine_views_real.json")):
        before, after = (report(name)["summary"]["all"][who] for who in ("network", "refined"))
        worst = after["log_alpha_worst_fabric"]
        met = round(after["log_alpha"], 2) <= 0.10 and worst <= 0.35
        add(f"Refinement of views {text} nuisances", "Refinement",
            f"error of log α {after['log_alpha']:.3f} (network {before['log_alpha']:.3f}), worst "
            f"fabric {worst:.2f}", "0.10; 0.35", f"refine_views{words}", met=met)
    found = report("refine_scans")
    before, after = (found["summary"][who]["log_alpha"] for who in ("network", "refined"))
    add("Refinement of simulated scans with nuisances", "Refinement",
        f"error of log α {after:.3f} (network {before:.3f}); {found['mean_away_mm']:.1f} mm from "
        "the scan", "–", "refine_scans")
    found = report("repeats")["summary"]
    add("Repeated drapes of one fabric", "Repeated drapes",
        "error of log α {:.3f}, {:.3f}, {:.3f} with 1, 2, 5 captures (bound {:.3f}, {:.3f}, "
        "{:.3f}); inside with 5: {}".format(
            *(found[n][key] for key in ("log_alpha", "bound") for n in "125"),
            coverage(found["5"])),
        "0.081 with 5", "repeats", met=found["5"]["log_alpha"] <= 1.2 * 0.081)

    found = report("service")
    many, bad = found["many_at_once"], found["malformed"]
    add("The service handles simultaneous and malformed requests", "The service",
        f"{many['with_their_own_result']} of {many['uploads']} simultaneous uploads answered with "
        f"their own result; {bad['requests']} malformed requests, {bad['tracebacks']} tracebacks, "
        f"answers within {bad['longest_seconds']:.0f} s", "all; 0; 10 s", "service",
        met=many["with_their_own_result"] == many["uploads"] and not bad["tracebacks"])

    found = report("prior")["models"]
    vae, mixture = (found[name]["log_likelihood_unseen"] for name in ("vae4", "gmm3"))
    add("The prior describes unseen fabrics", "The fabric prior",
        "VAE-4 {:.2f} ± {:.2f} nats, best mixture {:.2f} ± {:.2f}".format(*vae, *mixture),
        "not below the mixture", "prior", met=vae[0] >= mixture[0])
    return markdown(["claim", "figure", "target", "`python -m …`"], rows)


def demo() -> str:
    """Output of ``make demo``, and a table of the true and the estimated moduli."""
    printed = (REPORTS / "demo.txt").read_text(encoding="utf-8").rstrip()
    truth = json.loads((ROOT / "examples/captures/twill/truth.json").read_text(encoding="utf-8"))
    rows = []
    for direction, true in truth["moduli"].items():
        alpha, low, high, beta, least, most = re.search(
            rf"^{direction} +(\S+) +(\S+) to (\S+) +(\S+) +(\S+) to (\S+)$", printed,
            re.MULTILINE).groups()
        rows.append([direction, f"{true['alpha_uN_m']:.0f}", f"{alpha} ({low} to {high})",
                     f"{true['beta_nN_m2']:.0f}", f"{beta} ({least} to {most})"])
    known = table(["", "α true, µN·m", "estimate (68 %)", "β true, nN·m²", "estimate (68 %)"], rows)
    contained = " and ".join(
        f"{percent(sum(cell(kind)['inside']['68%']['each'][3:]) / 3)} ({kind})" for kind in RIGS)
    return (f"```\n{printed}\n```\n\n"
            f"**The capture of the demo is simulated**, so the true moduli are known:\n\n{known}\n"
            "\nA drape says little about β, so its estimate is pulled towards the β/α of typical "
            f"fabrics: the 68 % intervals of β/α contain {contained} of the true values of unseen "
            "fabrics, and one fabric can be missed in several directions at once.")


def views() -> str:
    """Error of log α by number of views and by number of drapes."""
    found = {count: cell("squares", f"views {count}")["log_alpha"]["rmse"] * spread("squares")
             for count in (1, 2, 4, 8)}
    joined = report("repeats")["summary"]
    return "\n\n".join((
        table(["views of one drape", *found], [["error of log α", *map("{:.2f}".format,
                                                                      found.values())]]),
        table(["drapes of one fabric, joined", *joined],
              [["error of log α", *(f"{one['log_alpha']:.2f}" for one in joined.values())]])))


def testers() -> str:
    """Errors of the cantilever estimators."""
    def share(value: float) -> str:
        return f"{value:.0f} %" if value >= 10 else f"{value:.2g} %"

    names = {"noisy": "guided, 0.3 mm noise,", "corrected": "table, corrected"}
    rows = [[" ".join(names.get(word, word) for word in strips.split()),
             *(share(found[name][key]) for name in ("alpha", "beta")
               for key in ("median", "rms", "largest"))]
            for strips, found in report("testers")["errors_percent"].items()]
    return table(["strips, estimator", "α: median", "rms", "largest", "β: median", "rms",
                  "largest"], rows)


def default_mesh() -> str:
    """Displacements of drapes on the default and other meshes from a fine mesh."""
    kinds = report("default_mesh")["meshes"]
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


def cutouts() -> str:
    """Errors of cut-outs by sensor, medians and worst cases."""
    rows = [[name, f"{found['iou'][1]:.3f}",
             *("{:.2f}, {:.2f}".format(*found[key]) for key in ("across_mm", "tilt_deg",
                                                                "turn_deg", "shift"))]
            for name, found in report("cutouts")["summary"].items()
            if name in ("smooth", "paper", "tof")]
    return table(["sensor", "intersection over union, worst",
                  *(f"{what}: median, worst" for what in
                    ("plate's centre, mm", "tilt, °", "turn, °", "log α, standard deviations"))],
                 rows)


def information() -> str:
    """Posterior bounds by unknown nuisances."""
    rows = [[name.replace("_", " along "), f"{found['log_alpha']:.3f}",
             f"{1e3 * found['beta_over_alpha']:.2f}",
             f"{found['standardised_log_alpha']:.3f}",
             f"{found['standardised_beta_over_alpha']:.3f}"]
            for name, found in report("information")["rms"].items()]
    return table(["unknown", "log α", "β/α, mm", "log α, of the spread", "β/α, of the spread"],
                 rows)


def cells() -> str:
    """Errors and coverage of the networks, with one condition changed at a time."""
    def columns(kind: str, name: str) -> list[str]:
        found = cell(kind, name)
        if not found:
            return ["–"] * 3
        low, high = found["log_alpha"]["interval_95"]
        return [f"{found['log_alpha']['rmse']:.3f} ({low:.3f} to {high:.3f})",
                f"{found['beta_over_alpha']['rmse']:.2f}", coverage(found)]

    rows = [[name, *columns("squares", name), *columns("discs", name)]
            for name in report(f"evaluation_{RIGS['discs']}")["cells"]
            if name.split()[0] not in ("sensor", "pitch", "distance")]
    head = ["condition", *(f"{kind}: {what}" for kind in RIGS for what in
                           ("log α / spread (95 %)", "β/α / spread", "inside"))]
    return f"{table(head, rows)}\n\n{soft_fabrics()}"


def soft_fabrics() -> str:
    """The errors of soft fabrics, beside how far these differ from each other."""
    def shares(name: str) -> str:
        found = [cell(kind, "soft fabrics") for kind in RIGS]
        return " and ".join(percent(one[name]["rmse"] / one["prior"][name]) for one in found)

    return ("Soft fabrics alone differ less from each other: of their own spread, the error of "
            f"log α is {shares('log_alpha')} (squares and discs) and that of β/α "
            f"{shares('beta_over_alpha')}.")


def refinement() -> str:
    """Errors of the network and of the refinement on simulated captures and scans."""
    sets = {"views, no nuisances": report("refine_views")["summary"]["all"],
            "views, other folds": report("refine_views")["summary"]["other folds"],
            "views, all nuisances": report("refine_views_real")["summary"]["all"],
            "scans, all nuisances": report("refine_scans")["summary"]}
    rows = [[name, found[who]["fabrics"], who, f"{found[who]['log_alpha']:.3f}",
             f"{found[who]['log_alpha_median']:.3f}", f"{found[who]['log_alpha_worst_fabric']:.2f}",
             f"{found[who]['beta_over_alpha_mm']:.2f}", coverage(found[who])]
            for name, found in sets.items() for who in ("network", "refined")]
    return table(["captures", "fabrics", "", "log α, rms", "median", "worst fabric", "β/α, mm",
                  "inside"], rows)


def outlines() -> str:
    """Folds, radii and spectra of real and simulated outlines at equal drape coefficient."""
    starts = {"flat": "lowered", "curled": "lowered, natural curvature from both faces",
              "specimens": "lowered, nuisances of specimens",
              "fabrics": "lowered, fabrics of the prior with nuisances", "ring": "ring"}
    rows = [[{"parallel": "parallel light", "camera": "camera 0.7 m above"}[reading], label,
             *(f"{found[key]:.{digits}f}" for key, digits in (
                 ("folds_real", 2), ("folds", 2), ("folds_rms", 2), ("deviation_real_mm", 1),
                 ("deviation_mm", 1), ("spectrum", 2)))]
            for reading, each in report("outlines")["summary"].items()
            for name, label in starts.items() for found in [each[name]["all"]]]
    return table(["pictures read as", "start", "folds, real", "simulated", "rms difference",
                  "deviation of the radius, mm, real", "simulated",
                  "spectra differ by, deviations"], rows)


def laboratory() -> str:
    """Drape coefficients and nodes of laboratory fabrics, measured and simulated."""
    rows = [[one["fabric"], one["composition"], one["tester"].replace("_", " "), one["membrane"],
             one["hysteresis"], f"{one['measured']:.1f}",
             f"{one['coefficient']:.1f} ({one['coefficient'] - one['measured']:+.1f})",
             "" if one["nodes_measured"] is None else f"{one['nodes_measured']:.0f}",
             f"{one['nodes']:.1f}"] for one in report("laboratory")["fabrics"]]
    return table(["fabric", "", "tester", "stretch and shear", "2HB", "DC measured, %",
                  "simulated", "nodes measured", "simulated"], rows)


def lowering() -> str:
    """Folds and drape coefficients of lowered drapes, one setting changed at a time."""
    found = report("lowering")
    rows = [[row["variant"], *(f"{folds:.1f}, {dc:.1f}" for folds, dc in zip(
        row["folds"], row["coefficients"], strict=True))] for row in found["variants"]]
    return table(["folds, drape coefficient in %",
                  *(f"{alpha:g} µN·m" for alpha in found["settings"]["alphas"])], rows)


def prior() -> str:
    """Likelihoods and distances of the priors on fitted and unseen fabrics."""
    found = report("prior")
    names = {**{f"gmm{k}": f"mixture of {k} normal distributions" for k in (3, 7)},
             **{f"vae{k}": f"VAE-{k}" for k in range(1, 5)}, "gaussian": "one normal distribution"}
    keys = ("log_likelihood_fitted", "log_likelihood_unseen", "wasserstein")
    rows = [[names[name], *("{:.2f} ± {:.2f}".format(*model[key]) for key in keys),
             "{:.2f} ± {:.2f}".format(*found["by_row"][name]["log_likelihood_unseen"])]
            for name, model in found["models"].items() if name in names]
    return table(["model", "fitted fabrics, nats", "unseen fabrics", "Wasserstein distance",
                  "split by row"], rows)


def accuracy() -> str:
    """List of three items: errors, what was compared with real cloth, limits."""
    squares, discs = cell("squares"), cell("discs")
    error = {kind: exp(cell(kind)["log_alpha"]["rmse"] * spread(kind)) - 1 for kind in RIGS}
    four = {kind: exp(cell(kind, "views 4")["log_alpha"]["rmse"] * spread(kind)) - 1
            for kind in RIGS}
    drapes = report("outlines")["summary"]["parallel"]["flat"]["all"]
    bent = next(iter(report("laboratory")["summary"].values()))
    return "\n".join([
        f"- **Simulated fabrics** outside the training set, with the variation of real "
        f"specimens and cameras: the typical error of α is {percent(error['squares'])} for "
        f"squares and {percent(error['discs'])} for discs ({percent(four['squares'])} and "
        f"{percent(four['discs'])} with four views). The 68 % intervals contain "
        f"{percent(squares['inside']['68%']['mean'])} and "
        f"{percent(discs['inside']['68%']['mean'])} of the true moduli.",
        f"- **Real cloth**: the simulator has been compared with the outlines of nine real fabrics "
        f"seen from above ({drapes['folds']:.1f} folds where they have {drapes['folds_real']:.1f}) "
        f"and with the drape coefficients of ten laboratory fabrics (off by {bent['rms']:.0f} "
        f"points rms), the estimator with none: no depth capture of a fabric of known moduli, and "
        f"no scanned surface, was at hand ([validation](docs/validation.md#real-cloth)).",
        f"- **Limits**: β/α is poorly constrained by a drape: its error is "
        f"{squares['beta_over_alpha']['rmse']:.2f} (squares) and "
        f"{discs['beta_over_alpha']['rmse']:.2f} (discs) of its spread over fabrics. "
        "The bundled networks were trained on drapes from artificial starts."])


BLOCKS: dict[str, Callable[[], str]] = {
    block.__name__: block for block in (
        demo, accuracy, views, claims, testers, default_mesh, cutouts,
        information, cells, refinement, prior, outlines, laboratory, lowering)
}


def fill_blocks(text: str) -> str:
    """Replace all blocks of ``text``.

    Raises:
        InputError: an unknown block.
    """
    def block(mark: re.Match[str]) -> str:
        if mark[2] not in BLOCKS:
            raise InputError(f"figures: {mark[2]} is not a block; known: {', '.join(BLOCKS)}")
        return f"{mark[1]}{BLOCKS[mark[2]]()}\n{mark[3]}"

    return MARK.sub(block, text)


def main(argv: list[str]) -> None:
    """Update all pages; print the names of those that changed."""
    if argv:
        raise InputError(f"{' '.join(argv)}: this command takes no settings")
    for page in PAGES:
        old = page.read_text(encoding="utf-8")
        if (new := fill_blocks(old)) != old:
            replace_file(page, new.encode())
            print(page.relative_to(ROOT))


if __name__ == "__main__":
    run_command(main, usage=__doc__)
