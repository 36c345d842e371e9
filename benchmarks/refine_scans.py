"""Scans of real drapes, refined: ``python -m benchmarks.refine_scans [scans=../shared/scans]``.

Each scan of a real fabric on the disc rig is refined from the prior's mean: six moduli, the
membrane's stiffness and the direction of the warp. Judged are the estimate, by the agreement of
samples of one fabric (and how much worse another sample's moduli explain a scan), and the nearest
drape that the search has found, by its distance and its drape coefficient. Beside it stand the best
isotropic linear fabric, and what a natural curvature, added to the nearest drape, would improve.
The fabrics' densities are unknown: moduli are those at 300 g/m².

Keys (``key=value``):

    scans        folder of scans (npz: vertices m, rest m, faces)
    only         part of the names of those to refine; empty for all
    solves       simulations of a refinement
    isotropic    isotropic fabrics tried per scan
    held         share of the support's radius within which it holds the cloth
    curvature    simulations of the refinement with a natural curvature; 0 for none
    friction     torques, µN·m per metre, that friction within the estimate's cloth holds
    workers      processes, one thread each
    cases        folder of finished scans; an interrupted run goes on from there
    out          the report, JSON; a picture of the same name beside it
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from benchmarks.common import (
    ESTIMATOR,
    REPORTS,
    ROOT,
    load_arrays,
    parse_settings,
    run_cases,
    table,
    write_figure,
    write_report,
)
from common.cli import run_command
from common.errors import InputError
from data.picture import shade
from data.prior.files import load_prior
from data.scans import Scan, read_scans
from drapenet.refine.captured import CapturedProblem, CapturedShape, Cloth, Settled
from drapenet.refine.fidelity import fidelity
from drapenet.refine.friction import drapes_with_friction
from drapenet.refine.registered import RobustPositions
from drapenet.refine.scan_report import read_shape
from drapenet.refine.shape_search import (
    scan_objective,
    search_cloth,
    search_curvature,
    stiffness_only,
    surface_springs,
)
from sim.material import DIRECTIONS, MICRO
from sim.mesh import vertex_normals
from sim.scene import DISC_RIG

_STEM = 0.3  # in pictures the thin support stands on a stem of this share of its radius
GOAL_MM, GOAL_POINTS, GOAL_RATIO = 3.5, 3.0, 1.3
ISOTROPIC_RANGE = (1.0, 100.0)  # µN·m
DEFAULTS = {
    "scans": str(ROOT.parent / "shared" / "scans"),
    "only": "",
    "solves": 25,
    "isotropic": 14,
    "held": 1.0,
    "curvature": 12,
    "friction": [0.0, 20.0, 50.0, 100.0, 200.0],
    "workers": 1,
    "cases": "outputs/validation/refine_scans",
    "out": str(REPORTS / "refine_scans.json"),
}


def laid(path: str, held: float) -> dict:
    """A scan as a shape to refine: how its specimen was laid on it, and where that lies."""
    shape, registration = read_shape(Path(path), DISC_RIG, held=held)
    return {"registration": registration,
            "arrays": {"positions": shape.positions, "rest": shape.rest, "faces": shape.faces}}


def shape_of(path: str, cases: str, held: float) -> CapturedShape:
    """The shape of the scan ``path`` among the finished ``cases``."""
    return CapturedShape(**load_arrays(Path(cases), f"laid_{Path(path).stem}"), rig=DISC_RIG,
                         held_share=held)


def best_isotropic(path: str, cases: str, held: float, count: int) -> dict:
    """The isotropic linear fabric whose drape stays nearest to a scan, of ``count``."""
    shape = shape_of(path, cases, held)
    alphas = MICRO * np.geomspace(*ISOTROPIC_RANGE, count)
    tried = [_result(shape, settled)
             for settled in stiffness_only(shape, RobustPositions.of(shape), alphas)]
    return {**min(tried, key=lambda result: result["displacement_mm"]), "tried": len(alphas)}


def refined(path: str, cases: str, held: float, solves: int) -> dict:
    """The refinement of a scan: the nearest drape, and the estimate."""
    shape, prior = shape_of(path, cases, held), load_prior("gaussian")
    found = search_cloth(shape, scan_objective(shape), Cloth(prior.mean.copy()), prior=prior,
                         solves=solves)
    if found.nearest is None or found.released is None:
        raise InputError(f"{path}: no simulation ended: {found.effort.failures}")
    return {**_result(shape, found.nearest), "estimate": _result(shape, found.released),
            "solves": found.effort.solves, "seconds": found.effort.seconds,
            "failures": found.effort.failures,
            "arrays": {"positions": found.nearest.drape.positions}}


def exchanged(path: str, cases: str, held: float, cloth: dict, thetas: dict) -> dict:
    """Misfit of a scan to its estimate's ``cloth`` under the springs, and with other moduli.

    Args:
        thetas: (6,) moduli by the name of the scan whose estimate they are.
    """
    shape, own = shape_of(path, cases, held), _cloth(cloth)
    captured = shape.as_drape(own.fabric)
    objective, springs = scan_objective(shape), [surface_springs(captured)]
    prior = load_prior("gaussian")
    misfits = {}
    for other, theta in thetas.items():
        problem = CapturedProblem(shape, objective, replace(own, theta=np.array(theta)),
                                  prior=prior, near=captured, springs=springs)
        problem.value(problem.start)
        misfits[other] = problem.best and problem.best.value
    return misfits


def curved(path: str, cases: str, held: float, solves: int, cloth: dict) -> dict:
    """The nearest drape of a scan, among the finished ``cases``, with a natural curvature."""
    shape, start = shape_of(path, cases, held), _cloth(cloth)
    positions = load_arrays(Path(cases), f"refined_{Path(path).stem}")["positions"]
    near = shape.as_drape(start.fabric, start.warp).at(positions)
    best, count = search_curvature(shape, scan_objective(shape), start, near,
                                   prior=load_prior("gaussian"), solves=solves)
    if best is None:
        raise InputError(f"{path}: no simulation ended")
    return {**_result(shape, best), "solves": count}


def rubbing(path: str, cases: str, held: float, cloth: dict, friction: list[float]) -> dict:
    """How far the estimate's cloth goes when its springs let go and friction of ``friction``,
    µN·m per metre, holds it."""
    shape = shape_of(path, cases, held)
    drapes = drapes_with_friction(shape, _cloth(cloth), [MICRO * torque for torque in friction])
    gaps = [fidelity(shape, d).displacement_mm if d.converged else None for d in drapes]
    return {"held_mm": gaps[0], "friction_mm": gaps[1:]}


def _cloth(found: dict) -> Cloth:
    """The cloth of :func:`_result`."""
    return Cloth(np.array(found["theta"]), found["membrane"], found["warp"])


def _result(shape: CapturedShape, settled: Settled) -> dict:
    cloth = settled.cloth
    return {
        **fidelity(shape, settled.drape).as_dict(),
        "cloth": {"theta": cloth.theta.tolist(), "membrane": cloth.membrane, "warp": cloth.warp,
                  "curvature": list(cloth.curvature)},
        "alpha_uN_m": (np.exp(cloth.theta[:3]) / MICRO).tolist(),
        "beta_over_alpha_mm": (1e3 * cloth.theta[3:]).tolist(),
    }


def main(argv: list[str]) -> None:
    """Refine, print the tables, write the report and its picture."""
    config = parse_settings(DEFAULTS, argv)
    if config["solves"] < 8 or config["isotropic"] < 2 or config["curvature"] < 0:
        raise InputError("give solves of 8 or more, isotropic of 2 or more, curvature from 0")
    folder = Path(config["cases"])
    scans = [s for s in read_scans(Path(config["scans"]), DISC_RIG) if config["only"] in s.name]
    if not scans:
        raise InputError(f"no scan's name contains '{config['only']}'")
    work = {"folder": folder, "workers": config["workers"], "sources": ESTIMATOR}
    names = [s.name for s in scans]
    common = {n: {"path": str(Path(config["scans"]) / f"{n}.npz"), "held": config["held"],
                  "cases": str(folder)} for n in names}
    lying = run_cases(laid, {
        f"laid_{n}": {key: common[n][key] for key in ("path", "held")} for n in names}, **work)
    isotropic = run_cases(best_isotropic, {
        f"isotropic_{n}": {**common[n], "count": config["isotropic"]} for n in names}, **work)
    found = run_cases(refined, {
        f"refined_{n}": {**common[n], "solves": config["solves"]} for n in names}, **work)
    estimates = {n: found[f"refined_{n}"]["estimate"]["cloth"] for n in names}
    exchange = run_cases(exchanged, {
        f"exchanged_{n}": {**common[n], "cloth": estimates[n], "thetas": {
            other: estimates[other]["theta"] for other in names if fabric(other) == fabric(n)}}
        for n in names}, **work)
    extended = {}
    if config["curvature"]:
        extended = run_cases(curved, {
            f"curved_{n}": {**common[n], "solves": config["curvature"],
                            "cloth": found[f"refined_{n}"]["cloth"]} for n in names}, **work)
    rubbed = run_cases(rubbing, {
        f"friction_{n}": {**common[n], "friction": config["friction"], "cloth": estimates[n]}
        for n in names}, **work)
    rows = []
    shapes = []
    for n in names:
        shapes.append(shape_of(**common[n]))
        positions = load_arrays(folder, f"refined_{n}")["positions"]
        row = {"scan": n, "registration": lying[f"laid_{n}"]["registration"],
               "isotropic": isotropic[f"isotropic_{n}"], "refined": found[f"refined_{n}"],
               "exchanged": exchange[f"exchanged_{n}"], "gaps": gaps(shapes[-1], positions),
               "friction": rubbed[f"friction_{n}"]}
        if extended:
            row["curved"] = extended[f"curved_{n}"]
        rows.append(row)
    summary = judge(rows)
    show(rows, summary, config["friction"])
    out = Path(config["out"])
    settings = {k: config[k] for k in ("solves", "isotropic", "held", "curvature", "friction")}
    write_report(out, {"settings": settings, "summary": summary, "scans": rows})
    draw(scans, shapes, rows, folder, out.with_suffix(".png"))


def gaps(shape: CapturedShape, positions: np.ndarray) -> dict:
    """What the distance between a drape (V, 3) m and the captured shape consists of.

    Millimetres, root mean squares over the hanging vertices: along the surface's normal and along
    the surface; and by place: near the support, in the middle, near the hem. ``phase`` is the share
    of the squared gap around the hem that a shift of the folds (each point of the hem's heights
    and distances from the axis compared with the best within a quarter of a fold) would take off.
    ``hem_lower`` is how much lower the simulated hem hangs on average.
    """
    radius = np.linalg.norm(shape.rest, axis=1)
    gap = 1e3 * (positions - shape.positions)
    hanging = shape.hanging
    normal = vertex_normals(shape.positions, shape.faces)
    across = (normal * gap).sum(1)
    along = np.linalg.norm(gap - across[:, None] * normal, axis=1)
    low, high = radius[hanging].min(), radius.max()
    bands = np.digitize(radius, low + (high - low) * np.array([1 / 3, 2 / 3]))

    def rms(values: np.ndarray) -> float:
        return float(np.sqrt((values**2).mean()))

    hem = radius > high - 1e-4
    order = np.argsort(np.arctan2(*shape.rest[hem].T[::-1]))
    profiles = [np.column_stack([np.hypot(p[hem, 0], p[hem, 1]), p[hem, 2]])[order]
                for p in (shape.positions, positions)]
    captured, simulated = (1e3 * p for p in profiles)
    reach = max(1, round(hem.sum() / 8 / 4))
    shifted = np.stack([((np.roll(simulated, k, axis=0) - captured) ** 2).sum(1)
                        for k in range(-reach, reach + 1)])
    window = 2 * reach + 1
    kernel = np.ones(window) / window
    # The shift must serve a whole neighbourhood, not one point.
    around = np.stack([np.convolve(np.r_[s[-reach:], s, s[:reach]], kernel, "valid")
                       for s in shifted])
    return {
        "across_mm": rms(across[hanging]),
        "along_mm": rms(along[hanging]),
        "bands_mm": [rms(np.linalg.norm(gap, axis=1)[hanging & (bands == k)]) for k in range(3)],
        "phase": float(1 - around.min(axis=0).sum() / around[reach].sum()),
        "hem_lower_mm": float((captured - simulated)[:, 1].mean()),
        "hem_inward_mm": float((captured - simulated)[:, 0].mean()),
    }


def judge(rows: list[dict]) -> dict:
    """The goals, and whether they are met."""
    mean = float(np.mean([r["refined"]["displacement_mm"] for r in rows]))
    points = [abs(r["refined"]["coefficient"] - r["refined"]["captured_coefficient"])
              for r in rows]
    better = [r["refined"]["displacement_mm"] < r["isotropic"]["displacement_mm"] for r in rows]
    ratios = {}
    for row in rows:
        alpha = sorted_alpha(row["refined"]["estimate"])
        ratios.setdefault(fabric(row["scan"]), []).append(alpha)
    agreement = {f: float(np.max([np.exp(np.abs(np.log(a / b))).max() for a in v for b in v]))
                 for f, v in ratios.items() if len(v) > 1}
    return {
        "mean_displacement_mm": mean,
        "mean_estimate_mm":
            float(np.mean([r["refined"]["estimate"]["displacement_mm"] for r in rows])),
        "mean_all_mm": float(np.mean([r["refined"]["all_mm"] for r in rows])),
        "mean_surface_mm": float(np.mean([r["refined"]["surface_mm"] for r in rows])),
        "isotropic_mean_displacement_mm":
            float(np.mean([r["isotropic"]["displacement_mm"] for r in rows])),
        "better_than_isotropic": int(np.sum(better)),
        "largest_coefficient_difference": float(max(points)),
        "most_solves": max(r["refined"]["solves"] for r in rows),
        "largest_ratio_of_samples": agreement,
        "passed": {"displacement": bool(mean <= GOAL_MM), "isotropic": bool(all(better)),
                   "coefficient": bool(max(points) <= GOAL_POINTS),
                   "samples": bool(max(agreement.values(), default=1.0) <= GOAL_RATIO)},
    }


def fabric(scan: str) -> str:
    """The fabric whose sample a scan of this name shows."""
    return scan.split("_sample")[0]


def sorted_alpha(result: dict) -> np.ndarray:
    """alpha (3,), µN·m: stiffer yarn direction, bias, softer, which the axes' names cannot swap."""
    warp, bias, weft = result["alpha_uN_m"]
    return np.array([max(warp, weft), bias, min(warp, weft)])


def show(rows: list[dict], summary: dict, friction: list[float]) -> None:
    """Print the tables and the goals."""
    print(table(
        ["scan", "isotropic, mm", "refined, mm", "all vertices, mm", "to the surface, mm",
         "curvature", "drape coefficient", "scan's", "solves", "with natural curvature, mm"],
        [[r["scan"], r["isotropic"]["displacement_mm"], r["refined"]["displacement_mm"],
          r["refined"]["all_mm"], r["refined"]["surface_mm"],
          f"{r['refined']['curvature']:.0%}", f"{r['refined']['coefficient']:.1f} %",
          f"{r['refined']['captured_coefficient']:.1f} %", r["refined"]["solves"],
          r["curved"]["displacement_mm"] if "curved" in r else "-"] for r in rows]))
    print()
    for title, of in (("estimate", lambda r: r["refined"]["estimate"]),
                      ("nearest drape", lambda r: r["refined"])):
        print(f"{title}:")
        print(table(
            ["scan", *(f"α {d}" for d in DIRECTIONS), *(f"β/α {d}, mm" for d in DIRECTIONS),
             "membrane, N/m", "warp, °", "let go, mm"],
            [[r["scan"], *of(r)["alpha_uN_m"], *of(r)["beta_over_alpha_mm"],
              of(r)["cloth"]["membrane"], float(np.degrees(of(r)["cloth"]["warp"])),
              of(r)["displacement_mm"]] for r in rows]))
        print()
    print(table(["scan", "across, mm", "along, mm", "fold phase", "scan's own vertices slid",
                 "registered, mm"],
                [[r["scan"], r["gaps"]["across_mm"], r["gaps"]["along_mm"],
                  f"{r['gaps']['phase']:.0%}", *(
                      ("no", "-") if r["registration"] is None else
                      (f"{r['registration']['edge_strain_before']:.1%}",
                       r["registration"]["mean_distance_mm"]))] for r in rows]))
    print("\nMisfit under the springs, with the scan's own estimate and those of other samples:")
    for row in rows:
        print(f"  {row['scan']}: {row['exchanged'][row['scan']]:.1f}; " + ", ".join(
            f"{other} {misfit:.1f}" if misfit else f"{other} did not settle"
            for other, misfit in row["exchanged"].items() if other != row["scan"]))
    print("\nThe estimate's cloth, let go from under its springs with friction, mm:")
    print(table(["scan", "under the springs", *(f"{torque:g} µN·m/m" for torque in friction)],
                [[r["scan"], *("-" if mm is None else mm for mm in
                               (r["friction"]["held_mm"], *r["friction"]["friction_mm"]))]
                 for r in rows]))
    print(f"mean {summary['mean_displacement_mm']:.2f} mm, goal {GOAL_MM:g}; better than isotropic "
          f"{summary['better_than_isotropic']} of {len(rows)}; drape coefficient within "
          f"{summary['largest_coefficient_difference']:.1f} points, goal {GOAL_POINTS:g}")
    for fabric, ratio in summary["largest_ratio_of_samples"].items():
        print(f"{fabric}: estimated α of its samples within a factor of {ratio:.2f}")


def draw(
    scans: list[Scan], shapes: list[CapturedShape], rows: list[dict], folder: Path, path: Path
) -> None:
    """Scan, drape, and its difference from the registered scan, a column each."""
    figure = Figure(figsize=(1.7 * len(scans) + 0.6, 5.4), layout="constrained")
    axes = figure.subplots(3, len(scans), squeeze=False)
    for column, scan, shape, row in zip(axes.T, scans, shapes, rows, strict=True):
        positions = load_arrays(folder, f"refined_{scan.name}")["positions"]
        for axis, points, faces in ((column[0], scan.positions, scan.faces),
                                    (column[1], positions, shape.faces)):
            axis.imshow(shade(points, faces, plate_radius=_STEM * DISC_RIG.plate_radius,
                              elevation=35.0, size=(320, 260)))
        gap = 1e3 * np.linalg.norm(positions - shape.positions, axis=1)
        image = column[2].tripcolor(*1e3 * shape.rest.T, shape.faces, gap, vmin=0, vmax=15,
                                    shading="gouraud", cmap="magma", rasterized=True)
        column[0].set_title(scan.name.replace("_sample_", "\n").replace("_capture_1", ""),
                            fontsize=8)
        column[1].set_title(f"{row['refined']['displacement_mm']:.1f} mm", fontsize=8)
        column[2].set_aspect("equal")
        for axis in column:
            axis.set_xticks([])
            axis.set_yticks([])
    figure.colorbar(image, ax=axes[2, :].tolist(), label="gap, mm, on the flat disc", shrink=0.9)
    write_figure(path, figure)


if __name__ == "__main__":
    run_command(main, usage=__doc__)
