"""Errors of the cantilever estimators on strips of known moduli.

Strips of fabrics of the shipped prior are simulated in warp, bias and weft, and the moduli
estimated from their curves. *Guided* strips bend as cylinders, as the estimators assume; their
curves are read without and with noise. *Free* strips twist and curve across as real ones do; their
curves are read without and with the simulated correction.
"""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from benchmarks.common import Config, Result, run_cases, table
from benchmarks.physics.guides import guided
from common.errors import InputError
from data.fabrics import fabric_from_theta
from data.prior import load_prior, sample_admissible
from data.sampling import Stream, stream
from sim.cantilever import heavy_elastica
from sim.cantilever.fabric import METHODS, Strips, correct, estimate
from sim.cantilever.tester import ANGLES, bending_length, simulate_strips
from sim.energies import plate_law
from sim.laws import Laws
from sim.material import DIRECTIONS, MICRO, NANO, Fabric
from sim.scene import GRAVITY

SEED = 3  # of the stream of fabrics
LENGTHS = (1.5, 2.5)  # of the two strips of a direction, in its bending lengths
STIFFENING = 1e-3  # m, beta/alpha of the last fabric's weft
ALPHA_LIMIT, BETA_LIMIT = 0.02, 0.10
LEAST_RATIO = 1e-3  # m: errors of beta are relative to it times alpha where |beta| is smaller


def draw_fabric(index: int, *, stiffening: bool) -> Fabric:
    """Fabric ``index`` of the prior's fixed stream."""
    theta, _ = sample_admissible(load_prior("gaussian"), stream(SEED, Stream.FABRIC, index))
    if stiffening:
        theta[5] = STIFFENING
    return fabric_from_theta(theta)


def work(
    *, index: int, stiffening: bool, free: bool, noise: float, repeats: int, cells: int, rounds: int
) -> dict:
    """Readings of one fabric: lists of moduli (alpha µN·m, beta nN·m²) of warp, bias, weft."""
    fabric = draw_fabric(index, stiffening=stiffening)
    lengths = {
        direction: [x * bending_length(alpha, fabric.density) for x in LENGTHS]
        for direction, alpha in zip(DIRECTIONS, fabric.alpha, strict=True)
    }
    # The correction simulates on another triangulation than the measured strips have.
    mesh = {"cells": cells, "seed": 100 + index}
    result = {"moduli": moduli(fabric), "stable": stable_directions(fabric)}
    try:
        strips = simulate_strips(fabric, lengths, width=None, across=3, laws=guided(Laws(), 3),
                                 **mesh)
        rng = np.random.default_rng(index)
        for method in METHODS:
            result[f"guided {method}"] = read(strips, fabric, method)
        shaken = [shake(strips, 1e-3 * noise, rng) for _ in range(repeats)]
        for method in METHODS:
            result[f"noisy {method}"] = [read(s, fabric, method) for s in shaken]
        if free:
            strips = simulate_strips(fabric, lengths, **mesh)
            result["free regression"] = read(strips, fabric, "regression")
            found = estimate(strips, density=fabric.density, method="table")
            result["free table"] = rows_of(found)
            result["free corrected"] = moduli(
                correct(strips, found, density=fabric.density, rounds=rounds)
            )
    except InputError as error:
        result["failure"] = str(error)
    return result


def stable_directions(fabric: Fabric) -> list[bool]:
    """Whether cylinders bent along warp, bias and weft as far as the strips are minima of the law.

    Where the law softens much faster along the bias than along the yarns, its tangent stiffness
    against twist turns negative on a cylinder bent along a yarn. Such a strip does not stay one.
    """
    law = plate_law.constants(fabric)
    stable = []
    for direction, alpha, beta in zip(DIRECTIONS, fabric.alpha, fabric.beta, strict=True):
        weight = fabric.density * GRAVITY
        longest = max(LENGTHS) * bending_length(alpha, fabric.density)
        curve = heavy_elastica(alpha, beta, weight=weight, length=longest)
        steepest = np.gradient(np.unwrap(np.arctan2(*np.gradient(curve, axis=0).T[::-1])))
        largest = steepest.max() * (len(curve) - 1) / longest
        c, s = np.cos(ANGLES[direction]), np.sin(ANGLES[direction])
        bent = np.linspace(0, largest, 100)[1:, None] * [c * c, s * s, c * s]
        _, tangents = plate_law.stresses(bent, law)
        stable.append(bool(np.linalg.eigvalsh(tangents).min() > 0))
    return stable


def moduli(fabric: Fabric) -> list[list[float]]:
    """[[alpha µN·m, beta nN·m²] of warp, bias, weft]."""
    return np.column_stack([fabric.alpha / MICRO, fabric.beta / NANO]).tolist()


def read(strips: Strips, fabric: Fabric, method: str) -> list[list[float]]:
    """What an estimator reads, as :func:`moduli`."""
    return rows_of(estimate(strips, density=fabric.density, method=method))


def rows_of(found: dict) -> list[list[float]]:
    """Estimates by direction as :func:`moduli`."""
    return [[found[d].alpha / MICRO, found[d].beta / NANO] for d in DIRECTIONS]


def shake(strips: Strips, sigma: float, rng: np.random.Generator) -> dict[str, list[np.ndarray]]:
    """Curves whose points, but for the clamp's edge, moved by N(0, sigma) along both axes."""
    shaken: dict[str, list[np.ndarray]] = {}
    for direction, curves in strips.items():
        for curve in curves:
            noisy = curve + rng.normal(0.0, sigma, curve.shape)
            noisy[0] = 0.0
            shaken.setdefault(direction, []).append(noisy)
    return shaken


def relative_errors(results: list[dict], kind: str) -> np.ndarray:
    """(n, 2) errors of alpha and beta, relative, of stable directions, all repeats together."""
    errors = []
    for result in results:
        if kind in result:
            true = np.array(result["moduli"])
            # µN·m times mm are nN·m²
            least = 1e3 * LEAST_RATIO * true[:, 0]
            size = np.column_stack([true[:, 0], np.maximum(np.abs(true[:, 1]), least)])
            error = ((np.array(result[kind]) - true) / size).reshape(-1, 3, 2)
            errors.append(error[:, result["stable"]].reshape(-1, 2))
    return np.concatenate(errors) if errors else np.empty((0, 2))


def summarise(errors: np.ndarray) -> dict:
    """What is said of errors (n, 2), in percent, and the share within the limits."""
    flat, signed = 100 * np.abs(errors), 100 * errors
    limits = 100 * np.array([ALPHA_LIMIT, BETA_LIMIT])
    return {
        modulus: {
            "readings": len(flat),
            "median": float(np.median(flat[:, k])),
            "rms": float(np.sqrt((flat[:, k] ** 2).mean())),
            "largest": float(flat[:, k].max()),
            "median_signed": float(np.median(signed[:, k])),
            "within_limit": float((flat[:, k] <= limits[k]).mean()),
        }
        for k, modulus in enumerate(("alpha", "beta"))
    }


def run(config: Config) -> Result:
    """Read all strips, and print the errors."""
    count = config["fabrics"]
    shared = {key: config[key] for key in ("noise", "repeats", "cells", "rounds")}
    cases = {
        f"fabric{i:02d}": {
            "index": i, "stiffening": i == count - 1, "free": i < config["free"], **shared
        }
        for i in range(count)
    }
    results = list(
        run_cases(work, cases, folder=Path(config["cases"]), workers=config["workers"]).values()
    )
    kinds = [f"{strips} {method}" for strips in ("guided", "noisy") for method in METHODS]
    kinds += ["free regression", "free table", "free corrected"]
    summary = {
        kind: summarise(errors) for kind in kinds if len(errors := relative_errors(results, kind))
    }
    rows = [
        [kind, *(f"{part[m][key]:.2f}" for m in ("alpha", "beta")
                 for key in ("median", "rms", "largest"))]
        for kind, part in summary.items()
    ]
    head = ["strips, reading", *(f"{m}: {key} %" for m in ("alpha", "beta")
                                 for key in ("median", "rms", "largest"))]
    print(table(head, rows))
    unstable = [
        f"{name} {direction}" for name, result in zip(cases, results, strict=True)
        for direction, stable in zip(DIRECTIONS, result["stable"], strict=True) if not stable
    ]
    print(f"\nleft out, their cylinders are no minima of the law: {', '.join(unstable) or 'none'}")
    failures = {
        name: result["failure"]
        for name, result in zip(cases, results, strict=True) if "failure" in result
    }
    for name, message in failures.items():
        print(f"{name}: {message}")
    return Result({
        "lengths_in_bending_lengths": LENGTHS,
        "errors_percent": summary,
        "left_out": unstable,
        "failures": failures,
        "fabrics": results,
    }, draw(results))


def draw(results: list[dict]) -> Figure:
    """Read against true moduli: guided and noisy strips, and free ones."""
    figure = Figure(figsize=(12, 7.5), layout="constrained")
    axes = figure.subplots(2, 3)
    panels = (
        ("guided strips, no noise", ("guided regression", "guided table")),
        ("guided strips, noise", ("noisy regression", "noisy table")),
        ("free strips, no noise", ("free table", "free corrected")),
    )
    for column, (title, kinds) in enumerate(panels):
        for row, (name, unit) in enumerate((("α", "µN·m"), ("β", "nN·m²"))):
            axis = axes[row, column]
            lowest, highest = np.inf, -np.inf
            for kind, marker in zip(kinds, "ox", strict=True):
                pairs = [
                    (true[row], read[row])
                    for result in results if kind in result
                    for each in np.array(result[kind]).reshape(-1, 3, 2)
                    for true, read, stable in zip(
                        result["moduli"], each, result["stable"], strict=True
                    ) if stable
                ]
                if not pairs:
                    continue
                true, found = np.array(pairs).T
                axis.plot(true, found, marker, ms=4, alpha=0.6, label=kind.split()[1])
                lowest, highest = min(lowest, true.min()), max(highest, true.max())
            if row == 0:
                axis.set(xscale="log", yscale="log", title=title)
                axis.xaxis.set_minor_formatter(NullFormatter())
                axis.yaxis.set_minor_formatter(NullFormatter())
            else:
                axis.set_xscale("symlog", linthresh=10)
                axis.set_yscale("symlog", linthresh=10)
            if np.isfinite(lowest):
                axis.plot([lowest, highest], [lowest, highest], "k-", lw=0.7)
            axis.set(xlabel=f"true {name}, {unit}", ylabel=f"read {name}, {unit}")
            if axis.get_legend_handles_labels()[0]:
                axis.legend()
    return figure
