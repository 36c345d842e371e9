"""The posterior bound: how well four depth views of a drape determine its fabric at best.

The bound of the six moduli (:mod:`benchmarks.estimation.bound`) of fabrics of the prior ``vae``,
each draped twice: as a specimen with nuisances of configs/nuisances/real.yaml, and without any.
Four depth views of 240 × 180 pixels are taken by the nominal camera. Unknown in every row are the
specimen's turn and offset on the plate and the camera's pose. A row is the root mean square, over
fabrics and the three directions, of the least standard deviation of an estimate that knows the
distributions of moduli and nuisances.

Depths have a standard deviation of 1 mm, and one pixel in a hundred counts as an independent
measurement. The local errors of ``sensor=smooth`` are 1.0 mm and correlated such that one pixel in
twenty is independent; the rest is a margin for errors of whole pictures, which have no columns.
"""


import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

from benchmarks.common import Config, Result, table, tick_short_scales
from benchmarks.estimation.bound import CAMERA, SETUP, SPECIMEN, bounds, depth_information
from common.command import compose_config
from data.cameras import CameraRig
from data.fabrics import THETA_NAMES, fabric_from_theta
from data.nuisances import NAMES, Nuisances
from data.options import Options, config_from_options
from data.prior import load_prior
from data.sampling import SamplingConfig, Stream, plan_drape, stream
from data.setups import Setups
from sim.drape import drape
from sim.scene import Rig

MM = 1e3
MODULI = {"log_alpha": slice(0, 3), "beta_over_alpha": slice(3, 6)}
WITHOUT, KNOWN, ALL = "no nuisances", "all nuisances known", "all nuisances unknown"
DRAWN = (WITHOUT, KNOWN, ALL)
MEASURED = ("membrane", "friction")
"""Nuisances that a user may have measured."""


def sampling(seed: int) -> SamplingConfig:
    """How fabrics and specimens are drawn: as in a dataset, but for soft fabrics as they are."""
    words = ["dataset=specimens", "dataset.soft_share=0", "nuisances=real", f"seed={seed}"]
    return config_from_options(compose_config("generate", words, schema=Options)).sampling


def unknowns(config: SamplingConfig) -> dict[str, dict[str, float]]:
    """What is unknown in each row of the table of drapes with nuisances, and its deviations."""
    pose = dict.fromkeys((SPECIMEN[0], *CAMERA), np.inf)
    pose |= dict.fromkeys(SPECIMEN[1:], config.drift)
    own, setup = config.nuisances.deviations, Setups.load()
    table_and_focal = dict(zip(SETUP, (*[setup.turn] * 3, setup.focal), strict=True))
    rest = {name: own[name] for name in NAMES if name not in MEASURED}
    return {
        KNOWN: pose,
        **{name: pose | {name: own[name]} for name in NAMES},
        f"all but {' and '.join(MEASURED)}": pose | rest,
        ALL: pose | own,
        f"{ALL}, turntable and focal length too": pose | own | table_and_focal,
    }


def one_fabric(index: int, seed: int, edge_mm: float, noise_mm: float, pixels: float) -> dict:
    """Bounds of fabric ``index``, (6,) by row; None where a drape has no derivatives."""
    config, prior = sampling(seed), load_prior("gaussian").covariance
    plan = plan_drape(index, config=config, prior=load_prior("vae"))
    fabric, rows = fabric_from_theta(plan.theta), unknowns(config)
    turn = 2 * np.pi * float(stream(seed, Stream.VIEWS, index).random())
    case = {"theta": plan.theta.tolist(), "nuisances": plan.nuisances.vector.tolist(),
            "bounds": {}, "messages": []}
    for nuisances, own in ((Nuisances(), {WITHOUT: rows[KNOWN]}), (plan.nuisances, rows)):
        result = drape(fabric, rig=nuisances.rig(Rig()), edge=1e-3 * edge_mm, start=plan.start,
                       seed=plan.seed, offset=tuple(plan.offset), laws=nuisances.laws)
        found = depth_information(result, CameraRig.load().nominal(), nuisances=nuisances,
                                  orientation=turn, noise=noise_mm / MM,
                                  pixels_per_measurement=pixels)
        if not found.ok:
            case["messages"].append(found.message)
        case["bounds"] |= {
            name: bounds(found.posterior(prior, unknown)).tolist() if found.ok else None
            for name, unknown in own.items()}
    return case


def summarise(cases: list[dict], spread: np.ndarray) -> dict[str, dict[str, float]]:
    """Root mean squares over fabrics and directions, by row.

    Args:
        spread: (6,) standard deviations of theta over fabrics, the unit of "standardised" ones.
    """
    def rms(values: np.ndarray) -> dict[str, float]:
        return {name: float(np.sqrt((values[:, part] ** 2).mean()))
                for name, part in MODULI.items()}

    summary = {}
    for row in cases[0]["bounds"]:
        found = np.array([case["bounds"][row] for case in cases])
        summary[row] = rms(found) | {
            f"standardised_{name}": value for name, value in rms(found / spread).items()}
    return summary


def run(config: Config) -> Result:
    """Find the bounds, and print the table."""
    settings = {key: config[key] for key in ("seed", "edge_mm", "noise_mm", "pixels")}
    cases = [one_fabric(k, **settings) for k in tqdm(range(config["fabrics"]), unit="fabric")]
    spread = load_prior("gaussian").deviation
    failed = [message for case in cases for message in case.pop("messages")]
    good = [case for case in cases if None not in case["bounds"].values()]
    report = {
        "parameters": THETA_NAMES,
        "nuisances": NAMES,
        "spread": spread.tolist(),
        "without_derivatives": failed,
        "rms": summarise(good, spread) if good else {},
        "fabrics": [case | {"bounds": {row: case["bounds"][row] for row in DRAWN}}
                    for case in good],
    }
    if failed:
        print("without derivatives:", "; ".join(failed))
    if not good:
        return Result(report)
    show(report)
    return Result(report, draw(report))


def show(report: dict) -> None:
    """Print the table, and the two bounds that estimators are compared with."""
    print(table(
        ["unknown beside moduli and pose", "log alpha", "beta/alpha, mm",
         "log alpha, of the spread", "beta/alpha, of the spread"],
        [[name, row["log_alpha"], MM * row["beta_over_alpha"],
          row["standardised_log_alpha"], row["standardised_beta_over_alpha"]]
         for name, row in report["rms"].items()]))
    for name in (WITHOUT, ALL):
        row = report["rms"][name]
        print(f"posterior bound: log alpha {row['standardised_log_alpha']:.3f}, beta/alpha "
              f"{row['standardised_beta_over_alpha']:.3f} of the spread over fabrics ({name})")


def draw(report: dict) -> Figure:
    """Bounds of each fabric by its stiffness, of a report."""
    figure = Figure(figsize=(8.0, 3.6), layout="constrained")
    theta = np.array([case["theta"] for case in report["fabrics"]])
    stiffness = 1e6 * np.exp(theta[:, :3].mean(axis=1))
    spread = np.array(report["spread"])
    for axis, (name, part) in zip(figure.subplots(1, 2), MODULI.items(), strict=True):
        for row, mark in zip(DRAWN, "o^s", strict=True):
            values = np.array([case["bounds"][row] for case in report["fabrics"]])[:, part]
            axis.loglog(stiffness, np.sqrt(((values / spread[part]) ** 2).mean(axis=1)), mark,
                        ms=3, label=row)
        axis.axhline(1.0, color="0.5", lw=0.8, ls="--")
        axis.set_ylim(0.02, 1.5)
        tick_short_scales(axis.xaxis, axis.yaxis)
        axis.set_xlabel("geometric mean of α, µN·m", fontsize=8)
        axis.set_title(f"bound of {'log α' if name == 'log_alpha' else 'β/α'}, "
                       "of the spread over fabrics", fontsize=9)
        axis.legend(fontsize=7, frameon=False)
    return figure
