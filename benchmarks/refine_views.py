"""What refinement makes of four noisy views: ``python -m benchmarks.refine_views [key=value ...]``.

Four noisy depth views of a known fabric, from a camera beside its nominal place, of a drape
on a finer mesh and, it may be, in other folds than those of the fabric first estimated. The network
estimates; the refinement starts from there, its posterior a measurement as for ``infer.py``; and
both are compared with the truth, and with the prior's mean. The direction of the warp is known
to a degree. Beside the errors stands the Cramér-Rao bound of the same fabrics, seen by the same
cameras (:mod:`drapenet.information`; 1 mm of noise, one independent pixel in a hundred, the
camera's pose unknown).

Keys (``key=value``):

    fabrics       number of fabrics, drawn from the prior
    other_folds   whether only fabrics count, at least as many, whose captured drape has other folds
                  than a drape of the network's estimate
    edge_mm       edges at the rim of the refined drape in the end
    truth_mm      the same of the captured one
    sensor        noise of the views, a file of configs/sensor
    seed          of everything
    workers       processes, one thread each
    cases         folder of finished cases; an interrupted run goes on from there
    out           the report, JSON; a picture of the same name beside it
"""

import math
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
    usual_size,
    write_figure,
    write_report,
)
from benchmarks.photographs import estimated, photographed, place
from benchmarks.recovery import errors, known_drape
from common.cli import run_command
from data.cameras import DEFAULT_RIG, CameraRig
from data.fabrics import THETA_NAMES, fabric_from_theta
from data.prior import load_prior
from data.prior.gaussian import GaussianPrior
from drapenet.checkpoint import bundled, read_header
from drapenet.comparison import same_folds
from drapenet.convention import SWAPPED
from sim.drape import drape
from sim.measures import fold_outline
from sim.scene import Rig

GOAL = 0.15  # median error of alpha
BOUND = {"noise": 1e-3, "pixels_per_measurement": 100.0}  # m
BOUND_EDGE_MM = 3.5  # at the rim
DEFAULTS = {
    "fabrics": 20,
    "other_folds": False,
    "edge_mm": 1.75,
    "truth_mm": 1.0,
    "sensor": "tof",
    "seed": 77,
    "workers": 2,
    "cases": "outputs/validation/refine_views",
    "out": str(REPORTS / "refine_views.json"),
}


def views_case(
    *, number: int, edge_mm: float, truth_mm: float, sensor: str, seed: int, other_folds: bool
) -> dict:
    """The network and the refinement on one capture; with ``other_folds``, on such a one only."""
    from drapenet.maps import located_camera
    from drapenet.refine.views import refine_views

    known, shape = known_drape(seed, number, truth_mm)
    rng = np.random.default_rng([seed, number, 2])
    camera, turn = place(rng)
    views = photographed(shape, camera, turn, sensor=sensor, seed=number)

    intrinsics = CameraRig.load().intrinsics
    found = estimated(views, intrinsics, read_header(bundled(DEFAULT_RIG)))
    # Its stiffer yarns are the truth's warp or weft, whichever lie nearer.
    along = np.cos(2 * (found.axis - turn)) >= 0
    order = list(range(6)) if along else SWAPPED
    network, normal = found.theta[order], found.normal
    mean = load_prior("gaussian").mean
    first = drape(fabric_from_theta(network), edge=1e-3 * edge_mm, seed=number)
    outlines = [fold_outline(d.positions, d.rest, Rig()) for d in (shape, first)]
    folded_otherwise = not same_folds(*outlines)
    if other_folds and not folded_otherwise:
        return {"other_folds": False}
    refined = refine_views(
        views, located_camera(views, intrinsics, Rig()), network,
        turns=[turn + math.radians(rng.normal(0, 1))], edge=1e-3 * edge_mm, seed=number + 1,
        prior=GaussianPrior(normal.mean[order], normal.covariance[np.ix_(order, order)], fabrics=0))
    theta = network if refined is None else refined.best.theta
    result = {name: dict(zip(("alpha", "ratio"), errors(values, known), strict=True))
              for name, values in (("refined", theta), ("network", network), ("prior", mean))}
    result |= {"theta": known.tolist(), "found": theta.tolist(), "estimated": network.tolist(),
               "other_folds": folded_otherwise}
    if refined is not None:
        deviation = refined.uncertainty.theta.tolist() if refined.uncertainty else None
        result |= {"status": refined.status.value, "simulations": refined.simulations,
                   "seconds": refined.seconds, "start_value": refined.start_value,
                   "value": refined.best.value, "deviation": deviation}
    return result


def bound_case(*, number: int, seed: int) -> dict:
    """The least standard deviations of theta (6,) of one fabric; None where there are none."""
    from drapenet.information import CAMERA, SPECIMEN, bounds, depth_information

    _, shape = known_drape(seed, number, BOUND_EDGE_MM)
    camera, turn = place(np.random.default_rng([seed, number, 2]))  # as for the views
    found = depth_information(shape, camera, orientation=turn, **BOUND)
    covariance = found.covariance((*SPECIMEN, *CAMERA)) if found.ok else None
    return {"bound": None if covariance is None else bounds(covariance).tolist()}


def gather(config: dict) -> dict[str, dict]:
    """Results of as many fabrics as are asked for; or of at least as many with other folds."""
    found: dict[str, dict] = {}
    first, count = 0, config["fabrics"]
    while len(found) < count:
        made = run_cases(views_case, {
            f"views_{k}": {"number": k, **{key: config[key] for key in
                                           ("edge_mm", "truth_mm", "sensor", "seed",
                                            "other_folds")}}
            for k in range(first, first + count)},
            folder=Path(config["cases"]), workers=config["workers"], sources=ESTIMATOR)
        first += count
        found |= {name: r for name, r in made.items()
                  if r["other_folds"] or not config["other_folds"]}
    return found


def summarise(results: dict[str, dict]) -> dict[str, dict]:
    """Median errors over all alphas of all fabrics, of each way to estimate them."""
    summary = {}
    for name in ("refined", "network", "prior"):
        alpha = np.array([r[name]["alpha"] for r in results.values()])
        found = {"refined": "found", "network": "estimated"}.get(name)
        mean = load_prior("gaussian").mean
        gap = np.abs([np.array(r[found] if found else mean)[3:] - np.array(r["theta"])[3:]
                      for r in results.values()])
        summary[name] = {
            "alpha_median": float(np.median(alpha)),
            "alpha_by_direction": np.median(alpha, axis=0).tolist(),
            "alpha_worst_fabric": float(np.median(alpha, axis=1).max()),
            "ratio_median_mm": 1e3 * float(np.median(gap)),
        }
    return summary


def spreads(results: dict[str, dict]) -> dict[str, list[float]]:
    """Usual errors (6,) of log alpha and, in m, of beta/alpha, of refinement and network."""
    theta = np.array([r["theta"] for r in results.values()])
    return {name: usual_size([r[key] for r in results.values()] - theta)
            for name, key in (("refined from views", "found"), ("network", "estimated"))}


def over_bound(results: dict[str, dict], bounds: dict[str, dict]) -> dict[str, list[float]]:
    """Usual errors (6,) of refinement and network in units of each fabric's own bound."""
    known = [(r, np.array(b["bound"])) for r, b in
             zip(results.values(), bounds.values(), strict=True) if b["bound"]]
    return {name: usual_size([np.subtract(r[key], r["theta"]) / bound for r, bound in known])
            for name, key in (("refined from views", "found"), ("network", "estimated"))}


def picture(views: dict[str, dict], path: Path) -> None:
    """True against found alpha."""
    figure = Figure(figsize=(5.5, 4.6), layout="constrained")
    axis = figure.subplots()
    for name, key, colour in (("network", "estimated", "0.6"), ("refined", "found", "C1")):
        for k, marker in enumerate("os^"):
            axis.plot([1e6 * math.exp(r["theta"][k]) for r in views.values()],
                      [1e6 * math.exp(r[key][k]) for r in views.values()], marker,
                      color=colour, ms=4, label=f"{name}, {('warp', 'bias', 'weft')[k]}")
    axis.set(xscale="log", yscale="log", xlabel="true alpha [µN·m]", ylabel="found [µN·m]",
             title="from four noisy views")
    tick_short_scales(axis.xaxis, axis.yaxis)
    ends = np.array(axis.get_xlim())
    axis.plot(ends, ends, color="k", lw=0.8)
    axis.legend(fontsize=7, frameon=False)
    write_figure(path, figure)


def main(argv: list[str]) -> None:
    """Run what is missing, print the table, write the report and its picture."""
    config = parse_settings(DEFAULTS, argv)
    views = gather(config)
    bounds = run_cases(bound_case, {
        name.replace("views", "bound"): {"number": int(name.removeprefix("views_")),
                                         "seed": config["seed"]} for name in views},
        folder=Path(config["cases"]), workers=config["workers"], sources=ESTIMATOR)
    summary, factors = summarise(views), over_bound(views, bounds)
    other_folds = sum(r["other_folds"] for r in views.values())
    print("\nFour noisy views, median errors\n")
    print(table(["estimate", "alpha", "warp", "bias", "weft", "worst fabric", "beta/alpha, mm"],
                [[name, m["alpha_median"], *m["alpha_by_direction"], m["alpha_worst_fabric"],
                  m["ratio_median_mm"]] for name, m in summary.items()]))
    print(f"{other_folds} of {len(views)} captured drapes have other folds "
          "than a drape of the network's estimate")
    median = summary["refined"]["alpha_median"]
    print(f"refined: median error of alpha {median:.1%} "
          f"({'passed' if median <= GOAL else 'not passed'}: {GOAL:.0%})")
    print("usual errors over the bound of the same fabrics:")
    print(table(["", *THETA_NAMES], [[name, *values] for name, values in factors.items()]))
    out = Path(config["out"])
    write_report(out, {
        "settings": {k: v for k, v in config.items() if k not in ("out", "cases", "workers")},
        "summary": summary, "spread": spreads(views), "other_folds": other_folds,
        "over_bound": factors, "bounds": {name: b["bound"] for name, b in bounds.items()},
        "cases": views})
    picture(views, out.with_suffix(".png"))


if __name__ == "__main__":
    run_command(main, usage=__doc__)
