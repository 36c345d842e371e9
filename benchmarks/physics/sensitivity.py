"""Derivatives of drapes by the moduli against central differences, and their cost.

Fabrics of the shipped prior, draped from a sine start and converged to rounding. The derivative
dx/dp of all vertices by each of the six moduli (log alpha and beta/alpha of warp, bias, weft) is
found in three ways:

- central differences of two drapes, each followed from the first and converged to rounding, as far
  apart as differences do not depend on it;
- forward sensitivities, one solve for each modulus;
- the adjoint, through PyTorch: the derivative of w·x with w along the difference's own direction.

Compared are norms: |forward - difference|/|difference|, and the adjoint's number with the norm
that it should be. Costs are CPU-seconds on one core, relative to the drape's.
"""

import time
from pathlib import Path

import numpy as np
import torch
from matplotlib.figure import Figure

from benchmarks.common import Config, Result, run_cases, table
from data.fabrics import THETA_NAMES, fabric_from_theta
from data.prior import load_prior, sample_admissible
from data.sampling import Stream, stream
from sim.drape import DrapeResult, drape
from sim.newton import NewtonOptions
from sim.sensitivity import Tangent, follow, sensitivities
from sim.sensitivity.adjoint import equilibria, pulled_back

LIMIT = 1e-3  # of the norm of dx/dp
COST = 0.15  # of the drape
TIGHT = NewtonOptions(residual=1e-7, step=1e-7)
STEPS = np.repeat([1e-4, 1e-7], 3)  # of log alpha, and of beta/alpha in m, at most
SHORTER = 1 / 3  # of a step, the next one, until
AGREE = LIMIT / 3  # their differences do, relative
SHORTENED = 4  # at most so often


class Clock:
    """CPU-seconds of this process since the last call."""

    def __init__(self) -> None:
        self._last = time.process_time()

    def __call__(self) -> float:
        before, self._last = self._last, time.process_time()
        return round(self._last - before, 4)


def one_fabric(index: int, seed: int, edge_mm: float) -> dict:
    """Derivatives and costs of fabric ``index``."""
    theta, _ = sample_admissible(load_prior("gaussian"), stream(seed, Stream.FABRIC, index))
    fabric = fabric_from_theta(theta)
    drape(fabric, edge=0.01)  # loads the kernels
    clock, seconds = Clock(), {}
    made = drape(fabric, edge=1e-3 * edge_mm, seed=index)
    seconds["drape"] = clock()
    result = {
        "alpha_uN_m": (1e6 * fabric.alpha).tolist(),
        "beta_over_alpha_mm": (1e3 * theta[3:]).tolist(),
        "status": made.status.value,
        "message": made.message,
    }
    if not made.converged:
        return result
    start = follow(made, fabric, options=TIGHT)
    clock()
    forward = sensitivities(start)
    seconds["six forward sensitivities"] = clock()
    if not forward.ok:
        return {**result, "status": "no derivative", "message": forward.message}
    differences, failed = by_differences(start, theta)
    clock()
    moduli, parameters = moduli_of(theta)
    found = equilibria([start], options=TIGHT, **moduli)
    seconds["equilibrium from nearby, with its factor"] = clock()
    adjoint = backwards(found.positions[0], parameters, differences)
    clock()
    backwards(found.positions[0], parameters, differences[:1])
    seconds["backward"] = clock()
    pulled_back(Tangent.of(start), fabric, differences[0], membrane=200.0, by_held=False,
                by_rest=False)
    seconds["backward without a kept factor"] = clock()

    norms = np.linalg.norm(differences, axis=(1, 2))
    return {
        **result,
        "unconverged_differences": failed,
        "softest_weights_per_mm": forward.softest,
        "norm_m": norms.tolist(),
        "largest_m": np.linalg.norm(differences, axis=2).max(axis=1).tolist(),
        "forward": (np.linalg.norm(forward.positions - differences, axis=(1, 2)) / norms).tolist(),
        "adjoint": (np.abs(adjoint - norms) / norms).tolist(),
        "seconds": seconds,
    }


def by_differences(start: DrapeResult, theta: np.ndarray) -> tuple[np.ndarray, int]:
    """(6, V, 3) central differences of the drapes next to ``start``, and how many failed.

    A drape close to losing its stability moves far, and not in proportion, for a small change.
    """
    failed, rows = 0, []
    for k, step in enumerate(STEPS):
        row = np.inf
        for power in range(SHORTENED + 1):
            ends = []
            for sign in (1, -1):
                moved = theta.copy()
                moved[k] += sign * step * SHORTER**power
                end = follow(start, fabric_from_theta(moved), options=TIGHT)
                failed += not end.converged
                ends.append(end.positions)
            before, row = row, (ends[0] - ends[1]) / (2 * step * SHORTER**power)
            if np.linalg.norm(row - before) < AGREE * np.linalg.norm(row):
                break
        rows.append(row)
    return np.stack(rows), failed


def moduli_of(theta: np.ndarray) -> tuple[dict[str, torch.Tensor], torch.Tensor]:
    """Arguments alpha and beta of :func:`equilibria` as functions of theta (1, 6), and that."""
    parameters = torch.tensor(theta[None], requires_grad=True)
    alpha = parameters[:, :3].exp()
    return {"alpha": alpha, "beta": parameters[:, 3:] * alpha}, parameters


def backwards(
    positions: torch.Tensor, parameters: torch.Tensor, directions: np.ndarray
) -> np.ndarray:
    """(K,) derivatives of unit vectors along the first K ``directions`` times the positions.

    Each by the modulus of the same number.
    """
    found = []
    for k, direction in enumerate(directions):
        weights = torch.from_numpy(direction / np.linalg.norm(direction))
        by_theta, = torch.autograd.grad(positions, parameters, weights, retain_graph=True)
        found.append(float(by_theta[0, k]))
    return np.array(found)


def summarise(rows: list[dict]) -> dict:
    """Worst and median figures of the fabrics that have derivatives."""
    good = [row for row in rows if "forward" in row]
    ratios = {name: [row["seconds"][name] / row["seconds"]["drape"] for row in good]
              for name in good[0]["seconds"]} if good else {}
    summary = {
        "fabrics": len(rows),
        "with_derivatives": len(good),
        "worst": {way: max(max(row[way]) for row in good) for way in ("forward", "adjoint")},
        "median": {way: float(np.median([row[way] for row in good]))
                   for way in ("forward", "adjoint")},
        "share_of_the_drape": {
            name: {"median": float(np.median(values)), "largest": max(values)}
            for name, values in ratios.items() if name != "drape"
        },
    } if good else {"fabrics": len(rows), "with_derivatives": 0}
    summary["passed"] = len(good) == len(rows) and all(
        worst <= LIMIT for worst in summary["worst"].values()
    ) and summary["share_of_the_drape"]["backward"]["median"] < COST
    return summary


def run(config: Config) -> Result:
    """Compare, and print the table."""
    cases = {
        f"fabric_{config['seed']}_{k}_{config['edge_mm']:g}": {
            "index": k, "seed": config["seed"], "edge_mm": config["edge_mm"]
        }
        for k in range(config["fabrics"])
    }
    rows = list(run_cases(one_fabric, cases, folder=Path(config["cases"]),
                          workers=config["workers"]).values())
    summary = summarise(rows)
    print(table(
        ["fabric", "α, µN·m", "status", "forward", "adjoint", "drape, s", "backward"],
        [[k, " ".join(f"{a:.3g}" for a in row["alpha_uN_m"]), row["status"],
          *([f"{max(row['forward']):.1e}", f"{max(row['adjoint']):.1e}",
             f"{row['seconds']['drape']:.2f}",
             f"{100 * row['seconds']['backward'] / row['seconds']['drape']:.1f} %"]
            if "forward" in row else ["", "", "", ""])]
         for k, row in enumerate(rows)],
    ))
    if summary["with_derivatives"]:
        worst, cost = summary["worst"], summary["share_of_the_drape"]
        print(f"largest relative difference: forward {worst['forward']:.1e}, adjoint "
              f"{worst['adjoint']:.1e}, limit {LIMIT:g}")
        for name, figures in cost.items():
            print(f"{name}: {100 * figures['median']:.1f} % of the drape's time (median), "
                  f"at most {100 * figures['largest']:.1f} %")
    return Result({"limit": LIMIT, "cost_limit": COST, **summary, "rows": rows},
                  draw([row for row in rows if "forward" in row]))


def draw(rows: list[dict]) -> Figure:
    """Differences of all fabrics by modulus, and what a backward pass costs."""
    figure = Figure(figsize=(9.0, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=[1.6, 1])
    for shift, way in ((-0.12, "forward"), (0.12, "adjoint")):
        values = np.array([row[way] for row in rows]).reshape(-1, 6)
        at = np.arange(6) + shift + np.linspace(-0.06, 0.06, max(len(values), 1))[:, None]
        left.semilogy(at[: len(values)].ravel(), np.maximum(values, 1e-12).ravel(), ".",
                      label=way, ms=4)
    left.axhline(LIMIT, color="k", lw=0.7, ls="--")
    left.set_xticks(range(6), [name.replace("log_alpha", "log α").replace("beta_over_alpha", "β/α")
                               .replace("_", "\n") for name in THETA_NAMES], fontsize=7)
    left.set_title("off the central difference, relative", fontsize=9)
    left.legend(fontsize=7, frameon=False, loc="upper right", bbox_to_anchor=(1.0, 0.9))
    seconds = np.array([[row["seconds"]["drape"], row["seconds"]["backward"]]
                        for row in rows]).reshape(-1, 2)
    right.plot(seconds[:, 0], seconds[:, 1], ".")
    limits = np.array([0.0, 1.05 * seconds[:, 0].max(initial=1.0)])
    right.plot(limits, COST * limits, "k--", lw=0.7, label="15 % of the drape")
    right.set_xlim(limits)
    right.set_ylim(0, None)
    right.set_xlabel("drape, CPU-seconds", fontsize=8)
    right.set_title("backward pass, CPU-seconds", fontsize=9)
    right.legend(fontsize=7, frameon=False)
    return figure
