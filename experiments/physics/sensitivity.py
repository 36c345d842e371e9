"""Derivatives of drapes with respect to the moduli compared with central differences, and cost.

Fabrics from the bundled prior are draped from a sine start and converged to rounding. The
derivative dx/dp of all vertices by each of the six moduli (log alpha and beta/alpha in warp, bias
and weft) is computed in three ways:

- central differences of two drapes, continued from the first and converged to rounding, with steps
  so small that the differences do not depend on them;
- forward sensitivities, one solve for each modulus;
- the adjoint, by PyTorch: the derivative of w·x with a unit vector w along the central difference.

Errors are |forward - difference|/|difference|, and the deviation of the adjoint's derivative from
|difference|, relative. Costs are CPU-seconds on one core, relative to those of the drape.
"""

import time

import numpy as np
import torch

from data.fabrics.fabrics import fabric_from_theta
from experiments.drapes import prior_theta
from experiments.result import Config, Result, run_cases
from sim.draping import Drape, drape, follow
from sim.sensitivity import sensitivities
from sim.sensitivity.adjoint import equilibria
from sim.solver.newton import NewtonOptions

MAX_ERROR = 1e-3  # relative to the norm of dx/dp
MAX_COST = 0.15  # relative to the drape
TIGHT = NewtonOptions(residual=1e-7, step=1e-7)
FIRST_STEPS = np.repeat([1e-4, 1e-7], 3)  # first steps of log alpha, and of beta/alpha in m
STEP_FACTOR = 1 / 3  # factor between successive steps
STEP_TOLERANCE = MAX_ERROR / 3  # relative change of the difference with the last step
MAX_STEP_REDUCTIONS = 4


class Clock:
    """CPU-seconds of this process since the last call."""

    def __init__(self) -> None:
        self._last = time.process_time()

    def __call__(self) -> float:
        before, self._last = self._last, time.process_time()
        return round(self._last - before, 4)


def one_fabric(index: int, seed: int, edge_mm: float) -> dict:
    """Errors and costs of the derivatives of fabric ``index``."""
    theta = prior_theta(index, seed)
    fabric = fabric_from_theta(theta)
    drape(fabric, edge=0.01)  # loads the kernels
    clock, seconds = Clock(), {}
    made = drape(fabric, edge=1e-3 * edge_mm, seed=index, start="sine")
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
    forward = sensitivities(start)
    if not forward.ok:
        return {**result, "status": "no derivative", "message": forward.message}
    differences = central_differences(start, theta)
    moduli, parameters = moduli_from_theta(theta)
    found = equilibria([start], options=TIGHT, **moduli)
    adjoint = adjoint_derivatives(found.positions[0], parameters, differences)
    clock()
    adjoint_derivatives(found.positions[0], parameters, differences[:1])
    seconds["backward"] = clock()
    norms = np.linalg.norm(differences, axis=(1, 2))
    return {
        **result,
        "norm_m": norms.tolist(),
        "forward": (np.linalg.norm(forward.positions - differences, axis=(1, 2)) / norms).tolist(),
        "adjoint": (np.abs(adjoint - norms) / norms).tolist(),
        "seconds": seconds,
    }


def central_differences(start: Drape, theta: np.ndarray) -> np.ndarray:
    """Central differences (6, V, 3) of drapes continued from ``start``.

    Steps are reduced, because a drape that is nearly unstable responds non-linearly.
    """
    rows = []
    for k, step in enumerate(FIRST_STEPS):
        row = np.inf
        for power in range(MAX_STEP_REDUCTIONS + 1):
            ends = []
            for sign in (1, -1):
                moved = theta.copy()
                moved[k] += sign * step * STEP_FACTOR**power
                ends.append(follow(start, fabric_from_theta(moved), options=TIGHT).positions)
            before, row = row, (ends[0] - ends[1]) / (2 * step * STEP_FACTOR**power)
            if np.linalg.norm(row - before) < STEP_TOLERANCE * np.linalg.norm(row):
                break
        rows.append(row)
    return np.stack(rows)


def moduli_from_theta(theta: np.ndarray) -> tuple[dict[str, torch.Tensor], torch.Tensor]:
    """Arguments alpha (N·m) and beta (N·m²) of :func:`equilibria`, and the theta (1, 6) they
    depend on."""
    parameters = torch.tensor(theta[None], requires_grad=True)
    alpha = parameters[:, :3].exp()
    return {"alpha": alpha, "beta": parameters[:, 3:] * alpha}, parameters


def adjoint_derivatives(
    positions: torch.Tensor, parameters: torch.Tensor, directions: np.ndarray
) -> np.ndarray:
    """Derivatives (K,) of w·x by the k-th modulus, with unit vectors w along K ``directions``."""
    found = []
    for k, direction in enumerate(directions):
        weights = torch.from_numpy(direction / np.linalg.norm(direction))
        by_theta, = torch.autograd.grad(positions, parameters, weights, retain_graph=True)
        found.append(float(by_theta[0, k]))
    return np.array(found)


def summarise(rows: list[dict]) -> dict:
    """Worst and median errors and costs over the fabrics that have derivatives."""
    complete = [row for row in rows if "forward" in row]
    if not complete:
        return {"fabrics": len(rows), "with_derivatives": 0, "passed": False}
    ratios = {name: [row["seconds"][name] / row["seconds"]["drape"] for row in complete]
              for name in complete[0]["seconds"]}
    ways = ("forward", "adjoint")
    worst = {way: max(max(row[way]) for row in complete) for way in ways}
    costs = {name: {"median": float(np.median(values)), "largest": max(values)}
             for name, values in ratios.items() if name != "drape"}
    return {
        "fabrics": len(rows), "with_derivatives": len(complete), "worst": worst,
        "median": {way: float(np.median([row[way] for row in complete])) for way in ways},
        "share_of_the_drape": costs,
        "passed": (len(complete) == len(rows) and max(worst.values()) <= MAX_ERROR
                   and costs["backward"]["median"] < MAX_COST)}


def run(config: Config) -> Result:
    """Compare the derivatives of all fabrics."""
    settings = {key: config[key] for key in ("seed", "edge_mm")}
    cases = {f"fabric_{k}": {"index": k, **settings} for k in range(config["fabrics"])}
    rows = list(run_cases(one_fabric, cases, config).values())
    summary = summarise(rows)
    return Result({"limit": MAX_ERROR, "cost_limit": MAX_COST, **summary, "rows": rows})
