"""Distributions of training fabrics, and the linear law (002, section 7.5, Fig. 27, Table 3)."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from data.fabrics.fabrics import fabric_from_theta
from experiments.comparison import compare
from experiments.drapes import drape_specimen, plan_specimen
from experiments.page import Section
from experiments.papers.trainings import Training, error_cell, limits, log_alpha, train_all
from experiments.result import Config, Report, Result, label_log_axes, run_cases, table
from sim.drape import Drape, drape, follow
from sim.material import Fabric
from sim.sensitivity import sensitivities

SPACES = {"vae": "autoencoder (VAE-4)", "mixture": "mixture of three Gaussians",
          "uniform": "box around the autoencoder's fabrics"}
_MAX_ITERATIONS = 8
_MAX_STEP = 0.4  # in log alpha
_INITIAL_FACTOR = 0.7  # times alpha: initial guess of the linear law
_MIN_GAIN = 0.01  # relative decrease of the residual at which the iteration ends


def linear_fit(target: Drape) -> Drape:
    """Fit a linear fabric, beta = 0, to the drape ``target``; return its drape nearest to it.

    Gauss-Newton iteration over three log alpha with the derivatives of the equilibrium.
    """
    weight = np.sqrt(target.mesh.vertex_areas)[:, None]

    def residuals(shape: Drape) -> np.ndarray:
        return (weight * (shape.positions - target.positions)).ravel()

    density = target.fabric.density
    best = follow(target, Fabric(_INITIAL_FACTOR * target.fabric.alpha, np.zeros(3), density))
    scale = 1.0
    for _ in range(_MAX_ITERATIONS):
        moves = sensitivities(best, parameters=("log_alpha",))
        if not (best.converged and moves.ok):
            break
        jacobian = (weight * moves.positions).reshape(3, -1).T
        step = np.linalg.lstsq(jacobian, -residuals(best), rcond=None)[0] * scale
        step *= min(1.0, _MAX_STEP / np.abs(step).max())
        trial = follow(best, Fabric(best.fabric.alpha * np.exp(step), np.zeros(3), density))
        before, after = (np.linalg.norm(residuals(shape)) for shape in (best, trial))
        if not trial.converged or after >= before:
            scale /= 2
            continue
        best = trial
        if after > (1 - _MIN_GAIN) * before:
            break
    return best


def linear_case(*, number: int, edge_mm: float, seed: int) -> dict[str, Any]:
    """Differences between drapes of the best linear law and those of fabric ``number``."""
    plan = plan_specimen(number, seed=seed)
    target = drape_specimen(plan, edge=1e-3 * edge_mm)
    found = linear_fit(target)
    fabric, start = fabric_from_theta(plan.theta), {"start": "ring", "seed": plan.seed + 1}
    other_start = [drape(one, edge=1e-3 * edge_mm, **start) for one in (fabric, found.fabric)]
    result = {"alpha_ratio": (found.fabric.alpha / fabric.alpha).tolist(), "fitted": None,
              "elsewhere": None}
    for name, (one, other) in {"fitted": (target, found), "elsewhere": other_start}.items():
        if one.converged and other.converged:
            result[name] = compare(one, other).row
    return result


def run(config: Config) -> Result:
    """Train on fabrics of each space, and fit the linear law."""
    measured = Path(config["table"]).is_file()
    trainings = {name: Training(name, steps=config["steps"], evaluate_table=measured)
                 for name in SPACES}
    fits = {f"linear_{k:02}": {"number": k, "edge_mm": config["linear_edge_mm"],
                               "seed": config["data_seed"]} for k in range(config["linear"])}
    return Result({"spaces": train_all(trainings, config),
            "linear": run_cases(linear_case, fits, config)})


def _linear(report: Report) -> dict[str, float]:
    """Medians and maxima over the fits of the linear law."""
    fits = list(report["linear"].values())
    found = {"alpha": float(np.median([one["alpha_ratio"] for one in fits]))}
    for name in ("fitted", "elsewhere"):
        mm, percent = np.transpose([one[name] for one in fits if one[name] is not None])
        found |= {name: float(np.median(mm)), f"{name}_largest": float(mm.max()),
                  f"{name}_curvature": float(np.median(percent))}
    return found


def summarise(report: Report) -> str:
    """Summary in sentences."""
    found = _linear(report)
    errors = ", ".join(f"{error:.2f} ({SPACES[name]})"
                       for name, error in log_alpha(report["spaces"]).items())
    return (f"On unseen fabrics of the autoencoder the error of log α is {errors}. The best linear "
            f"law (β = 0, {found['alpha']:.2f} times α) lies {found['fitted']:.1f} mm (median) "
            "from the drape of a softening fabric to which it is fitted, and "
            f"{found['elsewhere']:.1f} mm from its drape from another start.")


def rows(report: Report) -> tuple[list[str], list[list[object]]]:
    """Table of errors by training space and test set."""
    def cell(one: dict, test_set: str, key: str) -> str:
        found = one["unseen"].get(test_set)
        return error_cell({"unseen": {"fabrics": found}} if found else None, key)

    return (["sampled from", "captures", "log α, unseen of the autoencoder", "β/α",
             "log α, measured fabrics", "β/α"],
            [[SPACES[name], one["captures"], *(cell(one, test_set, key)
             for test_set in ("fabrics", "table") for key in ("log_alpha", "beta_over_alpha"))]
             for name, one in report["spaces"].items()])


def fits(report: Report) -> str:
    """Table of the fits of the linear law."""
    found = _linear(report)
    return table(
        ["drape of the best linear law against the fabric's",
         "displacement, mm: median, largest", "curvature, %: median"],
        [[label, f"{found[name]:.2f}, {found[f'{name}_largest']:.2f}",
          f"{found[f'{name}_curvature']:.1f}"]
         for name, label in (("fitted", "next to the drape it is fitted to"),
                             ("elsewhere", "from another start"))])


def draw(report: Report) -> Figure:
    """Plot errors by space, and displacements of the fits by fabric."""
    figure = Figure(figsize=(9, 3), layout="constrained")
    left, right = figure.subplots(1, 2)
    test_sets = {"fabrics": "unseen of the autoencoder", "table": "measured fabrics"}
    for k, (key, label) in enumerate(test_sets.items()):
        found = {name: one["unseen"][key]["log_alpha"] for name, one in report["spaces"].items()
                 if key in one["unseen"]}
        if not found:
            continue
        middle, bars = limits(list(found.values()))
        left.errorbar(middle, np.arange(len(found)) + 0.2 * (k - 0.5), xerr=bars, fmt="o",
                      label=label)
    left.set_yticks(range(len(SPACES)), [name.replace(" around ", "\naround ").replace(
        " of three ", "\nof three ") for name in SPACES.values()])
    left.set(xlabel="error of log α", xlim=(0, None), ylim=(3.1, -0.5))
    left.legend(fontsize=8, loc="lower left")
    for name, label in (("fitted", "fitted drape"), ("elsewhere", "another start")):
        values = sorted(one[name][0] for one in report["linear"].values() if one[name])
        right.plot(range(1, len(values) + 1), values, "o-", ms=4, label=label)
    right.set(xlabel="fabrics, sorted", ylabel="displacement [mm]", yscale="log",
              title="best linear law")
    label_log_axes(right.yaxis)
    right.legend(fontsize=8)
    return figure


SECTION = Section(
    "Training fabrics and the bending law", "002, section 7.5, Figure 27 and Table 3",
    "From which distribution should training fabrics be drawn, and is the modulus β needed?",
    summarise, rows, draw,
    "a network trained on 3 650 fabrics of the subspace is as accurate as one trained on 22 000 of "
    "the full space, one trained on a sixth of the full space less so (Figure 27); displacements "
    "of the fabrics 1, 5 and 7 are 1.6, 1.4, 1.7 mm with the linear law and 1.3, 0.9, 1.7 mm with "
    "the non-linear law (Table 3). Qualitatively comparable.",
    "Trainings are short, on 320 fabrics of each distribution, with one seed each. Autoencoder "
    "and mixture are fitted to the measured fabrics of the last columns. Linear laws are fitted "
    "to drapes without noise.",
    second_table=fits)
