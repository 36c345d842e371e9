"""Scans whose moduli are known: ``python -m benchmarks.simulated_scans [key=value ...]``.

Fabrics of the prior are draped on the disc rig and scanned in simulation: on another mesh, vertices
off along the cloth and across it. From the prior's mean, ``refine=scan`` has to find the moduli
again. Reported are the errors of its estimate, of the cloth of the nearest drape it found, of
the estimate from the same surface without its vertices' places (a raw scan), and of the prior's
mean. Errors of alpha are taken along the true warp, bias and weft: cloth whose yarns
are alike is the same in axes turned by 45°, where warp and bias change places.

Keys (``key=value``):

    fabrics      how many
    seed         of the fabrics
    turn         degrees, largest angle between the warp and the scan's first axis
    along        mm, standard deviation of a vertex's error in each direction along the cloth
    across       mm, across it
    solves       simulations of a refinement
    workers      processes, one thread each
    cases        folder of finished scans; an interrupted run goes on from there
    out          the report, JSON; a picture of the same name beside it
"""

import math
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.interpolate import RBFInterpolator

from benchmarks.common import (
    ESTIMATOR,
    REPORTS,
    parse_settings,
    run_cases,
    table,
    write_figure,
    write_report,
)
from common.cli import run_command
from common.errors import InputError
from data.fabrics import fabric_from_theta
from data.prior.files import load_prior, sample_admissible
from data.sampling import Stream, stream
from drapenet.refine.captured import CapturedShape, Cloth, turned_rest
from drapenet.refine.fidelity import fidelity
from drapenet.refine.register import register
from drapenet.refine.scan import Cloud
from drapenet.refine.scan_report import EDGE
from drapenet.refine.shape_search import HELD, scan_objective, search_cloth
from sim.drape import drape
from sim.material import MICRO, plate_constants
from sim.mesh import vertex_normals
from sim.mesh.specimens import TOPOLOGIES, make_specimen
from sim.scene import DISC_RIG

CORRELATION = 0.0125  # m, how far around a vertex others err like it
FINE, SCANNED = 2e-3, 6e-3  # m, edges at the rim of the simulated specimen, and all of its scan
DEFAULTS = {
    "fabrics": 12,
    "seed": 20224,
    "turn": 20.0,
    "along": 0.35,
    "across": 0.1,
    "solves": 25,
    "workers": 1,
    "cases": "outputs/validation/simulated_scans",
    "out": str(REPORTS / "simulated_scans.json"),
}


def simulated_scan(
    theta: np.ndarray, *, along: float, across: float, seed: int, turn: float = 0.0,
    fine: float = FINE, scanned: float = SCANNED,
) -> CapturedShape:
    """A drape of theta (6,) as a scan registered to another mesh shows it.

    Args:
        turn: rad, angle of the warp in the axes of the scan's rest points.
        along, across: m, standard deviations of the vertices' errors in each direction along the
            cloth and across it. Vertices on the plate have none.
        seed: of the drape, the mesh and the errors.
        fine, scanned: m, edges at the rim of the draped specimen, and all of the scan.

    Raises:
        InputError: the drape did not converge.
    """
    truth = drape(fabric_from_theta(theta), rig=DISC_RIG, edge=fine, seed=seed)
    if not truth.converged:
        raise InputError(f"a drape to be scanned did not converge: {truth.message}")
    specimen = make_specimen(DISC_RIG, edge=scanned, grading=1.0,
                             topology=(seed + 1) % TOPOLOGIES)
    mesh = specimen.mesh
    hem = DISC_RIG.specimen_size / 2
    rng = np.random.default_rng([seed, 2])
    errors = RBFInterpolator(
        rng.uniform(-1.1 * hem, 1.1 * hem, (400, 2)), rng.standard_normal((400, 3)),
        kernel="gaussian", epsilon=1 / CORRELATION, smoothing=1.0)(mesh.rest)
    errors *= np.array([along, along, across]) / errors.std(axis=0)
    errors[specimen.held] = 0.0
    material = mesh.rest + errors[:, :2]
    beyond = np.linalg.norm(material, axis=1) / hem
    material /= np.maximum(beyond, 1.0)[:, None]
    positions = RBFInterpolator(truth.rest, truth.positions, neighbors=30,
                                kernel="cubic")(material)
    positions += errors[:, 2:] * vertex_normals(positions, mesh.faces)
    return CapturedShape(positions, turned_rest(mesh.rest, -turn), mesh.faces, DISC_RIG)


def refined(
    theta: list[float], seed: int, turn: float, along: float, across: float, solves: int
) -> dict:
    """Scan a drape of theta (6,), turned by up to ``turn`` degrees, and refine it from the prior's
    mean."""
    truth, prior = np.array(theta), load_prior("gaussian")
    warp = math.radians(np.random.default_rng([seed, 3]).uniform(-turn, turn))
    scan = simulated_scan(truth, turn=warp, along=1e-3 * along, across=1e-3 * across, seed=seed)
    found = search_cloth(scan, scan_objective(scan), Cloth(prior.mean.copy()), prior=prior,
                         solves=solves)
    if found.estimate is None or found.nearest is None:
        raise InputError(f"no simulation of scan {seed} ended: {found.effort.failures}")
    surface = Cloud.of_mesh(scan.positions, scan.faces)
    raw = register(surface, DISC_RIG, edge=EDGE).shape
    of_raw = search_cloth(raw, scan_objective(raw), Cloth(prior.mean.copy()), prior=prior,
                          solves=HELD)
    if of_raw.estimate is None:
        raise InputError(f"no simulation of the raw scan {seed} ended: {of_raw.effort.failures}")
    row = {"alpha_uN_m": (np.exp(truth[:3]) / MICRO).tolist(), "warp_deg": math.degrees(warp),
           "solves": found.effort.solves,
           "nearest_mm": fidelity(scan, found.nearest.drape).displacement_mm}
    # A raw scan's axes are those of the simulation.
    for name, cloth, axis in (("estimate", found.estimate.cloth, warp),
                              ("nearest", found.nearest.cloth, warp),
                              ("raw", of_raw.estimate.cloth, 0.0),
                              ("prior", Cloth(prior.mean), 0.0)):
        errors = np.log(alpha_along(cloth, axis)) - truth[:3]
        row[name] = {"log_alpha": errors.tolist(), "warp_deg": math.degrees(cloth.warp),
                     "ratio_mm": (1e3 * (cloth.theta[3:] - truth[3:])).tolist()}
    return row


def alpha_along(cloth: Cloth, warp: float) -> np.ndarray:
    """Alpha (3,), N·m, of ``cloth`` along the directions that are warp, bias and weft of a specimen
    whose warp lies at the angle ``warp``, rad; the mean of both biases."""
    alpha = cloth.fabric.alpha
    a11, a22, a12, a66 = plate_constants(alpha)
    turn = warp - cloth.warp

    def along(angle: float) -> float:
        c, s = math.cos(turn + angle) ** 2, math.sin(turn + angle) ** 2
        return a11 * c * c + a22 * s * s + (2 * a12 + 4 * a66) * c * s

    bias = (along(math.pi / 4) + along(-math.pi / 4)) / 2
    return np.array([along(0.0), bias, along(math.pi / 2)])


def main(argv: list[str]) -> None:
    """Refine, print the table, write the report and its picture."""
    config = parse_settings(DEFAULTS, argv)
    prior = load_prior("gaussian")
    thetas = [sample_admissible(prior, stream(config["seed"], Stream.FABRIC, k))[0]
              for k in range(config["fabrics"])]
    settings = {k: config[k] for k in ("turn", "along", "across", "solves")}
    found = run_cases(refined, {
        f"scan_{k}": {"theta": theta.tolist(), "seed": k, **settings}
        for k, theta in enumerate(thetas)}, folder=Path(config["cases"]),
        workers=config["workers"], sources=ESTIMATOR)
    rows = list(found.values())
    print(table(
        ["fabric", "α warp, bias, weft", "errors of the estimate", "of the nearest drape's cloth",
         "from a raw scan", "warp, found, °", "nearest, mm"],
        [[k, *(", ".join(words) for words in (
            [f"{a:.1f}" for a in r["alpha_uN_m"]],
            *([f"{100 * np.expm1(e):+.0f} %" for e in r[n]["log_alpha"]]
              for n in ("estimate", "nearest", "raw")))),
          f"{r['warp_deg']:.0f}, {r['estimate']['warp_deg']:.0f}", r["nearest_mm"]]
         for k, r in enumerate(rows)]))
    summary = {
        name: {
            "median_alpha_error": float(np.expm1(np.median(np.abs(
                [r[name]["log_alpha"] for r in rows])))),
            "median_ratio_error_mm": float(np.median(np.abs([r[name]["ratio_mm"] for r in rows]))),
        } for name in ("estimate", "nearest", "raw", "prior")}
    for name, figures in summary.items():
        print(f"{name}: median error of α {100 * figures['median_alpha_error']:.0f} %, of β/α "
              f"{figures['median_ratio_error_mm']:.2f} mm")
    out = Path(config["out"])
    write_report(out, {"settings": {"seed": config["seed"], **settings}, "summary": summary,
                       "scans": rows})
    draw(rows, out.with_suffix(".png"))


def draw(rows: list[dict], path: Path) -> None:
    """Found against true alpha: the estimate, the nearest drape, the estimate from a raw scan."""
    figure = Figure(figsize=(11, 3.8), layout="constrained")
    truth = np.array([r["alpha_uN_m"] for r in rows])
    shown = {"estimate": "estimate (held)", "nearest": "cloth of the nearest drape",
             "raw": "estimate from a raw scan"}
    for axis, (name, title) in zip(figure.subplots(1, 3, sharey=True), shown.items(),
                                   strict=True):
        errors = np.array([r[name]["log_alpha"] for r in rows])
        for k, direction in enumerate(("warp", "bias", "weft")):
            axis.loglog(truth[:, k], truth[:, k] * np.exp(errors[:, k]), "o", ms=4,
                        label=direction)
        ends = [truth.min() / 1.5, truth.max() * 1.5]
        axis.plot(ends, ends, "k-", lw=0.8)
        axis.set_title(title)
        axis.set_xlabel("true α, µN·m")
        axis.legend(frameon=False)
    figure.axes[0].set_ylabel("found α, µN·m")
    write_figure(path, figure)


if __name__ == "__main__":
    run_command(main, usage=__doc__)
