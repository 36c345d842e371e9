"""What friction in cloth does to an estimate: ``python -m benchmarks.friction [key=value ...]``.

Unseen fabrics are draped with more and more friction against bending, from flat
(:mod:`sim.energies.bending_friction`), captured with sensor noise, and estimated by the bundled
network: without a word of the friction, and given it (``friction_un=`` of ``infer.py``). Beside it
stands the virtual cantilever tester with the same friction. All are given relative to what they say
of the same fabric without friction.

Keys (``key=value``):

    fabrics    how many, drawn from the prior that the network was trained on
    seed       of the fabrics; not that of a training set
    friction   torques, µN·m per metre of width (half of 2HB); the first must be 0
    sensor     noise of the views, a file of configs/sensor
    workers    processes, one thread each
    cases      folder of finished fabrics; an interrupted run goes on from there
    out        the report, JSON; a picture of the same name beside it
"""

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
from benchmarks.guides import level_rulings
from benchmarks.photographs import estimated, photographed, place
from common.cli import run_command
from common.errors import InputError
from data.cameras import DEFAULT_RIG, CameraRig
from data.fabrics import fabric_from_theta
from data.prior import load_prior, sample_admissible
from data.sampling import Stream, stream
from drapenet.checkpoint import bundled, read_header
from sim.cantilever.fabric import estimate
from sim.cantilever.tester import bending_length, simulate_strips
from sim.drape import DrapeResult, drape
from sim.energies.bending_friction import BendingFriction
from sim.laws import Laws
from sim.material import DIRECTIONS, MICRO, REFERENCE_DENSITY, Fabric

WAYS = {"drape": "network", "drape_known": "network, given the friction",
        "cantilever": "cantilever tester"}
"""How each row's alphas are found, by name."""
STRIPS = (1.5, 2.5)  # lengths of the tester's strips, in bending lengths
DEFAULTS = {
    "fabrics": 20,
    "seed": 20225,
    "friction": [0.0, 20.0, 50.0, 100.0, 200.0, 500.0],
    "sensor": "smooth",
    "workers": 2,
    "cases": "outputs/validation/friction",
    "out": str(REPORTS / "friction.json"),
}


def estimates(theta: list[float], number: int, friction: list[float], sensor: str) -> dict:
    """One fabric, theta (6,), by network and tester; a row for each torque, µN·m per metre."""
    fabric = fabric_from_theta(np.array(theta))
    rows = [{"converged": False} for _ in friction]
    for torque, row in zip(friction, rows, strict=True):
        laws = Laws(bending=BendingFriction(MICRO * torque))
        result = drape(fabric, seed=number, laws=laws)
        if result.converged:
            row |= {"converged": True, "drape": captured_alpha(result, number, sensor),
                    "drape_known": captured_alpha(result, number, sensor, MICRO * torque)}
        try:
            row["cantilever"] = tested_alpha(fabric, laws)
        except InputError as refusal:  # with much friction a strip hangs as no law's does
            row["refused"] = str(refusal)
    return {"alpha_uN_m": (fabric.alpha / MICRO).tolist(), "rows": rows}


def captured_alpha(
    result: DrapeResult, number: int, sensor: str, friction: float | None = None
) -> list[float]:
    """Alpha (3,), µN·m, stiff, bias, soft, that the network reads from noisy views of a drape.

    Camera and turn depend on ``number`` only, so that captures of one fabric compare. ``friction``,
    N·m per metre, is what the network is given.
    """
    camera, turn = place(np.random.default_rng([number, 4]))
    views = photographed(result, camera, turn, sensor=sensor, seed=number)
    found = estimated(views, CameraRig.load().intrinsics, read_header(bundled(DEFAULT_RIG)),
                      friction=friction)
    return (found.fabric.alpha / MICRO).tolist()


def tested_alpha(fabric: Fabric, laws: Laws) -> list[float]:
    """Alpha (3,), µN·m, stiff, bias, soft, that the virtual cantilever tester reads."""
    lengths = {direction: [share * bending_length(alpha, REFERENCE_DENSITY) for share in STRIPS]
               for direction, alpha in zip(DIRECTIONS, fabric.alpha, strict=True)}
    strips = simulate_strips(fabric, lengths, guide=level_rulings, laws=laws)
    found = estimate(strips, density=REFERENCE_DENSITY, method="regression")
    warp, bias, weft = (found[direction].alpha / MICRO for direction in DIRECTIONS)
    return [max(warp, weft), bias, min(warp, weft)]


def shifts(cases: dict[str, dict], name: str, k: int) -> np.ndarray:
    """(N, 3) log alpha of ``name`` at the k-th torque, less that without friction."""
    pairs = [(c["rows"][0], c["rows"][k]) for c in cases.values()]
    return np.array([np.log(np.divide(b[name], a[name])) for a, b in pairs
                     if name in a and name in b]).reshape(-1, 3)


def main(argv: list[str]) -> None:
    """Estimate, print the table, write the report and its picture."""
    config = parse_settings(DEFAULTS, argv)
    friction = config["friction"]
    if len(friction) < 2 or friction[0] != 0:
        raise InputError("friction=... must begin with 0 and name another torque")
    prior = load_prior("vae")
    found = run_cases(estimates, {
        f"fabric_{k}": {
            "theta": sample_admissible(prior, stream(config["seed"], Stream.FABRIC, k))[0].tolist(),
            "number": k, "friction": friction, "sensor": config["sensor"]}
        for k in range(config["fabrics"])}, folder=Path(config["cases"]),
        workers=config["workers"], sources=ESTIMATOR)
    summary = [summarise(found, k, torque) for k, torque in enumerate(friction)]
    print(table(
        ["friction, µN·m/m", "drapes", "α by network", "nine in ten of it", "given the friction",
         "nine in ten of it", "α by cantilever", "tests refused"],
        [[f"{s['torque_uN']:g}", s["drapes"],
          *(text for name in ("drape", "drape_known")
            for text in (f"x {s[name]['median']:.2f}",
                         f"{s[name]['low']:.2f} to {s[name]['high']:.2f}")),
          f"x {s['cantilever']['median']:.2f}", s["refused"]]
         for s in summary]))
    out = Path(config["out"])
    write_report(out, {"settings": {k: config[k] for k in ("fabrics", "seed", "sensor")},
                       "summary": summary, "fabrics": found})
    draw(found, friction, out.with_suffix(".png"))


def summarise(cases: dict[str, dict], k: int, torque: float) -> dict:
    """Ratios to the estimates without friction at the k-th torque, over fabrics and directions."""
    rows = [case["rows"][k] for case in cases.values()]
    result = {"torque_uN": torque, "drapes": sum(row["converged"] for row in rows),
              "refused": sum("refused" in row for row in rows)}
    for name in WAYS:
        low, median, high = np.exp(np.percentile(shifts(cases, name, k), [5, 50, 95]))
        result[name] = {"median": median, "low": low, "high": high}
    return result


def draw(cases: dict[str, dict], friction: list[float], path: Path) -> None:
    """Ratios against the curvature that friction alone would hold, torque over alpha."""
    figure = Figure(figsize=(11, 3.8), layout="constrained")
    for axis, (name, title) in zip(figure.subplots(1, len(WAYS), sharey=True), WAYS.items(),
                                   strict=True):
        for k, torque in list(enumerate(friction))[1:]:
            alpha = np.array([sorted_true(c) for c in cases.values()
                              if name in c["rows"][0] and name in c["rows"][k]])
            axis.plot((torque / alpha).ravel(), np.exp(shifts(cases, name, k)).ravel(), ".", ms=4,
                      label=f"{torque:g} µN·m/m")
        axis.axhline(1.0, color="k", lw=0.8)
        axis.set(xscale="log", yscale="log", title=title, xlabel="friction over α, 1/m")
    figure.axes[0].set_ylabel("α with friction over α without")
    tick_short_scales(figure.axes[0].yaxis)
    figure.axes[0].legend(frameon=False, fontsize=8)
    write_figure(path, figure)


def sorted_true(case: dict) -> list[float]:
    """True alpha (3,), µN·m: stiff, bias, soft."""
    warp, bias, weft = case["alpha_uN_m"]
    return [max(warp, weft), bias, min(warp, weft)]


if __name__ == "__main__":
    run_command(main, usage=__doc__)
