"""Which description of a drape tells fabrics apart: ``python -m benchmarks.descriptor``.

Fabrics drawn from the prior are draped from several starts. A description is good if drapes of
one fabric in different folds are closer to each other than to other fabrics' drapes (Larionov et
al., Figure 7), and if distances between fabrics grow with the difference of their moduli.

Keys (``key=value``):

    fabrics      how many
    starts       of each, 2 to 6
    edge_mm      edges of the mesh at the plate's rim
    seed         of the fabrics
    workers      processes, one thread each
    cases        folder of finished drapes; an interrupted run goes on from there
    out          the report, JSON; a picture of the same name beside it
"""

from itertools import product
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import spearmanr

from benchmarks.common import (
    REPORTS,
    load_arrays,
    parse_settings,
    run_cases,
    table,
    write_figure,
    write_report,
)
from common.cli import run_command
from common.errors import InputError
from data.fabrics import fabric_from_theta
from data.prior.files import load_prior, sample_admissible
from drapenet.descriptor import GridSpectrum, RingSpectrum
from sim.drape import drape
from sim.initial import interpolate_positions
from sim.scene import Rig

OTHER_FOLDS = 5e-3  # m, between two drapes of a fabric, where folds lie elsewhere
STARTS = (("sine", 0), ("fold", 0), ("sine", 1), ("fold", 1), ("sine", 2), ("fold", 2))
DESCRIPTIONS = {
    "positions": "vertex positions",
    "grid": "2-D FFT of the grid (Eq. 9)",
    "rings": "FFT along rings",
}
DEFAULTS = {
    "fabrics": 16,
    "starts": 4,
    "edge_mm": 4.0,
    "seed": 0,
    "workers": 1,
    "cases": "outputs/validation/descriptor",
    "out": str(REPORTS / "descriptor.json"),
}


def one_drape(theta: list[float], start: str, seed: int, edge_mm: float) -> dict:
    """Drape a fabric theta (6,) from one start."""
    result = drape(fabric_from_theta(np.array(theta)), edge=1e-3 * edge_mm, start=start, seed=seed)
    return {"status": result.status.value, "seconds": round(result.seconds, 2),
            "arrays": {"rest": result.rest, "positions": result.positions}}


def descriptions(rest: np.ndarray, positions: np.ndarray, points: int = 41) -> dict:
    """Every description (D,), m, of a drape; norms of differences are root mean squares."""
    rig = Rig()
    axis = np.linspace(-0.499, 0.499, points) * rig.specimen_size
    grid = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    at_grid = interpolate_positions(rest, positions, grid)
    return {
        "positions": at_grid.ravel() / points,
        "grid": GridSpectrum(rest, rig).describe(positions),
        "rings": RingSpectrum(rest, rig).describe(positions),
    }


def figures(
    described: np.ndarray, fabric: np.ndarray, log_alpha: np.ndarray, elsewhere: np.ndarray
) -> dict:
    """What descriptions (N, D) tell of drapes of fabrics (N,) with log alpha (F, 3).

    Pairs ``elsewhere`` (N, N) are drapes of one fabric with other folds.

    Returns within, between: median distance of two drapes of one fabric and of two, mm. positive:
    share of Larionov's differences (a drape to another fabric's, less the distance within the
    fabric) above 0. nearest: share of drapes whose nearest other drape is of the same fabric.
    elsewhere_mm: median distance of pairs with other folds; nearest_elsewhere: share of the drapes
    that have such a partner, and lie nearer to one than to any drape of another fabric. rank:
    Spearman's correlation of the distance between two fabrics (mean over their drapes) with that
    of their log alpha.
    """
    distance = np.linalg.norm(described[:, None] - described, axis=-1)
    same = fabric[:, None] == fabric
    other = ~np.eye(len(fabric), dtype=bool)
    names = np.unique(fabric)
    within = {f: distance[np.ix_(fabric == f, fabric == f)] for f in names}
    own = {f: d[np.triu_indices(len(d), 1)].mean() for f, d in within.items()}
    relative = [distance[i, j] - own[fabric[i]]
                for i, j in product(range(len(fabric)), repeat=2) if fabric[i] != fabric[j]]
    nearest = np.where(other, distance, np.inf).argmin(axis=1)
    folded = elsewhere.any(axis=1)
    candidates = np.where(~same | elsewhere, distance, np.inf)[folded].argmin(axis=1)
    pairs = [(a, b) for a in names for b in names if a < b]
    apart = [distance[np.ix_(fabric == a, fabric == b)].mean() for a, b in pairs]
    moduli = [np.linalg.norm(log_alpha[a] - log_alpha[b]) for a, b in pairs]
    return {
        "within_mm": float(1e3 * np.median(distance[same & other])),
        "between_mm": float(1e3 * np.median(distance[~same])),
        "positive": float(np.mean(np.array(relative) > 0)),
        "nearest": float(np.mean(fabric[nearest] == fabric)),
        "elsewhere_mm": float(1e3 * np.median(distance[elsewhere])) if folded.any() else None,
        "nearest_elsewhere": (float(np.mean(fabric[candidates] == fabric[folded]))
                              if folded.any() else None),
        "rank": float(spearmanr(apart, moduli).statistic),
    }


def main(argv: list[str]) -> None:
    """Drape, print the table, write the report and its picture."""
    config = parse_settings(DEFAULTS, argv)
    if not 2 <= config["starts"] <= len(STARTS) or config["fabrics"] < 3:
        raise InputError(f"give 3 fabrics or more and from 2 to {len(STARTS)} starts")
    rng = np.random.default_rng(config["seed"])
    prior = load_prior("gaussian")
    thetas = np.array([sample_admissible(prior, rng)[0] for _ in range(config["fabrics"])])
    cases = {
        f"fabric_{k}_{start}_{seed}_{config['edge_mm']:g}_{config['seed']}":
            {"theta": thetas[k].tolist(), "start": start, "seed": seed,
             "edge_mm": config["edge_mm"]}
        for k in range(config["fabrics"]) for start, seed in STARTS[: config["starts"]]
    }
    folder = Path(config["cases"])
    found = run_cases(one_drape, cases, folder=folder, workers=config["workers"])
    fabric, described = [], {name: [] for name in DESCRIPTIONS}
    for name, result in found.items():
        if result["status"] != "converged":
            continue
        arrays = load_arrays(folder, name)
        fabric.append(int(name.split("_")[1]))
        for key, values in descriptions(arrays["rest"], arrays["positions"]).items():
            described[key].append(values)
    fabric = np.array(fabric)
    shapes = np.array(described["positions"])
    moved = np.linalg.norm(shapes[:, None] - shapes, axis=-1) > OTHER_FOLDS
    elsewhere = moved & (fabric[:, None] == fabric)
    rows = {key: figures(np.array(values), fabric, thetas[:, :3], elsewhere)
            for key, values in described.items()}
    chance = float(np.mean([(fabric == f).sum() - 1 for f in fabric]) / (len(fabric) - 1))
    print(table(
        ["description", "within a fabric, mm", "between fabrics, mm", "ratio",
         "differences > 0", "nearest drape is of the same fabric", "with other folds, mm",
         "nearest of these", "rank correlation with log α"],
        [[DESCRIPTIONS[key], row["within_mm"], row["between_mm"],
          row["between_mm"] / row["within_mm"], f"{row['positive']:.0%}", f"{row['nearest']:.0%}",
          row["elsewhere_mm"] or "-", f"{row['nearest_elsewhere'] or 0:.0%}",
          f"{row['rank']:.2f}"] for key, row in rows.items()]))
    print(f"{int(elsewhere.any(axis=1).sum())} drapes have a partner with other folds; nearest by "
          f"chance: {chance:.0%}; {len(fabric)} of {len(found)} drapes are equilibria")
    out = Path(config["out"])
    write_report(out, {
        "settings": {k: config[k] for k in ("fabrics", "starts", "edge_mm", "seed")},
        "descriptions": rows, "nearest_by_chance": chance, "drapes": len(fabric),
        "not_converged": len(found) - len(fabric), "theta": thetas.tolist(),
    })
    draw({k: np.array(v) for k, v in described.items()}, fabric, out.with_suffix(".png"))


def draw(described: dict[str, np.ndarray], fabric: np.ndarray, path: Path) -> None:
    """Histograms of the distances within one fabric and between two."""
    figure = Figure(figsize=(9, 2.8), layout="constrained")
    for axis, (key, values) in zip(figure.subplots(1, len(described)), described.items(),
                                   strict=True):
        distance = 1e3 * np.linalg.norm(values[:, None] - values, axis=-1)
        same = fabric[:, None] == fabric
        upper = np.triu(np.ones_like(same), 1)
        bins = np.linspace(0, np.quantile(distance, 0.99), 40)
        for mask, label in ((same & upper, "one fabric"), (~same & upper, "two fabrics")):
            axis.hist(distance[mask], bins=bins, density=True, alpha=0.6, label=label)
        axis.set_title(DESCRIPTIONS[key], fontsize=9)
        axis.set_xlabel("distance, mm", fontsize=8)
        axis.set_yticks([])
    figure.axes[0].legend(fontsize=8, frameon=False)
    write_figure(path, figure)


if __name__ == "__main__":
    run_command(main, usage=__doc__)
