"""Effect of friction on estimates, and its identification from two drapes (002, section 7.7)."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.common import ESTIMATOR_SOURCES, label_log_axes
from benchmarks.comparison import compare
from benchmarks.known import estimate_views, plan_specimen
from benchmarks.physics.guides import guided
from common.errors import InputError
from data.cameras import CameraRig
from data.fabrics import fabric_from_theta
from data.sampling import STARTS
from drapenet.checkpoint import bundled, read_header
from drapenet.convention import LINEAR
from sim.cantilever.fabric import estimate
from sim.cantilever.tester import bending_length, simulate_strips
from sim.drape import DrapeResult, drape
from sim.energies.bending_friction import BendingFriction
from sim.energies.midedge import MidEdgeBending
from sim.laws import Laws
from sim.material import DIRECTIONS, MICRO, Fabric
from sim.measures import drape_coefficient
from sim.scene import Rig
from sim.sensitivity import follow
from studies.captured import ideal_setups, rms
from studies.study import Report, Study, run_fabrics

_STRIPS = (1.5, 2.5)  # lengths of the tester's strips, in bending lengths
REPEATS = 2  # starts of each fabric
HISTORIES = ("above", "below")
MEASURES = ("coefficient", "log_alpha")


def measure_drape(
    positions: np.ndarray, faces: np.ndarray, rig: str, *, seed: list[int], torque: float = 0.0
) -> dict[str, float]:
    """Drape coefficient, %, and mean log alpha (N·m) over directions, of positions (V, 3), m.

    "log_alpha" is the network's estimate, "given" that with the known friction ``torque``, N·m per
    metre.
    """
    nominal, header = CameraRig.load(rig).intrinsics, read_header(bundled(rig))
    capture = ideal_setups().capture(positions, faces, np.random.default_rng(seed), nominal=nominal)
    found, given = (
        float(estimate_views(capture.views, capture.intrinsics, header, friction=friction)
              .samples[:, LINEAR].mean()) for friction in (None, torque))
    return {"coefficient": 100 * drape_coefficient(positions, faces, Rig.from_name(rig)),
            "log_alpha": found, "given": given}


def raise_drape(
    above: DrapeResult, fabric: Fabric, torque: float, *, overshoot: float
) -> DrapeResult:
    """Equilibrium from below: release of the drape under ``overshoot`` times its weight."""
    heavy = follow(above, Fabric(fabric.alpha / overshoot, fabric.beta / overshoot), laws=Laws())
    bending = MidEdgeBending(heavy.mesh, heavy.scene.active, fabric=fabric)
    origin = bending.curvatures(heavy.state.q)
    return follow(heavy, fabric, laws=Laws(bending=BendingFriction(torque, origin)))


def case(
    *, number: int, rig: str, friction: list[float], overshoot: float, edge_mm: float, seed: int
) -> dict[str, Any]:
    """Measures of drapes of one fabric by torque and start, from above and from below; None where
    one of both did not converge. "tester" has log alpha by the cantilever tester, or None.
    """
    plan = plan_specimen(number, rig=rig, nuisances="none", seed=seed)
    fabric, result = fabric_from_theta(plan.theta), {"drapes": [], "tester": []}
    for torque in (MICRO * one for one in friction):
        laws, repeats = Laws(bending=BendingFriction(torque)), []
        for k in range(REPEATS):
            above = drape(fabric, rig=Rig.from_name(rig), edge=1e-3 * edge_mm, start=STARTS[-1 - k],
                          seed=k, laws=laws)
            below = raise_drape(above, fabric, torque, overshoot=overshoot)
            ends = {"above": above, "below": below}
            repeats.append({"apart_mm": 1e3 * compare(above, below).displacement} | {
                name: measure_drape(one.positions, one.faces, rig, seed=[seed, number, k],
                                    torque=torque)
                for name, one in ends.items()}
                if all(one.converged for one in ends.values()) else None)
        result["drapes"].append(repeats)
        result["tester"].append(tester_log_alpha(fabric, laws))
    return result


def tester_log_alpha(fabric: Fabric, laws: Laws) -> float | None:
    """Mean log alpha, N·m, by the simulated cantilever tester; None where it has no estimate."""
    lengths = {direction: [share * bending_length(alpha, fabric.density) for share in _STRIPS]
               for direction, alpha in zip(DIRECTIONS, fabric.alpha, strict=True)}
    try:
        strips = simulate_strips(fabric, lengths, width=None, across=3, laws=guided(laws, 3))
        found = estimate(strips, density=fabric.density, method="regression")
    except InputError:
        return None
    return float(np.mean([np.log(one.alpha) for one in found.values()]))


def run(config: dict[str, Any]) -> Report:
    """Run all rigs."""
    settings = {key: value for key, value in config.items() if key != "rigs"}
    return {"rigs": {
        rig: run_fabrics(case, settings | {"rig": rig, "fabrics": count},
                          sources=ESTIMATOR_SOURCES, subfolder=rig)
        for rig, count in config["rigs"].items()}}


def _values(report: Report, rig: str, history: str, measure: str) -> np.ndarray:
    """(F, torques, REPEATS) of a measure; empty ``history``: of both drapes; NaN: missing."""
    return np.array([[[np.nan if one is None else (one[history] if history else one)[measure]
                       for one in repeats]
                      for repeats in fabric["drapes"]]
                     for fabric in report["rigs"][rig].values()], float)


def _log_ratios(report: Report, rig: str) -> dict[str, np.ndarray]:
    """Log alpha (F, torques) of drapes from above and below, estimated by the network with unknown
    and known friction, and by the tester, minus the estimate from above without friction.
    """
    found = {}
    for measure in ("log_alpha", "given"):
        first = _values(report, rig, "above", measure)[:, :1]
        for history in HISTORIES:
            values = _values(report, rig, history, measure) - first
            found[f"{history}, {measure}"] = values.mean(axis=2)
    tester = np.array([one["tester"] for one in report["rigs"][rig].values()], float)
    return found | {"tester": tester - tester[:, :1]}


def _differences(report: Report, rig: str, measure: str) -> dict[str, np.ndarray]:
    """Differences (F, torques) between drapes: from above and below with the same folds, from
    different starts, and both.
    """
    above, below = (_values(report, rig, history, measure) for history in HISTORIES)
    return {"history": (above - below).mean(axis=2), "start": above[..., 0] - above[..., 1],
            "both": above[..., 0] - below[..., 1]}


def _finite_rms(values: np.ndarray) -> float:
    """Root mean square of the finite values."""
    return rms(values[np.isfinite(values)])


def precision(report: Report, rig: str, measure: str) -> float:
    """Standard deviation, µN·m per metre, of friction identified from two drapes, above and below.

    It is the standard deviation of the measure between starts divided by its median slope.
    """
    torque, found = np.array(report["settings"]["friction"]), _differences(report, rig, measure)
    slope = np.nanmedian(found["history"][:, 1:] / torque[1:])
    return _finite_rms(found["start"]) / float(slope)


def summarise(report: Report) -> str:
    """Summary in sentences."""
    rig, torque = next(iter(report["rigs"])), report["settings"]["friction"]
    last = torque.index(100.0) if 100.0 in torque else len(torque) - 1
    ratio = {name: np.exp(np.nanmedian(values[:, last]))
             for name, values in _log_ratios(report, rig).items()}
    by = {name: precision(report, rig, name) for name in MEASURES}
    return (
        f"{torque[last]:g} µN·m per metre change the network's α of a drape lowered from flat by "
        f"{ratio['above, log_alpha'] - 1:+.0%}, of one raised from below by "
        f"{ratio['below, log_alpha'] - 1:+.0%} (with known friction "
        f"{ratio['above, given'] - 1:+.0%} and {ratio['below, given'] - 1:+.0%}), and that of a "
        f"cantilever tester by {ratio['tester'] - 1:+.0%}. One drape of each kind identifies "
        f"friction to ± {by['log_alpha']:.0f} µN·m per metre with the network's α and to ± "
        f"{by['coefficient']:.0f} with the drape coefficient, which other folds change as much.")


def rows(report: Report) -> tuple[list[str], list[list[object]]]:
    """Table by rig and torque."""
    head = ["specimen", "friction, µN·m per metre", "α from above, times (friction known)",
            "α from below (friction known)", "α by cantilever", "above and below: mm", "points",
            "α, times", "other start: points", "α, times"]
    lines = []
    for rig in report["rigs"]:
        estimates = _log_ratios(report, rig)
        differences = {measure: _differences(report, rig, measure) for measure in MEASURES}
        displacement = _values(report, rig, "", "apart_mm")
        for k, torque in enumerate(report["settings"]["friction"]):
            times = {name: f"{np.exp(np.nanmedian(one[:, k])):.2f}"
                     for name, one in estimates.items()}
            lines.append([
                rig, f"{torque:g}",
                *(f"{times[f'{history}, log_alpha']} ({times[f'{history}, given']})"
                  for history in HISTORIES),
                times["tester"], f"{np.nanmedian(displacement[:, k]):.2f}",
                *_cells(*(np.nanmedian(one["history"][:, k]) for one in differences.values())),
                *_cells(*(_finite_rms(one["start"][:, k]) for one in differences.values()))])
    return head, lines


def _cells(points: float, log_alpha: float) -> tuple[str, str]:
    """Table cells of differences of the drape coefficient, points, and of log alpha."""
    return f"{points:.1f}", f"{np.exp(log_alpha):.2f}"


def draw(report: Report) -> Figure:
    """Plot alpha over torque, its ratio between histories, and repeats."""
    torque, rigs = np.array(report["settings"]["friction"]), list(report["rigs"])
    figure = Figure(figsize=(4 + 4 * len(rigs), 3.8), layout="constrained")
    first, *others = figure.subplots(1, 1 + len(rigs))
    names = {"above, log_alpha": "from above", "above, given": "from above, friction given",
             "below, log_alpha": "from below", "tester": "cantilever tester"}
    for k, (name, label) in enumerate(names.items()):
        low, middle, high = np.exp(np.nanpercentile(_log_ratios(report, rigs[0])[name],
                                                    [16, 50, 84], axis=0))
        first.plot(torque, middle, "o-", ms=3.5, color=f"C{k}", label=label)
        first.fill_between(torque, low, high, color=f"C{k}", alpha=0.12, lw=0)
    first.set(ylabel="α / α without friction", title=f"estimates, {rigs[0].partition('_')[0]}")
    for axes, rig in zip(others, rigs, strict=True):
        found = {name: np.exp(values) for name, values
                 in _differences(report, rig, "log_alpha").items()}
        axes.plot(torque, found["history"].T, ".-", lw=0.5, ms=4, color="C0", alpha=0.5)
        axes.plot(torque, np.nanmedian(found["history"], axis=0), "k", lw=2, label="same folds")
        places = np.broadcast_to(torque + 4, found["start"].shape)
        axes.plot(places.ravel(), found["start"].ravel(), "x", ms=4, color="C1",
                  label="both from above, another start")
        axes.set(ylabel="α from above / from below", title=f"histories, {rig.partition('_')[0]}")
    for axes in (first, *others):
        axes.set(yscale="log", xlabel="friction [µN·m/m]")
        label_log_axes(axes.yaxis)
        axes.legend(fontsize=8, frameon=False, loc="upper left")
    return figure


STUDY = Study(
    "friction", "Friction", "002, section 7.7 (hysteresis as a main source of errors)",
    "How does bending friction change an estimate, and can it be identified from a lowered and a "
    "raised drape?",
    run, summarise, rows, draw,
    "names hysteresis as a main source of errors, without a figure; not comparable.",
    "Friction is one step of Coulomb friction "
    "([physics](physics.md#natural-curvature-and-friction)), from the flat specimen for a drape "
    "from above and from the shape under twice its weight for one from below, which may add "
    "folds. A real specimen swings and may stop elsewhere. Friction on the support and in shear "
    "is not modelled. The precision is that of the median fabric. The network's α is the mean over "
    "directions; it was trained with 0 to 200 µN·m per metre from flat and assumes the mean where "
    "friction is unknown. Six denims of α = 14 to 22 µN·m have 500 to 1 000 µN·m per metre.")
