"""Evaluation of a checkpoint: errors and interval coverage on unseen fabrics.

    python -m drapenet.network.evaluate [rig=NAME] [checkpoint=FILE] [drapes=N] [fabrics=TABLE.csv]

Drapes of new fabrics from the prior, or of measured ones, are simulated and estimated as by
``infer.py``, with one condition varied at a time. Errors are root mean squares of the posterior's
mean in units of the training fabrics' standard deviation.
"""

import common.interrupt  # noqa: F401

# isort: split
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from common.command import command, compose_config
from common.errors import InputError
from common.files import folder_named, replace_json, require_folder
from data.dataset.config import DatasetConfig, Options, config_from_options
from data.dataset.generate import generate_dataset
from data.fabrics.fabrics import read_fabric_table
from data.fabrics.nuisances import NuisanceConfig
from data.fabrics.prior import TablePrior, is_soft
from drapenet.config import EvaluateConfig
from drapenet.network.checkpoint import Header, bundled, load_model, read_header
from drapenet.network.dataset import Maps, make_maps
from drapenet.network.model import MapNet
from drapenet.network.posterior import covered, inside, ranks
from drapenet.network.predict import sample_targets
from drapenet.network.targets import MODULI
from drapenet.network.training import CaptureSet
from sim.rig import Rig

REDUCTION = 5  # divides the number of drapes for all conditions but "as trained"
_BATCH_SIZE = 64  # captures
_RESAMPLES = 400  # of the bootstrap
_FINE_EDGE = 1.75e-3  # m, of the mesh's edges at the plate's rim
_HIGH_HYSTERESIS = 0.25  # share of the loading torque

@dataclass(frozen=True)
class Cell:
    """One entry of the matrix."""

    drapes: str = "as trained"  # dataset, a key of :func:`datasets`
    setups: dict[str, Any] = field(default_factory=dict)  # replacements for those trained on
    known: bool = False  # whether the membrane is given to the network
    rows: Callable[[Maps], np.ndarray] | None = None  # mask of the captures used; None: all


def _views(count: int) -> dict[str, Any]:
    return {"views": tuple(float(k == count) for k in range(1, 9))}


def _fixed(name: str, value: float) -> dict[str, Any]:
    return {name: (value, value)}


CELLS: dict[str, Cell] = {
    "as trained": Cell(),
    "without nuisances": Cell("none", {**_views(4), "sensors": {"smooth": 1.0}}, known=True),
    "finer mesh": Cell("finer mesh"),
    **{f"sensor {name}": Cell(setups={"sensors": {name: 1.0}})
       for name in ("smooth", "paper", "tof")},
    **{f"views {count}": Cell(setups=_views(count)) for count in (1, 2, 4, 8)},
    **{f"pitch {degrees}°": Cell(setups=_fixed("pitch", np.radians(degrees)))
       for degrees in (25, 50)},
    **{f"distance {metres} m": Cell(setups=_fixed("distance", metres)) for metres in (0.4, 0.7)},
    "membrane x 3": Cell("membrane x 3"),
    "membrane / 3": Cell("membrane / 3"),
    "hysteresis above 25 %": Cell(
        rows=lambda maps: maps.nuisance("hysteresis") > _HIGH_HYSTERESIS),
    "soft fabrics": Cell(rows=lambda maps: is_soft(maps.theta)),
}


def datasets(base: DatasetConfig) -> dict[str, DatasetConfig]:
    """Configurations of the matrix's datasets, derived from ``base``, drapes as trained on."""
    real = base.sampling.nuisances
    middle = float(np.sqrt(np.prod(real.membrane)))
    smaller = replace(base, drapes=-(-base.drapes // REDUCTION))

    def with_nuisances(nuisances: NuisanceConfig) -> DatasetConfig:
        return replace(smaller, sampling=replace(base.sampling, nuisances=nuisances))

    return {
        "as trained": base,
        "none": with_nuisances(NuisanceConfig()),
        "finer mesh": replace(smaller, edge=_FINE_EDGE),
        **{f"membrane {sign} 3": with_nuisances(replace(real, membrane=(value, value)))
           for sign, value in (("x", 3 * middle), ("/", middle / 3))},
    }


def judge(network: MapNet, header: Header, maps: Maps, *, known: bool) -> dict[str, Any]:
    """Errors and coverage on captures of unseen fabrics; ``known``: whether the membrane is given.
    """
    disc = header.rig.specimen == "disc"
    captures = CaptureSet(maps, disc=disc, scale=header.scale)
    truth, means, places = captures.truth, [], []
    for rows, batch in captures.in_order(_BATCH_SIZE, known=known):
        samples = sample_targets(network, header, batch)
        means.append(samples.mean(axis=0)[:, :MODULI])
        places.append(ranks(samples, truth[rows])[:, :MODULI])
    spread = header.scale.std[:MODULI]
    errors = (np.concatenate(means) - truth[:, :MODULI]) / spread
    places = np.concatenate(places)
    return {
        "log_alpha": rms_with_interval(errors[:, :3], maps.fabric),
        "beta_over_alpha": rms_with_interval(errors[:, 3:], maps.fabric),
        "prior": {"log_alpha": float(np.std(truth[:, :3] / spread[:3], axis=0).mean()),
                  "beta_over_alpha": float(np.std(truth[:, 3:6] / spread[3:], axis=0).mean())},
        "inside": {level: {"mean": mean, "each": each.round(3).tolist()} for (level, mean), each
                   in zip(inside(places).items(), covered(places), strict=True)},
        "captures": len(maps), "drapes": len(np.unique(maps.index)),
    }


def rms_with_interval(errors: np.ndarray, fabric: np.ndarray) -> dict[str, Any]:
    """Root mean square of errors (N, 3), and its 95 % bootstrap interval over fabrics (N,)."""
    _, place = np.unique(fabric, return_inverse=True)
    count = np.bincount(place)
    squares = np.bincount(place, np.square(errors).mean(axis=1))
    drawn = np.random.default_rng(0).integers(len(count), size=(_RESAMPLES, len(count)))
    resampled = np.sqrt(squares[drawn].sum(axis=1) / count[drawn].sum(axis=1))
    return {"rmse": float(np.sqrt(squares.sum() / count.sum())),
            "interval_95": np.quantile(resampled, [0.025, 0.975]).tolist()}


def require_unseen(header: Header, generation: dict) -> None:
    """InputError if a dataset's configuration gives fabrics that a checkpoint was trained on."""
    training = header.dataset.generation
    # A fabric depends on the prior, the seed and its index only.
    if (generation["prior"] == training["prior"]
            and generation["sampling"]["seed"] == training["sampling"]["seed"]):
        raise InputError(f"seed={training['sampling']['seed']} is that of the training set with "
                         "the same prior, so these fabrics are not unseen; choose another seed")


@command("evaluate", EvaluateConfig)
def main(config: EvaluateConfig) -> None:
    """Evaluate all cells, print their results and write ``evaluation.json``."""
    header = read_header(config.checkpoint or bundled(Rig.from_name(config.rig)))
    out = folder_named(config.out) / header.rig.name
    require_folder(out)
    network = load_model(header)
    base = make_config(header, drapes=config.drapes, seed=config.seed)
    cells = CELLS
    if config.fabrics:
        base = replace(base, prior=TablePrior(read_fabric_table(config.fabrics).theta),
                       sampling=replace(base.sampling, soft_share=0.0))
        cells = {name: CELLS[name] for name in ("as trained", "without nuisances")}
        out = out / Path(config.fabrics).stem
    require_unseen(header, base.as_dict())
    results = {}
    few = -(-base.drapes // (REDUCTION * base.drapes_per_shard))  # shards for other set-ups
    for name, cell in tqdm(cells.items(), desc="matrix", unit="cell", leave=False):
        folder = out / cell.drapes.replace(" ", "_").replace("/", "d")
        manifest = generate_dataset(datasets(base)[cell.drapes], folder, workers=config.workers)
        maps = make_maps(folder, manifest, folder,
                         setups=replace(header.setups, **cell.setups),
                         captures=config.captures, seed=config.seed, workers=config.workers,
                         shards=few if cell.setups else None)
        if cell.rows is not None:
            maps = maps.chosen(cell.rows(maps))
        if not len(maps):
            continue
        results[name] = judge(network, header, maps, known=cell.known)
        tqdm.write(format_cell(name, results[name]))
    replace_json(out / "evaluation.json", {"checkpoint": header.identity, "cells": results})
    print(f"written to {out / 'evaluation.json'}")


def make_config(header: Header, *, drapes: int, seed: int) -> DatasetConfig:
    """Configuration of new drapes, generated as the training set of a checkpoint was."""
    words = [f"drapes={drapes}", f"seed={seed}", f"dataset.testers=[{header.rig.name}]",
             "dataset=specimens", "nuisances=real",
             f"edge_mm={header.dataset.generation['solver']['edge_mm']}"]
    return config_from_options(compose_config("generate", words, schema=Options))


def format_cell(name: str, result: dict[str, Any]) -> str:
    inside = result["inside"]
    return (f"{name}: log alpha {result['log_alpha']['rmse']:.3f}, "
            f"beta/alpha {result['beta_over_alpha']['rmse']:.3f}, "
            f"inside 68 %: {inside['68%']['mean']:.3f}, "
            f"inside 90 %: {inside['90%']['mean']:.3f}, n {result['captures']}")


if __name__ == "__main__":
    main()
