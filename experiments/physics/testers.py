"""Errors of the cantilever estimators on strips of known moduli.

Strips of fabrics from the bundled prior are simulated in warp, bias and weft, and the moduli are
estimated from their curves. *Guided* strips bend as cylinders, as the estimators assume; their
curves are evaluated without and with noise. *Free* strips twist and curve across like real ones;
their curves are evaluated without and with the simulated correction.
"""


import numpy as np

from common.errors import InputError
from data.fabrics.fabrics import fabric_from_theta
from experiments.drapes import prior_theta
from experiments.physics.guides import guided
from experiments.result import Config, Result, rms, run_cases
from sim.cantilever import heavy_elastica
from sim.cantilever.moduli import METHODS, Strips, correct, estimate_moduli
from sim.cantilever.strip import ANGLES, simulate_strips
from sim.cloth import Laws
from sim.energies import bending_law
from sim.material import DIRECTIONS, MICRO, NANO, Fabric, gravity_length
from sim.rig import GRAVITY

SEED = 3  # of the fabrics
LENGTHS = (1.5, 2.5)  # of the two strips of a direction, in bending lengths
STIFFENING = 1e-3  # m, beta/alpha in weft of the last fabric
ALPHA_LIMIT, BETA_LIMIT = 0.02, 0.10
MIN_RATIO = 1e-3  # m; errors of beta are relative to the larger of |beta| and this times alpha


def draw_fabric(index: int, *, stiffening: bool) -> Fabric:
    """Fabric ``index`` of a fixed sequence from the prior."""
    theta = prior_theta(index, SEED)
    if stiffening:
        theta[5] = STIFFENING
    return fabric_from_theta(theta)


def run_case(
    *, index: int, stiffening: bool, free: bool, noise: float, repeats: int, cells: int, rounds: int
) -> dict:
    """Estimates of one fabric: lists of moduli (alpha µN·m, beta nN·m²) in warp, bias and weft."""
    fabric = draw_fabric(index, stiffening=stiffening)
    lengths = strip_lengths(fabric)
    # Another triangulation than that of the strips simulated by the correction.
    mesh = {"cells": cells, "seed": 100 + index}
    result = {"moduli": moduli(fabric), "stable": stable_directions(fabric)}
    try:
        strips = simulate_strips(fabric, lengths, width=None, across=3, laws=guided(Laws(), 3),
                                 **mesh)
        rng = np.random.default_rng(index)
        for method in METHODS:
            result[f"guided {method}"] = method_rows(strips, fabric, method)
        shaken = [add_noise(strips, 1e-3 * noise, rng) for _ in range(repeats)]
        for method in METHODS:
            result[f"noisy {method}"] = [method_rows(s, fabric, method) for s in shaken]
        if free:
            strips = simulate_strips(fabric, lengths, **mesh)
            result["free regression"] = method_rows(strips, fabric, "regression")
            found = estimate_moduli(strips, density=fabric.density, method="table")
            result["free table"] = moduli_rows(found)
            result["free corrected"] = moduli(
                correct(strips, found, density=fabric.density, rounds=rounds))
    except InputError as error:
        result["failure"] = str(error)
    return result


def strip_lengths(fabric: Fabric) -> dict[str, list[float]]:
    """Lengths, m, of the strips by direction."""
    return {direction: [x * gravity_length(alpha, fabric.density) for x in LENGTHS]
            for direction, alpha in zip(DIRECTIONS, fabric.alpha, strict=True)}


def stable_directions(fabric: Fabric) -> list[bool]:
    """Whether cylinders along warp, bias and weft, of the strips' curvature, are stable.

    If the law softens much faster along the bias than along the yarns, its tangent stiffness in
    twist is negative on a cylinder bent along a yarn, and such a strip twists.
    """
    law = bending_law.constants(fabric)
    stable = []
    for direction, alpha, beta in zip(DIRECTIONS, fabric.alpha, fabric.beta, strict=True):
        weight = fabric.density * GRAVITY
        longest = max(LENGTHS) * gravity_length(alpha, fabric.density)
        curve = heavy_elastica(alpha, beta, weight=weight, length=longest)
        steepest = np.gradient(np.unwrap(np.arctan2(*np.gradient(curve, axis=0).T[::-1])))
        largest = steepest.max() * (len(curve) - 1) / longest
        c, s = np.cos(ANGLES[direction]), np.sin(ANGLES[direction])
        bent = np.linspace(0, largest, 100)[1:, None] * [c * c, s * s, c * s]
        tangents = bending_law.respond(bent, np.zeros_like(bent), law, bending_law.PLAIN)[2]
        stable.append(bool(np.linalg.eigvalsh(tangents).min() > 0))
    return stable


def moduli(fabric: Fabric) -> list[list[float]]:
    """[[alpha µN·m, beta nN·m²] in warp, bias and weft]."""
    return np.column_stack([fabric.alpha / MICRO, fabric.beta / NANO]).tolist()


def method_rows(strips: Strips, fabric: Fabric, method: str) -> list[list[float]]:
    """Estimates of a method, in the form of :func:`moduli`."""
    return moduli_rows(estimate_moduli(strips, density=fabric.density, method=method))


def moduli_rows(found: dict) -> list[list[float]]:
    """Estimates by direction, in the form of :func:`moduli`."""
    return [[found[d].alpha / MICRO, found[d].beta / NANO] for d in DIRECTIONS]


def add_noise(
    strips: Strips, sigma: float, rng: np.random.Generator
) -> dict[str, list[np.ndarray]]:
    """Curves with noise N(0, sigma) on both coordinates, except at the edge of the clamp."""
    shaken: dict[str, list[np.ndarray]] = {}
    for direction, curves in strips.items():
        for curve in curves:
            noisy = curve + rng.normal(0.0, sigma, curve.shape)
            noisy[0] = 0.0
            shaken.setdefault(direction, []).append(noisy)
    return shaken


def relative_errors(results: list[dict], kind: str) -> np.ndarray:
    """Relative errors (n, 2) of alpha and beta in stable directions, over all repeats."""
    errors = []
    for result in results:
        if kind in result:
            true = np.array(result["moduli"])
            # µN·m times mm is nN·m²
            least = 1e3 * MIN_RATIO * true[:, 0]
            size = np.column_stack([true[:, 0], np.maximum(np.abs(true[:, 1]), least)])
            error = ((np.array(result[kind]) - true) / size).reshape(-1, 3, 2)
            errors.append(error[:, result["stable"]].reshape(-1, 2))
    return np.concatenate(errors) if errors else np.empty((0, 2))


def summarise(errors: np.ndarray) -> dict:
    """Statistics of relative errors (n, 2), in percent, and shares within the limits."""
    return {modulus: {
        "readings": len(errors),
        "median": float(np.median(np.abs(error))),
        "rms": rms(error),
        "largest": float(np.abs(error).max()),
        "median_signed": float(np.median(error)),
        "within_limit": float((np.abs(error) <= 100 * limit).mean()),
    } for modulus, limit, error in zip(("alpha", "beta"), (ALPHA_LIMIT, BETA_LIMIT),
                                       100 * errors.T, strict=True)}


def run(config: Config) -> Result:
    """Estimate all strips."""
    count = config["fabrics"]
    shared = {key: config[key] for key in ("noise", "repeats", "cells", "rounds")}
    cases = {f"fabric{k:02d}": {"index": k, "stiffening": k == count - 1,
                                "free": k < config["free"], **shared} for k in range(count)}
    by_fabric = run_cases(run_case, cases, config)
    results = list(by_fabric.values())
    kinds = [f"{strips} {method}" for strips in ("guided", "noisy") for method in METHODS]
    kinds += ["free regression", "free table", "free corrected"]
    return Result({
        "lengths_in_bending_lengths": LENGTHS,
        "errors_percent": {kind: summarise(errors) for kind in kinds
                           if len(errors := relative_errors(results, kind))},
        "left_out": [f"{name} {direction}" for name, result in by_fabric.items()
                     for direction, stable in zip(DIRECTIONS, result["stable"], strict=True)
                     if not stable],
        "failures": {name: result["failure"] for name, result in by_fabric.items()
                     if "failure" in result},
        "fabrics": results,
    })
