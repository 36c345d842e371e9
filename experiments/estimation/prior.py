"""Likelihood of unseen fabrics under each prior (paper's Table 1 and Figure 15).

Mixtures (GMM) and autoencoders (VAE) are fitted to 80 % of the distinct fabrics and evaluated on
the others, for several random splits. For all models, outliers are clipped to the plausible range
of the fitted part (:func:`data.fabrics.prior.coordinates.plausible_range`). Log-likelihoods are per
fabric, in nats, of densities in log alpha and in beta/alpha in mm; that of an autoencoder is an
importance-weighted bound.
"""

import time
from dataclasses import dataclass, replace

import numpy as np
import ot
from matplotlib.figure import Figure
from scipy.spatial import cKDTree
from tqdm import tqdm

from common.errors import InputError
from data.fabrics.fabrics import FabricTable, from_theta, read_fabric_table
from data.fabrics.prior import MODELS, Prior, VaePrior
from data.fabrics.prior.coordinates import Coordinates, plausible_range
from experiments.result import Config, Result, table
from sim.material import is_admissible

FITTED = 0.8  # share of the fabrics that is fitted, as in the paper
RADII = (0.75, 1.0, 1.25)  # radii of the coverage, in standard deviations of the table
PER_MILLIMETRE = 3 * np.log(1e-3)  # log of the volume of (mm)³ in m³
NAMES = {"gaussian": "Gaussian of theta"} | {f"gmm{k}": f"GMM (K = {k})" for k in range(3, 8)} | {
    f"vae{k}": f"VAE-{k}" for k in range(1, 5)}


@dataclass(frozen=True)
class Split:
    """theta (F, 6) of the fitted and the unseen fabrics, and the coordinates of distances."""

    fitted: np.ndarray
    unseen: np.ndarray
    coordinates: Coordinates

    def clipped(self) -> tuple[np.ndarray, np.ndarray]:
        """Both parts, with outliers clipped to the plausible range of the fitted part."""
        low, high = plausible_range(self.fitted)
        return np.clip(self.fitted, low, high), np.clip(self.unseen, low, high)


def split_rows(theta: np.ndarray, seed: int, coordinates: Coordinates) -> Split:
    """Split the rows of theta (F, 6) at random."""
    order = np.random.default_rng(seed).permutation(len(theta))
    fitted = round(FITTED * len(theta))
    return Split(theta[order[:fitted]], theta[order[fitted:]], coordinates)


def without_widening(prior: Prior) -> Prior:
    """The prior without the widening that autoencoders apply to samples."""
    if isinstance(prior, VaePrior):
        return replace(prior, shift=0.0, spread=(1.0, 1.0))
    return prior


def log_likelihoods(prior: Prior, split: Split) -> tuple[float, float]:
    """Mean log-likelihoods of the fitted and the unseen fabrics, nats, beta/alpha in mm."""
    return tuple(float(prior.log_likelihood(part).mean()) + PER_MILLIMETRE
                 for part in split.clipped())


def distance(samples: np.ndarray, split: Split) -> float:
    """2-Wasserstein distance of samples (N, 6) from the unseen fabrics, in standard deviations."""
    a, b = (split.coordinates.encode(part) for part in (samples, split.clipped()[1]))
    cost = ot.dist(a, b, metric="sqeuclidean")
    return float(np.sqrt(ot.emd2(ot.unif(len(a)), ot.unif(len(b)), cost, numItermax=10**6)))


def coverage(samples: np.ndarray, split: Split) -> list[float]:
    """Share of unseen fabrics with a sample (of N, 6) within each of ``RADII``."""
    nearest, _ = cKDTree(split.coordinates.encode(samples)).query(
        split.coordinates.encode(split.clipped()[1]))
    return [float((nearest <= radius).mean()) for radius in RADII]


def evaluate(model: str, split: Split, samples: int) -> dict:
    """Fit a model and evaluate it; figures by name."""
    start = time.process_time()
    prior = MODELS[model](split.fitted)
    seconds = time.process_time() - start
    fitted, unseen = log_likelihoods(prior, split)
    figures = {"log_likelihood_fitted": fitted, "log_likelihood_unseen": unseen}
    for name, drawing in (("", without_widening(prior)), ("_widened", prior)):
        if name and drawing is without_widening(prior):
            continue
        theta = drawing.sample(samples, np.random.default_rng(0))
        possible = np.array([is_admissible(*from_theta(row)) for row in theta])
        figures |= {f"wasserstein{name}": distance(theta[possible], split),
                    f"rejected{name}": float(1 - possible.mean())}
        for radius, share in zip(RADII, coverage(theta[possible], split), strict=True):
            figures[f"within_{radius:g}{name}"] = share
    return figures | {"fit_cpu_s": seconds}


def evaluate_rows(model: str, split: Split) -> dict:
    """Likelihoods of a model on a split of rows that were not de-duplicated."""
    fitted, unseen = log_likelihoods(MODELS[model](split.fitted), split)
    return {"log_likelihood_fitted": fitted, "log_likelihood_unseen": unseen}


def mean_and_error(runs: list[dict]) -> dict:
    """[mean, standard error over the splits] of each figure."""
    values = {name: np.array([run[name] for run in runs]) for name in runs[0]}
    error = {name: v.std(ddof=1) / np.sqrt(len(v)) if len(v) > 1 else 0.0
             for name, v in values.items()}
    return {name: [float(v.mean()), float(error[name])] for name, v in values.items()}


def compare(fabrics: FabricTable, models: list[str], splits: int, samples: int) -> dict:
    """Evaluate all models on all splits; contents of the report."""
    theta = fabrics.theta
    coordinates, _ = Coordinates.fit(theta)
    rows = np.repeat(theta, fabrics.multiplicity, axis=0)
    by_fabric = [split_rows(theta, seed, coordinates) for seed in range(splits)]
    by_row = [split_rows(rows, seed, coordinates) for seed in range(splits)]
    leaked = [len(s.unseen) - sum(not (s.fitted == row).all(1).any() for row in s.unseen)
              for s in by_row]
    runs = {model: [evaluate(model, split, samples) for split in by_fabric]
            for model in tqdm(models, desc="split by fabric", unit="model")}
    row_runs = {model: [evaluate_rows(model, split) for split in by_row]
                for model in tqdm(models, desc="split by row", unit="model")}
    unseen = by_fabric[0].unseen
    return {
        "fabrics": len(theta), "rows": len(rows), "splits": splits, "unseen": len(unseen),
        "samples": samples,
        "leaked_rows": {"of": len(by_row[0].unseen), "leaked": leaked},
        "wasserstein_of_the_fitted_fabrics": mean_and_error(
            [{"w": distance(split.clipped()[0], split)} for split in by_fabric])["w"],
        "models": {model: mean_and_error(figures) for model, figures in runs.items()},
        "by_row": {model: mean_and_error(figures) for model, figures in row_runs.items()},
        "runs": {model: [run["log_likelihood_unseen"] for run in figures]
                 for model, figures in runs.items()},
    }


def print_tables(result: dict) -> None:
    """Print Table 1, with the split by row that the paper used, and the coverage."""
    def cell(figures: dict, name: str, digits: int = 2) -> str:
        if name not in figures:
            return ""
        mean, error = figures[name]
        return f"{mean:.{digits}f} ± {error:.{digits}f}"

    leaked = result["leaked_rows"]
    names = ("log_likelihood_fitted", "log_likelihood_unseen", "wasserstein")
    print(f"\n{result['fabrics']} distinct fabrics, {result['unseen']} of them unseen, "
          f"{result['splits']} splits; by row: {np.mean(leaked['leaked']):.0f} of "
          f"{leaked['of']} rows leaked\n")
    head = ["model", "log-likelihood, fitted", "unseen", "Wasserstein", "by row: fitted", "unseen"]
    print(table(head, [
        [NAMES[model], *(cell(figures, name) for name in names),
         *(cell(result["by_row"][model], name) for name in names[:2])]
        for model, figures in result["models"].items()]))
    mean, error = result["wasserstein_of_the_fitted_fabrics"]
    print(f"\nWasserstein distance of the fitted fabrics themselves: {mean:.2f} ± {error:.2f}\n")
    columns = [f"within_{radius:g}{kind}" for kind in ("", "_widened") for radius in RADII]
    head = ["unseen fabrics with a sample within ...", *(f"{radius:g}" for radius in RADII),
            *(f"widened {radius:g}" for radius in RADII), "rejected"]
    print(table(head, [
        [NAMES[model], *(cell(figures, name) for name in columns),
         cell(figures, "rejected_widened" if "rejected_widened" in figures else "rejected", 4)]
        for model, figures in result["models"].items()]))


def plot_samples(fabrics: FabricTable, samples: int, models: tuple[str, ...]) -> Figure:
    """Figure 15: fabrics and samples of models fitted to all fabrics, in three projections."""
    views = (("alpha warp, µN·m", "alpha weft, µN·m"), ("alpha bias, µN·m", "beta/alpha bias, mm"),
             ("beta/alpha warp, mm", "beta/alpha weft, mm"))
    columns = ((0, 2), (1, 4), (3, 5))

    def shown(theta: np.ndarray) -> np.ndarray:
        return np.concatenate([np.exp(theta[:, :3]) * 1e6, theta[:, 3:] * 1e3], axis=1)

    figure = Figure(figsize=(12, 4 * len(models)), layout="constrained")
    axes = figure.subplots(len(models), 3, squeeze=False, sharex="col", sharey="col")
    for row, model in zip(axes, models, strict=True):
        drawn = shown(MODELS[model](fabrics.theta).sample(samples, np.random.default_rng(0)))
        real = shown(fabrics.theta)
        for k, (axis, (x, y), labels) in enumerate(
                zip(row, columns, views, strict=True)):
            axis.scatter(drawn[:, x], drawn[:, y], s=3, color="tab:blue", alpha=0.4, lw=0,
                         label="samples")
            axis.scatter(real[:, x], real[:, y], s=9, color="tab:orange", lw=0, label="fabrics")
            axis.set(xlabel=labels[0], ylabel=labels[1], title=NAMES[model] if k == 0 else "")
            if k < 2:
                axis.set_xscale("log")
            if k == 0:
                axis.set_yscale("log")
                axis.legend(loc="upper left", markerscale=2)
            if k == 1:
                axis.set_ylim(-14, 2)
            if k == 2:
                axis.set(xlim=(-14, 2), ylim=(-14, 2))
    return figure


def run(config: Config) -> Result:
    """Compare the models; print the tables."""
    if unknown := [name for name in config["models"] if name not in MODELS]:
        raise InputError(f"models={','.join(unknown)}: known are {', '.join(MODELS)}")
    if config["splits"] < 1 or config["samples"] < 10:
        raise InputError("splits must be at least 1, samples at least 10")
    fabrics = read_fabric_table(config["fabrics"])
    result = compare(fabrics, config["models"], config["splits"], config["samples"])
    print_tables(result)
    return Result(result, plot_samples(fabrics, config["samples"], ("gmm3", "vae4")))
