"""Simulate cantilever strips and estimate moduli from measured ones, on the command line.

Simulate strips of the default law; gives a JSON list of gamma = rho g L³/alpha and aspect ratio:

    python -m apps.cantilever hang gamma=0.1,1,10,100 out=FILE

Estimate moduli from measured deflection curves, CSV files with the columns x_mm and y_mm whose
first row is the clamp's edge; several strips of a direction are joined by commas:

    python -m apps.cantilever estimate warp=a.csv,b.csv bias=c.csv weft=d.csv density=150

Photographs of strips, with the errors of the moduli, are estimated by ``infer.py strips=FOLDER``.

``hang --help`` and ``estimate --help`` list the keys of each.
"""

import common.interrupt  # noqa: F401

# isort: split
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from apps.strip_curves import read_curve
from common.command import command, commands
from common.errors import InputError
from common.files import replace_file, replace_json, require_file
from common.types import Density
from sim.cantilever import aspect_ratio, elastica, fabric_of_gamma, hang
from sim.cantilever.moduli import (
    MAX_ROUNDS,
    METHODS,
    RATIO_RANGE,
    StripModuli,
    Strips,
    correct,
    estimate_moduli,
)
from sim.material import DIRECTIONS, MICRO, NANO, checked_density
from sim.solver.newton import Status

LENGTH = 0.09  # m; results depend only on gamma
MAX_SIMULATED_GAMMA = 2000.0
CELLS = 14.0  # per gravity length, for an error of H/W below 0.4 % up to gamma = 1000


@dataclass
class HangConfig:
    """``configs/cantilever_hang.yaml``."""

    gamma: list[float]
    out: str


@dataclass
class EstimateConfig:
    """``configs/cantilever_estimate.yaml``."""

    warp: str
    bias: str
    weft: str
    density: float | None
    method: str
    slope: float
    rounds: int | None
    width: float
    out: str


@command("cantilever_hang", HangConfig)
def print_strips(config: HangConfig) -> None:
    """Simulate a strip for each gamma; write JSON to the file ``out``, or print it."""
    if not config.gamma:
        raise InputError("gamma= needs a number, such as gamma=10")
    for gamma in config.gamma:
        if not 0 < gamma <= MAX_SIMULATED_GAMMA:
            raise InputError(f"gamma={gamma:g} must lie above 0 and not above "
                             f"{MAX_SIMULATED_GAMMA:g}")
    out = Path(config.out) if config.out else None
    if out:
        require_file(out)
    text = json.dumps([simulate(gamma) for gamma in config.gamma], indent=2) + "\n"
    if out:
        replace_file(out, text.encode())
    else:
        print(text, end="")


def simulate(gamma: float) -> dict:
    """Simulate an isotropic strip of the default law; entry of the JSON list."""
    cells = np.ceil(max(30.0, CELLS * gamma ** (1 / 3)))
    edge = LENGTH / cells
    hung = hang(fabric_of_gamma(gamma, LENGTH), length=LENGTH, width=6 * edge, edge=edge)
    settled = hung.result.status is Status.CONVERGED
    return {
        "gamma": gamma,
        "aspect_ratio": aspect_ratio(hung.curve[-1]) if settled else None,
        "elastica_aspect_ratio": aspect_ratio(elastica(gamma)[-1]),
        "cells_along": int(cells),
        "status": hung.result.status.value,
        "message": hung.result.message,
    }


@command("cantilever_estimate", EstimateConfig)
def print_estimate(config: EstimateConfig) -> None:
    """Estimate, print a table, and write JSON to the file ``out`` if given."""
    files = {d: named.split(",") for d in DIRECTIONS if (named := getattr(config, d))}
    if not files:
        raise InputError("no curves; give some of warp=FILE, bias=FILE, weft=FILE")
    for direction, names in files.items():
        if not all(names):
            raise InputError(f"{direction}={','.join(names)} has an empty file name; separate "
                             "names by single commas")
    if config.method not in METHODS:
        raise InputError(f"unknown method '{config.method}'; choose from {', '.join(METHODS)}")
    if config.density is None:
        raise InputError("the fabric's density is needed, in g/m²: density=150")
    checked_density(1e-3 * config.density)
    if config.rounds is not None and config.rounds < 0:
        raise InputError(f"rounds={config.rounds} must not be negative")
    if not 0 < config.width <= 500:
        raise InputError(f"width={config.width:g} must lie between 0 and 500 mm")
    if config.out:
        require_file(Path(config.out))
    curves = {d: [read_curve(file) for file in each] for d, each in files.items()}
    report = moduli(curves, config)
    if config.out:
        replace_json(Path(config.out), {"density_g_m2": config.density, "method": config.method,
                                        **report})


def moduli(strips: Strips, config: EstimateConfig) -> dict:
    """Estimate, correct and print alpha and beta of each direction; entries of the report."""
    options = estimator_options(config, 1e-3 * config.density)
    estimates = estimate_moduli(strips, **options)
    rows = {direction: estimate_row(e) for direction, e in estimates.items()}
    rounds = config.rounds
    if rounds is None:
        rounds = MAX_ROUNDS * (len(strips) == len(DIRECTIONS))
    if rounds:
        fabric = correct(strips, estimates, rounds=rounds, width=1e-3 * config.width,
                         **options)
        for k, direction in enumerate(DIRECTIONS):
            rows[direction]["alpha_uN_m"] = float(fabric.alpha[k] / MICRO)
            rows[direction]["beta_nN_m2"] = float(fabric.beta[k] / NANO)
    print(f"{'':6}{'alpha µN·m':>12}{'beta nN·m²':>12}{'misfit %':>10}{'-beta κ/alpha':>15}")
    for direction, row in rows.items():
        print(f"{direction:6}{row['alpha_uN_m']:12.3g}{row['beta_nN_m2']:12.3g}"
              f"{100 * row['misfit']:10.2f}{row['largest_reduced_curvature']:15.2f}")
    for direction in (direction for direction, e in estimates.items() if e.bounded):
        print(f"{direction}: beta/alpha is at a limit of its search, {RATIO_RANGE[0]:g} to "
              f"{RATIO_RANGE[1]:g} m; these curves do not determine beta")
    return {"rounds": rounds, "moduli": rows}


def estimator_options(config: EstimateConfig, density: Density) -> dict:
    """Arguments of :func:`sim.cantilever.moduli.estimate_moduli`; density in kg/m²."""
    return {"density": density, "method": config.method,
            "slope": float(np.radians(config.slope))}


def estimate_row(estimate: StripModuli) -> dict:
    """Entries of the report for one direction, or one strip."""
    return {
        "alpha_uN_m": estimate.alpha / MICRO,
        "beta_nN_m2": estimate.beta / NANO,
        "misfit": estimate.misfit,
        "largest_curvature_1_m": estimate.curvature,
        "largest_reduced_curvature": -estimate.beta / estimate.alpha * estimate.curvature,
        "beta_found": not estimate.bounded,
    }


main = commands({"hang": print_strips, "estimate": print_estimate}, usage=__doc__)

if __name__ == "__main__":
    main()
