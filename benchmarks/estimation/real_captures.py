"""Agreement of the network's estimates of scanned real fabrics, and drapes predicted from them.

Every scan of a real drape on the disc rig (fabric_F_sample_S_capture_C.npz) is rendered in four
views with the poses and noise of ``configs/setup/real.yaml``, and estimated by the network of that
rig. The true moduli are unknown. Therefore the estimates are compared between captures of a sample
and between samples of a fabric, the nearest other estimate should be of the same fabric, and drapes
simulated with the estimate of one sample are compared with scans of the other samples. Densities
are unknown: moduli are those at 300 g/m².
"""

import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from itertools import combinations, permutations
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.common import (
    ESTIMATOR_SOURCES,
    Config,
    Result,
    label_log_axes,
    load_arrays,
    run_cases,
    table,
)
from benchmarks.known import estimate_views
from common.command import compose_config
from common.errors import InputError
from data.cameras import CameraRig
from data.fabrics import fabric_from_theta
from data.nuisances import NuisanceConfig, Nuisances
from data.options import Options, config_from_options
from data.sampling import Stream, stream
from data.scans import Scan, read_scan, read_scans
from drapenet.checkpoint import Header, bundled, read_header
from drapenet.convention import LINEAR, STIFF_SOFT
from drapenet.estimate import Estimate
from sim.drape import drape
from sim.material import MICRO, REFERENCE_DENSITY
from sim.measures import drape_coefficient, fold_angles, fold_outline
from sim.scene import DISC_RIG

FOUR_VIEWS = (0.0, 0.0, 0.0, 1.0)  # shares of captures with 1, 2, ... views
LEVEL = 0.68  # of the plotted intervals
NAME = re.compile(r"fabric_(\d+)_sample_(\d+)(?:_capture_(\d+))?")
SHAPE_LABELS = {"coefficient": "drape coefficient, points", "folds": "folds",
                "amplitude_mm": "outline's amplitude, mm"}
"""Labels of the values of :func:`shape_measures`."""


@dataclass(frozen=True)
class Specimen:
    """Identity of a scan: numbers of its fabric, sample and capture."""

    fabric: int
    sample: int
    capture: int

    @classmethod
    def from_scan_name(cls, scan: str) -> "Specimen":
        """Parse the name of a scan; InputError if it has another form."""
        found = NAME.fullmatch(scan)
        if not found:
            raise InputError(f"the scan '{scan}' must be named fabric_F_sample_S_capture_C, with "
                             "numbers, which identify scans of one fabric")
        return cls(*(int(number or 1) for number in found.groups()))

    @property
    def sample_key(self) -> tuple[int, int]:
        """Numbers of fabric and sample."""
        return self.fabric, self.sample


def estimate_scan(path: str, checkpoint: str, captures: int, seed: int, identity: dict) -> dict:
    """Posterior samples from ``captures`` renderings of the scan ``path``.

    ``identity`` has the digests of the files of ``checkpoint``.
    """
    from data.setups import Setups

    header, scan = read_header(checkpoint), read_scan(Path(path), DISC_RIG)
    setups = replace(Setups.load("real"), views=FOUR_VIEWS)
    nominal = CameraRig.load(DISC_RIG.name).intrinsics
    numbers = asdict(Specimen.from_scan_name(scan.name)).values()
    samples, sensors = [], []
    for number in range(captures):
        rng = np.random.default_rng([seed, *numbers, number])
        seen = setups.capture(scan.positions, scan.faces, rng, nominal=nominal)
        samples.append(estimate_views(seen.views, seen.intrinsics, header).samples)
        sensors.append(seen.sensor)
    return {"sensors": sensors, "identity": identity,
            "arrays": {"samples": np.concatenate(samples)}}


def drape_measures(
    theta: list[float], start: str, seed: int, edge_mm: float, nuisances: dict
) -> dict:
    """:func:`shape_measures` of a drape of theta (6,); only its status if it did not converge."""
    # Like the scanned specimens, these have the nominal size and are centred on the support.
    result = drape(fabric_from_theta(np.array(theta)), rig=DISC_RIG, edge=1e-3 * edge_mm,
                   start=start, seed=seed, laws=Nuisances(**nuisances).laws)
    found = {"status": result.status.value}
    if not result.converged:
        return found
    return found | shape_measures(result.positions, result.rest, result.faces)


def shape_measures(positions: np.ndarray, rest: np.ndarray, faces: np.ndarray) -> dict[str, float]:
    """Rotation-invariant figures of a drape on the disc rig.

    Args:
        positions: (V, 3), rest: (V, 2), m; faces: (F, 3).

    Returns:
        ``coefficient`` in percent, ``folds``, and ``amplitude_mm``: the standard deviation of the
        outline's distance from the axis.
    """
    outline = fold_outline(positions, rest, DISC_RIG)
    radius = 1e3 * np.linalg.norm(outline, axis=1)
    return {"coefficient": 100 * drape_coefficient(positions, faces, DISC_RIG),
            "folds": len(fold_angles(outline)), "amplitude_mm": float(radius.std())}


def run(config: Config) -> Result:
    """Estimate all scans, simulate drapes of the estimates; print agreement and differences."""
    if config["captures"] < 1 or config["drapes"] < 0:
        raise InputError(f"captures={config['captures']} must be at least 1, "
                         f"drapes={config['drapes']} at least 0")
    header = read_header(config["checkpoint"] or bundled(DISC_RIG.name))
    if header.rig != DISC_RIG.name:
        raise InputError(f"{header.path} was trained on {header.rig}; the scans are of "
                         f"{DISC_RIG.name}")
    scans = {Specimen.from_scan_name(s.name): s
             for s in read_scans(Path(config["scans"]), DISC_RIG)}
    scans = {key: scans[key] for key in sorted(scans, key=lambda s: tuple(asdict(s).values()))}
    estimates = estimate_all(scans, header, config)
    log_alpha = {key: e.samples.mean(axis=0)[LINEAR] for key, e in estimates.items()}
    report = {"checkpoint": header.identity,
              "agreement": agreement(log_alpha),
              "recognition": recognition({key: e.samples.mean(axis=0) / e.spread
                                          for key, e in estimates.items()}),
              "scans": [scan_row(scans[key], estimates[key]) for key in scans]}
    print_agreement(report)
    if config["drapes"]:
        report["drapes"] = drape_all(estimates, config)
        report["prediction"] = prediction(
            {key: shape_measures(s.positions, s.rest, s.faces) for key, s in scans.items()},
            report["drapes"])
        print_prediction(report["prediction"])
    return Result(report, draw(estimates))


def estimate_all(
    scans: dict[Specimen, Scan], header: Header, config: dict[str, Any]
) -> dict[Specimen, Estimate]:
    """Estimate of every scan from all its renderings."""
    folder = Path(config["cases"])
    cases = {f"estimate_{scan.name}": {
        "path": str(Path(config["scans"]) / f"{scan.name}.npz"), "checkpoint": str(header.path),
        "identity": header.identity, "captures": config["captures"], "seed": config["seed"]}
        for scan in scans.values()}
    run_cases(estimate_scan, cases, folder=folder, workers=config["workers"],
              sources=ESTIMATOR_SOURCES)
    return {key: Estimate(load_arrays(folder, f"estimate_{scan.name}")["samples"], STIFF_SOFT, 0.0,
                          1.0, REFERENCE_DENSITY, header.spread) for key, scan in scans.items()}


def drape_all(
    estimates: dict[Specimen, Estimate], config: dict[str, Any]
) -> dict[str, list[dict]]:
    """Drapes of each sample's estimate, the median over its captures, by name of the sample."""
    spread, cases = nuisance_config(config["variation"]), {}
    for number, (sample, members) in enumerate(group_by(estimates, "sample_key").items()):
        samples = np.concatenate([estimates[key].samples for key in members])
        middle = replace(estimates[members[0]], samples=samples).theta
        for k in range(config["drapes"]):
            index = number * config["drapes"] + k
            cloth, cut, rng = (stream(config["seed"], kind, index)
                               for kind in (Stream.CLOTH, Stream.SPECIMEN, Stream.START))
            cases[f"drape_{sample[0]}_{sample[1]}_{k}"] = {
                "theta": middle.tolist(), "start": config["start"],
                "seed": int(rng.integers(2**31)), "edge_mm": config["edge_mm"],
                "nuisances": {name: float(value) for name, value
                              in asdict(spread.sample(cloth, cut)).items()}}
    found = run_cases(drape_measures, cases, folder=Path(config["cases"]),
                      workers=config["workers"])
    drapes: dict[str, list[dict]] = {}
    for name, result in found.items():
        drapes.setdefault(name.removeprefix("drape_").rpartition("_")[0], []).append(result)
    return drapes


def nuisance_config(name: str) -> NuisanceConfig:
    """Distribution of nuisances from the file ``name`` of configs/nuisances."""
    options = compose_config("generate", [f"nuisances={name}"], schema=Options)
    return config_from_options(options).sampling.nuisances


def group_by(keys: Sequence[Specimen], by: str) -> dict[Any, list[Specimen]]:
    """Group the scans by the value of the attribute ``by``."""
    groups: dict[Any, list[Specimen]] = {}
    for key in keys:
        groups.setdefault(getattr(key, by), []).append(key)
    return groups


def ratio(one: np.ndarray, other: np.ndarray) -> float:
    """Factor between the alphas of log alpha (3,) and (3,), geometric mean over directions."""
    return float(np.exp(np.abs(one - other).mean()))


def agreement(log_alpha: dict[Specimen, np.ndarray]) -> dict[str, dict]:
    """Ratios of alpha between captures of a sample, samples of a fabric, and fabrics.

    Samples are compared by the means of log alpha (3,) of their captures, fabrics by the means of
    their samples; ``single`` compares single captures of two samples of a fabric.
    """
    members = {sample: [log_alpha[key] for key in keys]
               for sample, keys in group_by(log_alpha, "sample_key").items()}
    samples: dict[int, list[np.ndarray]] = {}
    for (fabric, _), parts in members.items():
        samples.setdefault(fabric, []).append(np.mean(parts, axis=0))
    pairs = {
        "captures": [ratio(*pair) for parts in members.values()
                     for pair in combinations(parts, 2)],
        "single": [ratio(log_alpha[one], log_alpha[other])
                   for one, other in combinations(log_alpha, 2)
                   if one.fabric == other.fabric and one.sample_key != other.sample_key],
        "samples": [ratio(*pair) for parts in samples.values() for pair in combinations(parts, 2)],
        "fabrics": [ratio(*pair) for pair in combinations(
            [np.mean(parts, axis=0) for parts in samples.values()], 2)],
    }
    return {name: {"median": float(np.median(values)) if values else None,
                   "largest": max(values, default=None), "pairs": len(values)}
            for name, values in pairs.items()}


def recognition(points: dict[Specimen, np.ndarray]) -> dict[str, dict]:
    """Number of scans whose nearest other scan is of the same fabric.

    Args:
        points: (D,) of each scan, with Euclidean distances.

    Returns:
        For ``any`` other scan, and for scans of an ``other_sample``: the number ``right``, the
        number ``of`` scans whose fabric has another eligible scan, and the number expected by
        ``chance``.
    """
    keys, result = list(points), {}
    for name, excluded in (("any", lambda a, b: a == b),
                           ("other_sample", lambda a, b: a.sample_key == b.sample_key)):
        right, chance, count = 0, 0.0, 0
        for key in keys:
            others = [other for other in keys if not excluded(key, other)]
            share = np.mean([other.fabric == key.fabric for other in others])
            if not share > 0:
                continue
            gaps = [np.linalg.norm(points[other] - points[key]) for other in others]
            right += others[int(np.argmin(gaps))].fabric == key.fabric
            chance, count = chance + float(share), count + 1
        result[name] = {"right": int(right), "of": count, "chance": chance}
    return result


def prediction(
    scanned: dict[Specimen, dict], drapes: dict[str, list[dict]]
) -> dict[str, dict[str, float]]:
    """Differences of drapes of a sample's estimate from scans of the fabric's other samples.

    Args:
        scanned: :func:`shape_measures` of each scan.
        drapes: of each sample's estimate; samples without a converged drape are not used.

    Returns:
        For each value of :func:`shape_measures`, over all ordered pairs of samples: the median and
        the mean absolute difference of their means, ``off`` and ``mean_off``; the mean
        difference, ``bias``; the median absolute difference of the two samples' scans,
        ``scans``; and ``deviation``, the mean standard deviation over the drapes of an estimate.
        ``count`` has the numbers of pairs and drapes.
    """
    members = group_by(scanned, "sample_key")
    converged = {sample: [d for d in drapes["{}_{}".format(*sample)] if d["status"] == "converged"]
                 for sample in members}
    pairs = [(one, other) for one, other in permutations(members, 2)
             if one[0] == other[0] and converged[one]]
    if not pairs:
        raise InputError("no prediction: no fabric has two samples, or no drape converged")
    result: dict[str, dict] = {}
    for figure in SHAPE_LABELS:
        means = {sample: np.mean([scanned[key][figure] for key in keys])
                 for sample, keys in members.items()}
        each = {sample: [d[figure] for d in found] for sample, found in converged.items()}
        gaps = np.array([(np.mean(each[one]) - means[other], means[one] - means[other])
                         for one, other in pairs])
        off, scans = np.median(np.abs(gaps), axis=0)
        result[figure] = {"off": float(off), "mean_off": float(np.abs(gaps[:, 0]).mean()),
                          "bias": float(gaps[:, 0].mean()),
                          "scans": float(scans),
                          "deviation": float(np.mean([np.std(v) for v in each.values() if v]))}
    return result | {"count": {"pairs": len(pairs),
                               "drapes": sum(map(len, drapes.values())),
                               "converged": sum(map(len, converged.values()))}}


def scan_row(scan: Scan, estimate: Estimate) -> dict:
    """Results of one scan: medians and intervals of alpha, mean and deviation of the posterior."""
    alpha, _ = estimate.moduli(REFERENCE_DENSITY)
    low, middle, high = np.quantile(alpha / MICRO, [(1 - LEVEL) / 2, 0.5, (1 + LEVEL) / 2], axis=0)
    return {"scan": scan.name, "theta": estimate.samples.mean(axis=0).tolist(),
            "deviation": estimate.samples.std(axis=0).tolist(),
            "alpha_uN_m": middle.tolist(), "interval_68": np.transpose([low, high]).tolist()}


def print_agreement(report: dict) -> None:
    """Print the estimates and their agreement."""
    print(table(["scan", *(f"α {name}" for name in STIFF_SOFT),
                 *(f"β/α {name}, mm" for name in STIFF_SOFT)],
                [[r["scan"], *r["alpha_uN_m"], *(1e3 * v for v in r["theta"][3:])]
                 for r in report["scans"]]))
    names = {"captures": "captures of a sample", "single": "single captures of two samples",
             "samples": "samples of a fabric", "fabrics": "fabrics"}
    for name, found in report["agreement"].items():
        if found["pairs"]:
            print(f"median ratio of alpha between {names[name]}: {found['median']:.3f}")
    for kind, rule in (("any", ""), ("other_sample", " among other samples")):
        found = report["recognition"][kind]
        print(f"nearest neighbour{rule} right: {found['right']} of {found['of']}, by chance "
              f"{found['chance']:.1f}")


def print_prediction(found: dict) -> None:
    """Print the differences between predicted drapes and scans of other samples."""
    print(table(["", "difference, median", "mean", "bias", "between the samples' scans",
                 "deviation over drapes"],
                [[label, *(found[key][name] for name in ("off", "mean_off", "bias", "scans",
                                                         "deviation"))]
                 for key, label in SHAPE_LABELS.items()]))
    count = found["count"]
    print(f"{count['converged']} of {count['drapes']} drapes converged, {count['pairs']} pairs of "
          "samples")
    print(f"median error of the drape coefficient: {found['coefficient']['off']:.2f} points")
    print(f"median error of the number of folds: {found['folds']['off']:.2f}")


def draw(estimates: dict[Specimen, Estimate]) -> Figure:
    """Plot alpha of every scan with its interval, grouped by fabric."""
    figure = Figure(figsize=(9.0, 7.5), layout="constrained")
    fabrics = list(group_by(estimates, "fabric"))
    alpha = {key: e.moduli(REFERENCE_DENSITY)[0] / MICRO for key, e in estimates.items()}
    for direction, axis in enumerate(figure.subplots(3, 1, sharex=True)):
        place = 0
        for number, fabric in enumerate(fabrics):
            begin = place
            for keys in group_by([k for k in estimates if k.fabric == fabric],
                                 "sample_key").values():
                for key in keys:
                    low, middle, high = np.quantile(
                        alpha[key][:, direction], [(1 - LEVEL) / 2, 0.5, (1 + LEVEL) / 2])
                    axis.errorbar(place, middle, [[middle - low], [high - middle]], fmt="o", ms=3,
                                  lw=1.0, color=f"C{number % 10}")
                    place += 1
                place += 0.7  # between samples
            axis.annotate(f"fabric {fabric}", ((begin + place - 1.7) / 2, 1.0),
                          xycoords=("data", "axes fraction"), ha="center", va="bottom", fontsize=8)
            place += 1.5  # between fabrics
        axis.set(yscale="log", xticks=[], ylabel=f"α {STIFF_SOFT[direction]}, µN·m")
        label_log_axes(axis.yaxis)
    figure.suptitle("captures of a sample side by side, 68 % intervals", fontsize=9)
    return figure
