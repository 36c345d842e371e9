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
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from common.command import command, commands
from common.errors import InputError
from common.files import replace_file, replace_json, require_file
from common.tables import number, read_table
from common.types import DeflectionCurve, Density
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
COLUMNS = ("x_mm", "y_mm")
MIN_POINTS = 12
MAX_FILE_SIZE = 1 << 20  # bytes
MIN_SPAN, MAX_SPAN = 5e-3, 2.0  # m
MIN_UPWARD_BEND = 0.05
"""Quadratic coefficient of a parabola fitted to a curve, in units of the chord; reading errors
of a nearly straight strip are smaller."""


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


def read_curve(path: str | Path) -> DeflectionCurve:
    """Read a curve from a CSV file whose header names the columns x_mm and y_mm, or x [mm], y [mm].

    The first row is the clamp's edge, the last the free end. The signs of both axes are arbitrary,
    because a strip extends away from its clamp and hangs below it.
    """
    path = Path(path)
    header, rows = read_table(path, "deflection curve", MAX_FILE_SIZE)
    header = [re.sub(r"[^a-z]+", "_", name.lower()).strip("_") for name in header]
    if not set(COLUMNS) <= set(header):
        raise InputError(f"{path} needs a header line with the columns {' and '.join(COLUMNS)}, "
                         "separated by commas, semicolons or tabs")
    x, y = (header.index(name) for name in COLUMNS)
    points = []
    for line, row in rows:
        try:
            points.append((number(row[x]), number(row[y])))
        except (ValueError, IndexError):
            raise InputError(f"{path}, line {line}: expected numbers, in mm") from None
    try:
        return oriented_curve(np.array(points).reshape(-1, 2) * 1e-3)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def oriented_curve(points: np.ndarray) -> DeflectionCurve:
    """The curve through ``points`` (N, 2), m, moved to start at 0, with positive reach and drop;
    InputError unless it has the size and shape of a hanging strip."""
    if (places := len(np.unique(points, axis=0))) < MIN_POINTS:
        raise InputError(f"the curve has {places} different points; give at least "
                         f"{MIN_POINTS}")
    if not np.isfinite(points).all():
        raise InputError("all coordinates must be finite numbers")
    curve = points - points[0]
    length = np.linalg.norm(np.diff(curve, axis=0), axis=1).sum()
    span = np.linalg.norm(np.ptp(curve, axis=0))
    if not MIN_SPAN <= span <= MAX_SPAN:
        raise InputError(f"the curve spans {1e3 * span:.6g} mm but strips have "
                         f"{1e3 * MIN_SPAN:g} to {1e3 * MAX_SPAN:g} mm; give its columns in mm")
    reach, drop = curve[-1]
    if abs(reach) < 1e-3 * span or drop == 0:
        raise InputError(f"the free end is at ({1e3 * reach:.3g}, {1e3 * drop:.3g}) mm from the "
                         "clamp's edge; it must lie beside and below it: check the columns")
    # A smooth hanging strip is at most as long as reach + drop.
    if length > 3 * (abs(reach) + abs(drop)):
        raise InputError("the points are out of order; list them from the clamp to the free end")
    curve = curve * np.sign([reach, drop])
    if _bends_up(curve):
        raise InputError("the curve is steep at its first point and level at its last; list the "
                         "points from the clamp's edge to the free end")
    return curve


def _bends_up(curve: DeflectionCurve) -> bool:
    """Whether a curve significantly bends up, as one listed from the free end to the clamp."""
    x, y = curve[-1] / np.linalg.norm(curve[-1]) ** 2
    along, below = curve @ [x, y], curve @ [-y, x]
    (bend, _, _), covariance = np.polyfit(along, below, 2, cov=True)
    return bool(-bend > max(MIN_UPWARD_BEND, 4 * np.sqrt(covariance[0, 0])))


main = commands({"hang": print_strips, "estimate": print_estimate}, usage=__doc__)

if __name__ == "__main__":
    main()
