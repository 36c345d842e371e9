"""What a drape can tell: ``python -m benchmarks.information [fabrics=40] [workers=2]``.

The Cramér-Rao bound of the six moduli of prior fabrics, from four depth views (240 × 180 pixels,
the nominal camera) with 1 mm of noise and one independent pixel in a hundred; see
:mod:`drapenet.information`. Orientation and offset of the specimen are unknown; the table also
says what the camera's pose costs when it is unknown too, and what each modulus would have if the
others were known. Beside the bounds stands what refinement and the network reach, where their
report is there (docs/validation/refine_views.json).

Keys (``key=value``):

    fabrics       drawn from the prior
    seed          of the fabrics and their orientations
    edge_mm       edges of the mesh at the plate's rim
    noise_mm      standard deviation of a depth
    pixels        for one independent measurement
    workers       processes, one thread each
    cases         folder of finished fabrics; an interrupted run goes on from there
    refine_views  report of benchmarks.refine_views
    out           the report, JSON; a picture of the same name beside it
"""

import json
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from benchmarks.common import (
    ESTIMATOR,
    REPORTS,
    parse_settings,
    run_cases,
    table,
    tick_short_scales,
    write_figure,
    write_report,
)
from common.cli import run_command
from data.cameras import CameraRig
from data.fabrics import THETA_NAMES, fabric_from_theta
from data.prior import load_prior, sample_admissible
from data.sampling import Stream, stream
from drapenet.information import (
    CAMERA,
    SPECIMEN,
    bounds,
    bounds_alone,
    combinations,
    depth_information,
)
from sim.drape import drape
from sim.measures import fold_count

PERCENT, MM = 100.0, 1e3
UNITS = np.repeat([PERCENT, MM], 3)  # of the bounds of log alpha and beta/alpha
LABELS = tuple(f"{what} {d}" for what in ("α", "β/α") for d in ("warp", "bias", "weft"))
TOLD, UNTOLD = 0.2, 1.0  # of the spread over fabrics: told by a drape; not told at all

DEFAULTS = {
    "fabrics": 40,
    "seed": 6,
    "edge_mm": 3.5,
    "noise_mm": 1.0,
    "pixels": 100.0,
    "workers": 1,
    "cases": "outputs/validation/information",
    "refine_views": str(REPORTS / "refine_views.json"),
    "out": str(REPORTS / "information.json"),
}


def one_fabric(index: int, seed: int, edge_mm: float, noise_mm: float, pixels: float) -> dict:
    """Fisher's information on fabric ``index``."""
    rng = stream(seed, Stream.FABRIC, index)
    theta, _ = sample_admissible(load_prior("gaussian"), rng)
    fabric = fabric_from_theta(theta)
    orientation = 2 * np.pi * float(stream(seed, Stream.VIEWS, index).random())
    result = drape(fabric, edge=1e-3 * edge_mm, seed=index)
    found = depth_information(result, CameraRig.load().nominal(), orientation=orientation,
                              noise=noise_mm / MM, pixels_per_measurement=pixels)
    return {
        "theta": theta.tolist(),
        "orientation_degrees": float(np.degrees(orientation)),
        "status": result.status.value,
        "message": result.message if found.ok else found.message,
        "folds": fold_count(result.positions, result.rest, result.rig),
        "pixels": found.pixels,
        "covariances": {
            name: found.covariance(unknown).tolist() if found.ok else None
            for name, unknown in (("known", ()), ("specimen", SPECIMEN),
                                  ("camera", (*SPECIMEN, *CAMERA)))
        },
    }


def figures(case: dict, spread: np.ndarray) -> dict:
    """Bounds of one fabric in percent and mm; of combinations in the fabrics' spread."""
    covariance = np.array(case["covariances"]["specimen"])
    deviations, weights = combinations(covariance, spread)
    return {
        "alpha_uN_m": (1e6 * np.exp(case["theta"][:3])).tolist(),
        "beta_over_alpha_mm": (MM * np.array(case["theta"][3:])).tolist(),
        "folds": case["folds"],
        "bound": (UNITS * bounds(covariance)).tolist(),
        "bound_alone": (UNITS * bounds_alone(covariance)).tolist(),
        **{f"bound_{name}": (UNITS * bounds(np.array(case["covariances"][name]))).tolist()
           for name in ("known", "camera")},
        "combinations": {"of_the_spread": deviations.tolist(), "weights": weights.tolist()},
        "told": int((deviations < TOLD).sum()),
        "untold": int((deviations > UNTOLD).sum()),
    }


def summarise(rows: list[dict]) -> dict:
    """Quantiles over the fabrics."""
    summary = {}
    for name in ("bound", "bound_alone", "bound_known", "bound_camera"):
        low, median, high = np.quantile([row[name] for row in rows], [0.1, 0.5, 0.9], axis=0)
        summary[name] = {"tenth": low.tolist(), "median": median.tolist(), "ninetieth":
                         high.tolist()}
    deviations = np.array([row["combinations"]["of_the_spread"] for row in rows])
    summary["combinations_of_the_spread"] = np.median(deviations, axis=0).tolist()
    summary["told"] = np.bincount([row["told"] for row in rows], minlength=7).tolist()
    summary["untold"] = np.bincount([row["untold"] for row in rows], minlength=7).tolist()
    # Of the least known combination, the share of each modulus.
    last = np.array([row["combinations"]["weights"][-1] for row in rows])
    summary["least_known_shares"] = np.median(last**2, axis=0).tolist()
    return summary


def main(argv: list[str]) -> None:
    """Find the bounds, print the table, write the report and its picture."""
    config = parse_settings(DEFAULTS, argv)
    keys = ("seed", "edge_mm", "noise_mm", "pixels")
    settings = {key: config[key] for key in keys}
    label = "_".join(f"{settings[key]:g}" for key in keys)
    cases = {f"fabric_{k}_{label}": {"index": k, **settings} for k in range(config["fabrics"])}
    found = run_cases(one_fabric, cases, folder=Path(config["cases"]), workers=config["workers"],
                      sources=ESTIMATOR)
    spread = load_prior("gaussian").deviation
    good = [case for case in found.values() if case["covariances"]["specimen"] is not None]
    rows = [figures(case, spread) for case in good]
    out = Path(config["out"])
    report = {
        "settings": {"fabrics": config["fabrics"], **settings},
        "parameters": THETA_NAMES,
        "units": ["%"] * 3 + ["mm"] * 3,
        "spread": (UNITS * spread).tolist(),
        "limits_of_the_spread": {"told": TOLD, "untold": UNTOLD},
        "without_derivatives": [case["message"] for case in found.values()
                                if case["covariances"]["specimen"] is None],
    }
    if rows:
        report["summary"] = summarise(rows)
        report["reached"] = reached(Path(config["refine_views"]))
        show(report)
    report["fabrics"] = rows
    write_report(out, report)
    if rows:
        draw(report, out.with_suffix(".png"))


def reached(path: Path) -> dict[str, list[float]]:
    """What refinement and the network reach, by method: (6,) spreads in percent and mm.

    The report's entry "spread": typical errors of log alpha and, in m, of beta/alpha.
    """
    try:
        spreads = json.loads(path.read_text(encoding="utf-8"))["spread"]
        return {name: (UNITS * np.array(values)).tolist() for name, values in spreads.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}


def show(report: dict) -> None:
    """Print the table."""
    summary = report["summary"]

    def row(title: str, values: list[float]) -> list[str]:
        return [title, *(f"{v:.2g} {unit}" for v, unit in zip(values, report["units"],
                                                              strict=True))]

    print(table(["", *LABELS], [
        row("bound, median fabric", summary["bound"]["median"]),
        row("tenth percentile", summary["bound"]["tenth"]),
        row("ninetieth percentile", summary["bound"]["ninetieth"]),
        row("other moduli known", summary["bound_alone"]["median"]),
        row("orientation, offset known", summary["bound_known"]["median"]),
        row("camera unknown too", summary["bound_camera"]["median"]),
        *(row(name, values) for name, values in report["reached"].items()),
        row("spread over fabrics", report["spread"]),
    ]))
    values = ", ".join(f"{v:.2g}" for v in summary["combinations_of_the_spread"])
    print(f"combinations, best known first, in the spread over fabrics (medians): {values}")
    for name, limit in (("told", f"below {TOLD:g}"), ("untold", f"above {UNTOLD:g}")):
        counts = ", ".join(f"{k}: {n}" for k, n in enumerate(summary[name]) if n)
        print(f"combinations {limit} of the spread: fabrics with {counts}")
    if report["without_derivatives"]:
        print("without derivatives:", "; ".join(report["without_derivatives"]))


def draw(report: dict, path: Path) -> None:
    """Picture of a report, as it is or as read: bounds by stiffness, combinations' deviations."""
    rows = report["fabrics"]
    figure = Figure(figsize=(11.0, 3.6), layout="constrained")
    stiffness, shrinkage, spectrum = figure.subplots(1, 3)
    mean = np.array([np.exp(np.log(row["alpha_uN_m"]).mean()) for row in rows])
    bound = np.array([row["bound"] for row in rows])
    for axis, part, unit, name in ((stiffness, slice(0, 3), "%", "α"),
                                   (shrinkage, slice(3, 6), "mm", "β/α")):
        for k, mark in zip(range(part.start, part.stop), "o^s", strict=True):
            axis.loglog(mean, bound[:, k], mark, ms=3, label=LABELS[k])
            axis.axhline(report["spread"][k], color=f"C{k % 3}", lw=0.8, ls="--")
            for style, values in zip(("-", ":"), report["reached"].values(), strict=False):
                axis.axhline(values[k], color=f"C{k % 3}", lw=0.8, ls=style)
        tick_short_scales(axis.xaxis, axis.yaxis)
        axis.set_xlabel("geometric mean of α, µN·m", fontsize=8)
        axis.set_title(f"least standard deviation of {name}, {unit}", fontsize=9)
        axis.legend(fontsize=7, frameon=False)
    deviations = np.array([row["combinations"]["of_the_spread"] for row in rows])
    spectrum.semilogy(np.arange(1, 7), deviations.T, color="0.7", lw=0.6)
    spectrum.semilogy(np.arange(1, 7), np.median(deviations, axis=0), "ko-", ms=4)
    for limit in (TOLD, UNTOLD):
        spectrum.axhline(limit, color="C3", lw=0.8, ls="--")
    spectrum.set_xlabel("combination, best known first", fontsize=8)
    spectrum.set_title("its deviation, of the spread over fabrics", fontsize=9)
    write_figure(path, figure)


if __name__ == "__main__":
    run_command(main, usage=__doc__)
