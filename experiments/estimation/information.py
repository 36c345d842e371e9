"""Posterior bound: the smallest possible error of moduli estimated from four depth views.

Bounds of the six moduli (:mod:`experiments.estimation.bound`) for fabrics from the prior ``vae``,
each draped twice: with nuisances from configs/nuisances/real.yaml, and without any. The nominal
camera takes four depth views of 240 × 180 pixels. In every row the rotation and offset of the
specimen and the camera pose are unknown. A row is the root mean square, over fabrics and the three
directions, of the smallest standard deviation of an estimate that uses the distributions of moduli
and nuisances.

Depths have a standard deviation of 1 mm, and one pixel in a hundred is an independent measurement.
The local errors of ``sensor=smooth`` are 1.0 mm and correlated such that one pixel in twenty is
independent; the remaining factor is a margin for errors common to all pixels of a view, which have
no columns.
"""

import numpy as np
from tqdm import tqdm

from common.command import compose_config
from data.dataset.config import Options, SamplingConfig, config_from_options
from data.dataset.plan import Stream, plan_drape, stream
from data.fabrics.fabrics import THETA_NAMES, fabric_from_theta
from data.fabrics.nuisances import NAMES, Nuisances
from data.fabrics.prior import load_prior
from data.render.cameras import nominal_camera
from experiments.estimation.bound import CAMERA, SPECIMEN, bounds, depth_information
from experiments.result import Config, Result, rms
from sim.draping import drape
from sim.rig import Rig

MM = 1e3
MODULI = {"log_alpha": slice(0, 3), "beta_over_alpha": slice(3, 6)}
NO_NUISANCES = "no nuisances"
ALL_KNOWN, ALL_UNKNOWN = "all nuisances known", "all nuisances unknown"


def sampling_config(seed: int) -> SamplingConfig:
    """Sampling of fabrics and specimens as in a dataset of the plain prior."""
    words = ["dataset=specimens", "nuisances=real", f"seed={seed}"]
    return config_from_options(compose_config("generate", words, schema=Options)).sampling


def bounds_of_fabric(index: int, seed: int, edge_mm: float, noise_mm: float, pixels: float) -> dict:
    """Bounds (6,) of fabric ``index`` by row; None if a drape has no derivatives."""
    config, prior = sampling_config(seed), load_prior("gaussian").covariance
    pose = dict.fromkeys((SPECIMEN[0], *CAMERA), np.inf) | dict.fromkeys(SPECIMEN[1:], config.drift)
    plan = plan_drape(index, config=config, prior=load_prior("vae"))
    fabric = fabric_from_theta(plan.theta)
    turn = 2 * np.pi * float(stream(seed, Stream.VIEWS, index).random())
    case = {"theta": plan.theta.tolist(), "nuisances": plan.nuisances.vector.tolist(),
            "bounds": {}, "messages": []}
    rows = {ALL_KNOWN: pose, ALL_UNKNOWN: pose | config.nuisances.deviations}
    for nuisances, cases in ((Nuisances(), {NO_NUISANCES: pose}), (plan.nuisances, rows)):
        result = drape(fabric, rig=nuisances.rig(Rig()), edge=1e-3 * edge_mm, start=plan.start,
                       seed=plan.seed, offset=tuple(plan.offset), laws=nuisances.laws)
        found = depth_information(result, nominal_camera(), nuisances=nuisances,
                                  orientation=turn, noise=noise_mm / MM,
                                  pixels_per_measurement=pixels)
        if not found.ok:
            case["messages"].append(found.message)
        case["bounds"] |= {
            name: bounds(found.posterior(prior, unknown)).tolist() if found.ok else None
            for name, unknown in cases.items()}
    return case


def summarise(cases: list[dict], spread: np.ndarray) -> dict[str, dict[str, float]]:
    """Root mean squares over fabrics and directions by row, also in units of ``spread``."""
    summary = {}
    for row in cases[0]["bounds"]:
        values = np.array([case["bounds"][row] for case in cases])
        summary[row] = {f"{kind}{name}": rms(unit[:, part]) for kind, unit in (
            ("", values), ("standardised_", values / spread)) for name, part in MODULI.items()}
    return summary


def run(config: Config) -> Result:
    """Compute the bounds."""
    settings = {key: config[key] for key in ("seed", "edge_mm", "noise_mm", "pixels")}
    cases = [bounds_of_fabric(k, **settings) for k in tqdm(range(config["fabrics"]), unit="fabric")]
    spread = load_prior("gaussian").deviation
    failed = [message for case in cases for message in case.pop("messages")]
    complete = [case for case in cases if None not in case["bounds"].values()]
    report = {
        "parameters": THETA_NAMES,
        "nuisances": NAMES,
        "spread": spread.tolist(),
        "without_derivatives": failed,
        "rms": summarise(complete, spread) if complete else {},
        "fabrics": complete,
    }
    return Result(report)
