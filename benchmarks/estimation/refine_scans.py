"""Refinement of scans of drapes.

Each scan on the disc rig is estimated as by ``infer.py scan=FILE refine=scan``. The moduli of the
real fabrics are unknown; reported are the distance of the estimate's drape from the scan and the
agreement of estimates (:mod:`benchmarks.estimation.real_captures`). Densities are unknown: moduli
are those at 300 g/m². With ``simulated=N`` the scans are point clouds of N drapes of known fabrics,
simulated on a finer mesh with all nuisances, with noise.
"""

import json
import math
from dataclasses import astuple
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from benchmarks.common import ESTIMATOR_SOURCES, Config, Result, load_arrays, run_cases, table
from benchmarks.estimation.real_captures import Specimen, agreement, recognition
from benchmarks.estimation.refine_views import (
    METHODS,
    along_warp,
    nuisance_errors,
    posterior_errors,
)
from benchmarks.known import known_drape
from common.errors import InputError
from data.picture import shade
from data.scans import read_scans
from drapenet.checkpoint import bundled, read_header
from drapenet.convention import LINEAR, STIFF_SOFT, SWAPPED
from drapenet.estimate import Estimate
from drapenet.joint import joined
from sim.material import MICRO, REFERENCE_DENSITY
from sim.scene import DISC_RIG

if TYPE_CHECKING:
    from drapenet.refine.scans import Registered

_STEM_RADIUS = 0.3  # radius of the stem below the support in figures, relative to the support's
JOINED_COUNTS = (1, 2, 4)  # scans of a fabric in a joint estimate
_TRUTH_MM = 2.0  # mesh edges at the rim of simulated specimens


def real(*, path: str) -> dict:
    """Refine the scan in a file."""
    from drapenet.refine.scans import read_shape

    return refine_scan(read_shape(Path(path), DISC_RIG))


def simulated(*, number: int, noise_mm: float, seed: int) -> dict:
    """Refine a simulated raw scan of a known fabric."""
    from drapenet.refine.scans import EDGE, register
    from drapenet.refine.surface import Cloud

    plan, shape = known_drape(number, rig=DISC_RIG.name, nuisances="real", edge_mm=_TRUTH_MM,
                               seed=seed)
    noise = np.random.default_rng([seed, number]).normal(0, 1e-3 * noise_mm, shape.positions.shape)
    cloud = Cloud.of_mesh(shape.positions + noise, shape.faces)
    result = refine_scan(register(cloud, DISC_RIG, edge=EDGE))
    arrays, along = result["arrays"], math.cos(2 * result["axis"]) >= 0
    for way in () if along else METHODS:  # the true warp is the x axis of the scan
        arrays[way] = arrays[way][:, SWAPPED]
    return result | {"truth": plan.theta.tolist(), "nuisances": plan.nuisances.vector.tolist(),
                     "specimen": along_warp(result["refined"]["specimen"], along)}


def refine_scan(scan: "Registered") -> dict:
    """Estimate a scan as by ``infer.py scan=FILE refine=scan``."""
    from drapenet.estimate import make_estimate
    from drapenet.inference import infer_capture
    from drapenet.refine.refined import refined_capture
    from drapenet.refine.scans import scan_capture
    from drapenet.refine.search import CapturedScan

    header, shape = read_header(bundled(DISC_RIG.name)), scan.shape
    capture = scan_capture(Path("scan"), shape, REFERENCE_DENSITY)
    inferred = infer_capture(capture, header)
    estimate, camera, found = inferred.estimate, inferred.camera, inferred.found
    result = refined_capture(estimate, capture, camera, turns=found.turns,
                             seen=CapturedScan(shape), known={})
    if result is None:
        raise InputError("no simulated cloth converges at the scan")
    network = estimate.samples
    if result.draws is not None:
        estimate = make_estimate(result.draws, capture=capture, header=header)
    shown = result.found.released or result.found.best.drape
    arrays = {"refined": estimate.samples, "network": network, "positions": shape.positions,
              "rest": shape.rest, "faces": shape.faces, "drape": shown.positions}
    return {"refined": result.content, "theta": estimate.samples.mean(axis=0).tolist(),
            "gained": result.draws is not None, "axis": estimate.axis,
            "seconds": result.found.seconds, "registered_mm": 1e3 * scan.distance,
            "spread": estimate.spread.tolist(), "doubts": list(result.doubts), "arrays": arrays}


def run(config: Config) -> Result:
    """Refine all scans; print the tables."""
    folder = Path(config["cases"])
    work = {"folder": folder, "workers": config["workers"], "sources": ESTIMATOR_SOURCES}
    if config["simulated"]:
        results = run_cases(simulated, {
            f"simulated_{k}": {"number": k, "noise_mm": config["noise_mm"], "seed": config["seed"]}
            for k in range(config["simulated"])}, **work)
        truth = np.array([r["truth"] for r in results.values()])
        arrays = [load_arrays(folder, name) for name in results]
        summary = {way: posterior_errors(truth, [own[way] for own in arrays]) for way in METHODS}
        summary["specimen"] = nuisance_errors(list(results.values()))
        for name, found in summary.items():
            print(f"{name}: {json.dumps(found)}")
    else:
        names = [s.name for s in read_scans(Path(config["scans"]), DISC_RIG)
                 if config["only"] in s.name]
        if not names:
            raise InputError(f"no scan's name contains '{config['only']}'")
        results = run_cases(real, {
            name: {"path": str(Path(config["scans"]) / f"{name}.npz")} for name in names}, **work)
        summary = agreements(results, folder)
    away = [r["refined"].get("fidelity", {}).get("displacement_mm") for r in results.values()]
    rest = [value for value in away if value is not None]
    seconds = float(np.median([r["seconds"] for r in results.values()]))
    print(f"drapes released at the scan move by {np.mean(rest):.2f} mm on average, at most "
          f"{max(rest):.1f} mm; {len(away) - len(rest)} did not converge; "
          f"{sum(bool(r['doubts']) for r in results.values())} with a warning; "
          f"median {seconds:.0f} s")
    return Result({"summary": summary, "mean_away_mm": float(np.mean(rest)), "seconds": seconds,
                   "scans": results}, draw(list(results), folder))


def agreements(results: dict[str, dict], folder: Path) -> dict:
    """Agreement of estimates of captures, samples and fabrics; prints it."""
    arrays = {Specimen.from_scan_name(name): load_arrays(folder, name) for name in results}
    samples = {key: own["refined"] for key, own in arrays.items()}
    spread = np.array(next(iter(results.values()))["spread"])
    log_alpha = {key: s.mean(axis=0)[LINEAR] for key, s in samples.items()}
    print(table(["scan", *(f"α {name}" for name in STIFF_SOFT), "friction, µN·m per m",
                 "released, mm", "s"],
                [[name, *(np.exp(log_alpha[Specimen.from_scan_name(name)]) / MICRO).tolist(),
                  r["refined"]["specimen"].get("friction_un", {}).get("median", math.nan),
                  r["refined"].get("fidelity", {}).get("displacement_mm", math.nan), r["seconds"]]
                 for name, r in results.items()]))
    summary = {"agreement": agreement(log_alpha),
               "recognition": recognition({k: s.mean(axis=0) / spread
                                           for k, s in samples.items()})}
    summary["joined"] = {
        way: {count: recognition(joined_groups({key: own[way] for key, own in arrays.items()},
                                               spread, count))["any"] for count in JOINED_COUNTS}
        for way in METHODS}
    for name, found in summary["agreement"].items():
        if found["pairs"]:
            print(f"median ratio of alpha between {name}: {found['median']:.3f}")
    for kind, found in summary["recognition"].items():
        print(f"{kind}: nearest neighbour right {found['right']} of {found['of']}")
    for way, counts in summary["joined"].items():
        for count, found in counts.items():
            print(f"{way}, {count} scans joined: nearest neighbour right {found['right']} of "
                  f"{found['of']}")
    return summary


def joined_groups(
    samples: dict[Specimen, np.ndarray], spread: np.ndarray, count: int
) -> dict[Specimen, np.ndarray]:
    """Joint estimates (6,) of every ``count`` scans of a fabric, in units of the spread (6,)."""
    found = {}
    for fabric in sorted({key.fabric for key in samples}):
        members = [Estimate(samples[key], STIFF_SOFT, 0.0, 1.0, REFERENCE_DENSITY, spread)
                   for key in sorted(samples, key=astuple) if key.fabric == fabric]
        for group in range(len(members) // count):
            chosen = members[group * count : (group + 1) * count]
            one = joined(chosen, [""] * count).samples if count > 1 else chosen[0].samples
            found[Specimen(fabric, group, 1)] = one.mean(axis=0) / spread
    return found


def draw(names: list[str], folder: Path, *, shown: int = 9) -> Figure:
    """Plot scan, drape of the estimate and their distance, one column per scan."""
    names = names[:: -(-len(names) // shown)]
    figure = Figure(figsize=(1.7 * len(names) + 0.6, 5.4), layout="constrained")
    axes = figure.subplots(3, len(names), squeeze=False)
    for column, name in zip(axes.T, names, strict=True):
        scan = load_arrays(folder, name)
        for axis, positions in zip(column, (scan["positions"], scan["drape"]), strict=False):
            axis.imshow(shade(positions, scan["faces"], elevation=35.0, size=(320, 260),
                              plate_radius=_STEM_RADIUS * DISC_RIG.plate_radius))
        gap = 1e3 * np.linalg.norm(scan["drape"] - scan["positions"], axis=1)
        image = column[2].tripcolor(*1e3 * scan["rest"].T, scan["faces"], gap, vmin=0, vmax=15,
                                    shading="gouraud", cmap="magma", rasterized=True)
        column[0].set_title(name.replace("_sample_", "\n").replace("_capture_1", ""), fontsize=8)
        column[2].set_aspect("equal")
        for axis in column:
            axis.set_xticks([])
            axis.set_yticks([])
    figure.colorbar(image, ax=axes[2, :].tolist(), label="distance, mm, on the disc", shrink=0.9)
    return figure
