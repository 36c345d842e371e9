"""The network on scans of real fabrics: agreement of estimates, and drapes predicted from them.

Every scan of a real drape on the disc rig (fabric_F_sample_S_capture_C.npz) is seen from four sides
by a depth camera on a tripod, with its noise (``configs/setup/real.yaml``), and estimated by the
network of that rig. The true moduli are unknown. So estimates are judged by their agreement:
between captures of a sample, between samples of a fabric, and by whether the nearest other estimate
is of the same fabric; and by drapes of one sample's estimate beside scans of the other samples.
Densities are unknown: moduli are those at 300 g/m².
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
    ESTIMATOR,
    Config,
    Result,
    load_arrays,
    run_cases,
    table,
    tick_short_scales,
)
from benchmarks.known import estimated
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

FOUR = (0.0, 0.0, 0.0, 1.0)  # shares of captures with 1, 2, ... views
LEVEL = 0.68  # of the picture's intervals
NAME = re.compile(r"fabric_(\d+)_sample_(\d+)(?:_capture_(\d+))?")
SHAPE = {"coefficient": "drape coefficient, points", "folds": "folds",
         "amplitude_mm": "outline's amplitude, mm"}
"""The figures of :func:`shape`, by name."""


@dataclass(frozen=True)
class Specimen:
    """Which drape a scan shows: numbers of the fabric, its sample, and the sample's capture."""

    fabric: int
    sample: int
    capture: int

    @classmethod
    def of(cls, scan: str) -> "Specimen":
        """From a scan's name; InputError where it is not such a one."""
        found = NAME.fullmatch(scan)
        if not found:
            raise InputError(f"the scan '{scan}' must be named fabric_F_sample_S_capture_C, with "
                             "numbers, to know which ones show one fabric")
        return cls(*(int(number or 1) for number in found.groups()))

    @property
    def of_sample(self) -> tuple[int, int]:
        """Fabric and sample."""
        return self.fabric, self.sample


def captured(path: str, checkpoint: str, captures: int, seed: int, identity: dict) -> dict:
    """The network's samples from ``captures`` renderings of the scan ``path``.

    ``identity`` says what the files of ``checkpoint`` hold.
    """
    from data.setups import Setups

    header, scan = read_header(checkpoint), read_scan(Path(path), DISC_RIG)
    setups = replace(Setups.load("real"), views=FOUR)
    nominal = CameraRig.load(DISC_RIG.name).intrinsics
    numbers = asdict(Specimen.of(scan.name)).values()
    samples, sensors = [], []
    for number in range(captures):
        rng = np.random.default_rng([seed, *numbers, number])
        seen = setups.capture(scan.positions, scan.faces, rng, nominal=nominal)
        samples.append(estimated(seen.views, seen.intrinsics, header).samples)
        sensors.append(seen.sensor)
    return {"sensors": sensors, "identity": identity,
            "arrays": {"samples": np.concatenate(samples)}}


def draped(theta: list[float], start: str, seed: int, edge_mm: float, nuisances: dict) -> dict:
    """:func:`shape` of a drape of theta (6,); its status alone where it did not converge."""
    # Scanned specimens have the rig's nominal size and lie centred on the support: so do these.
    result = drape(fabric_from_theta(np.array(theta)), rig=DISC_RIG, edge=1e-3 * edge_mm,
                   start=start, seed=seed, laws=Nuisances(**nuisances).laws)
    found = {"status": result.status.value}
    return found | shape(result.positions, result.rest, result.faces) if result.converged else found


def shape(positions: np.ndarray, rest: np.ndarray, faces: np.ndarray) -> dict[str, float]:
    """Figures of a drape on the disc rig that no turn of it changes.

    Args:
        positions: (V, 3), rest: (V, 2), m; faces: (F, 3).

    Returns:
        ``coefficient`` in percent, ``folds``, and ``amplitude_mm``: the root mean square of the
        outline's distance from the axis about its mean, which is that of its spectrum.
    """
    outline = fold_outline(positions, rest, DISC_RIG)
    radius = 1e3 * np.linalg.norm(outline, axis=1)
    return {"coefficient": 100 * drape_coefficient(positions, faces, DISC_RIG),
            "folds": len(fold_angles(outline)), "amplitude_mm": float(radius.std())}


def run(config: Config) -> Result:
    """Estimate, drape, and print the figures."""
    if config["captures"] < 1 or config["drapes"] < 0:
        raise InputError("give captures of 1 or more, drapes from 0")
    header = read_header(config["checkpoint"] or bundled(DISC_RIG.name))
    if header.rig != DISC_RIG.name:
        raise InputError(f"{header.path} knows drapes on {header.rig}; the scans are from "
                         f"{DISC_RIG.name}")
    scans = {Specimen.of(s.name): s for s in read_scans(Path(config["scans"]), DISC_RIG)}
    scans = {key: scans[key] for key in sorted(scans, key=lambda s: tuple(asdict(s).values()))}
    estimates = estimate_all(scans, header, config)
    log_alpha = {key: e.samples.mean(axis=0)[LINEAR] for key, e in estimates.items()}
    report = {"checkpoint": header.identity,
              "agreement": agreement(log_alpha),
              "recognition": recognition({key: e.samples.mean(axis=0) / e.spread
                                          for key, e in estimates.items()}),
              "scans": [row(scans[key], estimates[key]) for key in scans]}
    show(report)
    if config["drapes"]:
        report["drapes"] = drape_all(estimates, config)
        report["prediction"] = prediction(
            {key: shape(s.positions, s.rest, s.faces) for key, s in scans.items()},
            report["drapes"])
        show_prediction(report["prediction"])
    return Result(report, draw(estimates))


def estimate_all(
    scans: dict[Specimen, Scan], header: Header, config: dict[str, Any]
) -> dict[Specimen, Estimate]:
    """The estimate of every scan, of all its renderings together."""
    folder = Path(config["cases"])
    cases = {f"estimate_{scan.name}": {
        "path": str(Path(config["scans"]) / f"{scan.name}.npz"), "checkpoint": str(header.path),
        "identity": header.identity, "captures": config["captures"], "seed": config["seed"]}
        for scan in scans.values()}
    run_cases(captured, cases, folder=folder, workers=config["workers"], sources=ESTIMATOR)
    return {key: Estimate(load_arrays(folder, f"estimate_{scan.name}")["samples"], STIFF_SOFT, 0.0,
                          1.0, REFERENCE_DENSITY, header.spread) for key, scan in scans.items()}


def drape_all(
    estimates: dict[Specimen, Estimate], config: dict[str, Any]
) -> dict[str, list[dict]]:
    """Drapes of each sample's estimate, the median over its captures; by name of the sample."""
    spread, cases = nuisance_config(config["variation"]), {}
    for number, (sample, members) in enumerate(grouped(estimates, "of_sample").items()):
        samples = np.concatenate([estimates[key].samples for key in members])
        middle = replace(estimates[members[0]], samples=samples).theta
        for k in range(config["drapes"]):
            index = number * config["drapes"] + k
            cloth, own, rng = (stream(config["seed"], kind, index)
                               for kind in (Stream.CLOTH, Stream.SPECIMEN, Stream.START))
            cases[f"drape_{sample[0]}_{sample[1]}_{k}"] = {
                "theta": middle.tolist(), "start": config["start"],
                "seed": int(rng.integers(2**31)), "edge_mm": config["edge_mm"],
                "nuisances": {name: float(value) for name, value
                              in asdict(spread.sample(cloth, own)).items()}}
    found = run_cases(draped, cases, folder=Path(config["cases"]), workers=config["workers"])
    drapes: dict[str, list[dict]] = {}
    for name, result in found.items():
        drapes.setdefault(name.removeprefix("drape_").rpartition("_")[0], []).append(result)
    return drapes


def nuisance_config(name: str) -> NuisanceConfig:
    """Of the file ``name`` of configs/nuisances."""
    options = compose_config("generate", [f"nuisances={name}"], schema=Options)
    return config_from_options(options).sampling.nuisances


def grouped(keys: Sequence[Specimen], by: str) -> dict[Any, list[Specimen]]:
    """The scans with the same value of the attribute ``by``."""
    groups: dict[Any, list[Specimen]] = {}
    for key in keys:
        groups.setdefault(getattr(key, by), []).append(key)
    return groups


def ratio(one: np.ndarray, other: np.ndarray) -> float:
    """By which factor the alphas of log alpha (3,) and (3,) differ: geometric mean of three."""
    return float(np.exp(np.abs(one - other).mean()))


def agreement(log_alpha: dict[Specimen, np.ndarray]) -> dict[str, dict]:
    """Ratios of alpha between captures of a sample, samples of a fabric, and fabrics.

    Of samples and fabrics the means of log alpha (3,) of their parts count; ``single`` are single
    captures of two samples of a fabric.
    """
    members = {sample: [log_alpha[key] for key in keys]
               for sample, keys in grouped(log_alpha, "of_sample").items()}
    samples: dict[int, list[np.ndarray]] = {}
    for (fabric, _), parts in members.items():
        samples.setdefault(fabric, []).append(np.mean(parts, axis=0))
    pairs = {
        "captures": [ratio(*pair) for parts in members.values()
                     for pair in combinations(parts, 2)],
        "single": [ratio(log_alpha[one], log_alpha[other])
                   for one, other in combinations(log_alpha, 2)
                   if one.fabric == other.fabric and one.of_sample != other.of_sample],
        "samples": [ratio(*pair) for parts in samples.values() for pair in combinations(parts, 2)],
        "fabrics": [ratio(*pair) for pair in combinations(
            [np.mean(parts, axis=0) for parts in samples.values()], 2)],
    }
    return {name: {"median": float(np.median(values)) if values else None,
                   "largest": max(values, default=None), "pairs": len(values)}
            for name, values in pairs.items()}


def recognition(points: dict[Specimen, np.ndarray]) -> dict[str, dict]:
    """How often the nearest other scan shows the same fabric.

    Args:
        points: (D,) of each scan, in which distances are taken.

    Returns:
        ``any``, where every other scan may be the nearest, and ``other_sample``, where those of the
        same sample are left out: how many are ``right``, ``of`` how many scans whose fabric has
        another one to be found, and how many would be by ``chance``.
    """
    keys, result = list(points), {}
    for name, barred in (("any", lambda a, b: a == b),
                         ("other_sample", lambda a, b: a.of_sample == b.of_sample)):
        right, chance, count = 0, 0.0, 0
        for key in keys:
            others = [other for other in keys if not barred(key, other)]
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
    """How far drapes of one sample's estimate are from scans of the fabric's other samples.

    Args:
        scanned: :func:`shape` of each scan.
        drapes: of each sample's estimate; a sample none of whose converged predicts nothing.

    Returns:
        By figure of :func:`shape`, over all ordered pairs of samples: the median and the mean size
        of the difference of their means, ``off`` and ``mean_off``; the mean difference, ``bias``;
        the median size of that between the two samples' scans, ``scans``; beside the mean
        deviation of one estimate's drapes. The last entry counts.
    """
    members = grouped(scanned, "of_sample")
    settled = {sample: [d for d in drapes["{}_{}".format(*sample)] if d["status"] == "converged"]
               for sample in members}
    pairs = [(one, other) for one, other in permutations(members, 2)
             if one[0] == other[0] and settled[one]]
    if not pairs:
        raise InputError("nothing is predicted: no fabric has two samples, or no drape converged")
    result: dict[str, dict] = {}
    for figure in SHAPE:
        means = {sample: np.mean([scanned[key][figure] for key in keys])
                 for sample, keys in members.items()}
        each = {sample: [d[figure] for d in found] for sample, found in settled.items()}
        gaps = np.array([(np.mean(each[one]) - means[other], means[one] - means[other])
                         for one, other in pairs])
        off, scans = np.median(np.abs(gaps), axis=0)
        result[figure] = {"off": float(off), "mean_off": float(np.abs(gaps[:, 0]).mean()),
                          "bias": float(gaps[:, 0].mean()),
                          "scans": float(scans),
                          "deviation": float(np.mean([np.std(v) for v in each.values() if v]))}
    return result | {"count": {"pairs": len(pairs),
                               "drapes": sum(map(len, drapes.values())),
                               "converged": sum(map(len, settled.values()))}}


def row(scan: Scan, estimate: Estimate) -> dict:
    """One scan's figures: medians and intervals of alpha, and the posterior's mean."""
    alpha, _ = estimate.moduli(REFERENCE_DENSITY)
    low, middle, high = np.quantile(alpha / MICRO, [(1 - LEVEL) / 2, 0.5, (1 + LEVEL) / 2], axis=0)
    return {"scan": scan.name, "theta": estimate.samples.mean(axis=0).tolist(),
            "deviation": estimate.samples.std(axis=0).tolist(),
            "alpha_uN_m": middle.tolist(), "interval_68": np.transpose([low, high]).tolist()}


def show(report: dict) -> None:
    """Print the estimates and how they agree."""
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


def show_prediction(found: dict) -> None:
    """Print how well other samples' drapes are predicted."""
    print(table(["", "off, median", "mean", "bias", "between the samples' scans",
                 "deviation of one's drapes"],
                [[label, *(found[key][name] for name in ("off", "mean_off", "bias", "scans",
                                                         "deviation"))]
                 for key, label in SHAPE.items()]))
    count = found["count"]
    print(f"{count['converged']} of {count['drapes']} drapes converged, {count['pairs']} pairs of "
          "samples")
    print(f"drape coefficient of other samples off by: {found['coefficient']['off']:.2f} points")
    print(f"fold count of other samples off by: {found['folds']['off']:.2f}")


def draw(estimates: dict[Specimen, Estimate]) -> Figure:
    """Alpha of every scan with its interval, by fabric."""
    figure = Figure(figsize=(9.0, 7.5), layout="constrained")
    fabrics = list(grouped(estimates, "fabric"))
    alpha = {key: e.moduli(REFERENCE_DENSITY)[0] / MICRO for key, e in estimates.items()}
    for direction, axis in enumerate(figure.subplots(3, 1, sharex=True)):
        place = 0
        for number, fabric in enumerate(fabrics):
            begin = place
            for keys in grouped([k for k in estimates if k.fabric == fabric],
                                "of_sample").values():
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
        tick_short_scales(axis.yaxis)
    figure.suptitle("captures of a sample side by side, 68 % intervals", fontsize=9)
    return figure
