"""Evaluation of a checkpoint: errors and interval coverage on unseen fabrics.

    python -m drapenet.network.evaluate [checkpoint=FILE] [testers=[NAME,...]] [bounds=FILE]

Four drapes of each of a number of new fabrics are simulated on each tester and estimated as by
``infer.py``: single captures and sets, from depth views and from outlines, one condition at a time,
of those conditions whose captures the network has learned to read.
Errors are root mean squares of the posterior's mean over the standard deviation of the training
fabrics; beside them stands the smallest possible error where it is known (``python -m experiments
bounds``).
"""

import common.interrupt  # noqa: F401

# isort: split
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
from tqdm import tqdm

from common.command import command, compose_config
from common.documents import read_json
from common.errors import InputError
from common.files import folder_named, replace_json, require_folder
from data.dataset.config import DatasetConfig, Options, config_from_options
from data.dataset.generate import generate_dataset
from data.fabrics.fabrics import read_fabric_table
from data.fabrics.prior import TablePrior
from data.rigs import named_tester
from drapenet.config import EvaluateConfig, Input
from drapenet.network.captures import CaptureSet, Condition, readable
from drapenet.network.checkpoint import Header, load_model, read_header
from drapenet.network.dataset import Maps, make_maps
from drapenet.network.model import Network
from drapenet.network.posterior import covered, inside, ranks
from drapenet.network.predict import sample_targets
from drapenet.network.targets import cloth_of, stiffer_first, targets_of

DRAPES_PER_FABRIC = 4
_BATCH_SIZE = 32  # sets
_REPEATS = 2  # sets of each fabric and size, of other drapes or other captures of them
_RESAMPLES = 400  # of the bootstrap
DEPTH, OUTLINE, NUMBERS = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Cell:
    """One entry of the matrix, of each tester."""

    condition: Condition
    setups: dict[str, Any] = field(default_factory=dict)  # replacements for those trained on
    rows: Callable[[Maps], np.ndarray] | None = None  # mask of the captures used; None: all

    @property
    def kind(self) -> Input:
        """The one kind of its captures."""
        return get_args(Input)[self.condition.kinds.index(1.0)]


def _sets(size: int) -> tuple[float, ...]:
    return tuple(float(k == size) for k in range(1, DRAPES_PER_FABRIC + 1))


def _views(count: int) -> dict[str, Any]:
    return {"views": tuple(float(k == count) for k in range(1, 9))}


def _pitch(degrees: float) -> dict[str, Any]:
    return {"pitch": (np.radians(degrees),) * 2}


def _outer(values: np.ndarray) -> np.ndarray:
    """Mask of the lowest and the highest eighth of values (N,)."""
    low, high = np.quantile(values, [0.125, 0.875])
    return (values <= low) | (values >= high)


_ALONE = Condition(DEPTH, _sets(1), known=1.0)
_PARALLEL = Condition(OUTLINE, _sets(1), known=1.0, parallel=1.0)
CELLS: dict[str, Cell] = {
    **{f"depth, {count} view{'s' * (count > 1)}": Cell(_ALONE, _views(count))
       for count in (4, 1, 2, 8)},
    "depth, warp not stated": Cell(replace(_ALONE, known=0.0)),
    **{f"depth, camera {degrees}° below the horizontal": Cell(_ALONE, _pitch(degrees))
       for degrees in (25, 50)},
    "depth, membrane at its limits": Cell(_ALONE, rows=lambda maps: _outer(maps.membrane)),
    "depth, hysteresis at its limits": Cell(_ALONE, rows=lambda maps: _outer(maps.hysteresis)),
    **{f"depth, sets of {size}": Cell(replace(_ALONE, sizes=_sets(size))) for size in (2, 4)},
    "outline, parallel light": Cell(_PARALLEL),
    "outline, 0.5 m and more": Cell(replace(_PARALLEL, parallel=0.0, stated=1.0)),
    "outline, height not stated": Cell(replace(_PARALLEL, parallel=0.0, stated=0.0)),
    "outline, warp not stated": Cell(replace(_PARALLEL, known=0.0)),
    **{f"outline, sets of {size}": Cell(replace(_PARALLEL, sizes=_sets(size)))
       for size in (2, 4)},
    "drape coefficient and nodes": Cell(replace(_PARALLEL, kinds=NUMBERS)),
}


def judge(
    network: Network, header: Header, maps: Maps, condition: Condition, *, seed: int
) -> dict[str, Any]:
    """Errors and coverage on sets of captures of unseen fabrics."""
    captures = CaptureSet(maps.chosen(readable(maps, header.config.inputs)), scale=header.scale)
    rng = np.random.default_rng(seed)
    cloths = np.tile(np.arange(len(captures)), _REPEATS)
    errors, places, fabric = [], [], []
    for rows in np.array_split(cloths, -(-len(cloths) // _BATCH_SIZE)):
        batch, facts = captures.batch(rows, condition, rng, symmetric=False)
        samples = sample_targets(network, header, batch, facts.known)
        truth = targets_of(captures.cloth.chosen(rows), facts.sizes)
        if not condition.known:
            truth = stiffer_first(truth)
        drawn = cloth_of(samples, facts.sizes).theta
        theta = cloth_of(truth, facts.sizes).theta
        errors.append((drawn.mean(axis=0) - theta) / header.spread)
        places.append(ranks(drawn, theta))
        fabric.append(rows)
    errors, places = np.concatenate(errors), np.concatenate(places)
    fabric = np.concatenate(fabric)
    return {
        "log_alpha": rms_with_interval(errors[:, :3], fabric),
        "beta_over_alpha": rms_with_interval(errors[:, 3:], fabric),
        "inside": {level: {"mean": mean, "each": each.round(3).tolist()} for (level, mean), each
                   in zip(inside(places).items(), covered(places), strict=True)},
        "sets": len(errors), "fabrics": len(captures),
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
    seed = generation["sampling"]["seed"]
    for training in header.dataset.generation:
        # A fabric depends on the prior, the seed and its index only.
        if generation["prior"] == training["prior"] and seed == training["sampling"]["seed"]:
            raise InputError(f"seed={seed} is that of a training set with the same prior, so these "
                             "fabrics are not unseen; choose another seed")


@command("evaluate", EvaluateConfig)
def main(config: EvaluateConfig) -> None:
    """Evaluate all cells, print their results and write ``evaluation.json``."""
    header = read_header(config.checkpoint)
    out = folder_named(config.out)
    require_folder(out)
    for tester in config.testers:
        header.require_learned(named_tester(tester))
    network = load_model(header)
    results: dict[str, dict] = {}
    bounds = read_json(Path(config.bounds))["cells"] if config.bounds else {}
    for tester in config.testers:
        base = make_config(header, tester, config)
        require_unseen(header, base.as_dict())
        folder, results[tester] = out / tester, {}
        manifest = generate_dataset(base, folder, workers=config.workers)
        cells = {name: cell for name, cell in CELLS.items() if cell.kind in header.config.inputs}
        for name, cell in tqdm(cells.items(), desc=tester, unit="cell", leave=False):
            maps = make_maps(
                folder, manifest, folder, setups=replace(header.setups, **cell.setups),
                captures=config.captures, seed=config.seed, workers=config.workers,
                pictures=header.model.backbone is not None)
            if cell.rows:
                maps = maps.chosen(cell.rows(maps))
            results[tester][name] = judge(
                network, header, maps, cell.condition, seed=config.seed) | {
                "bound": bounds.get(tester, {}).get(name)}
            tqdm.write(format_cell(f"{tester}, {name}", results[tester][name]))
    replace_json(out / "evaluation.json", {"checkpoint": header.identity, "cells": results})
    print(f"written to {out / 'evaluation.json'}")


def make_config(header: Header, tester: str, config: EvaluateConfig) -> DatasetConfig:
    """Configuration of new drapes on a ``tester``, with the nuisances of the training set's."""
    edge_mm = header.dataset.generation[0]["solver"]["edge_mm"]
    words = [f"drapes={DRAPES_PER_FABRIC * config.fabrics_per_tester}", f"seed={config.seed}",
             "dataset=testers", "dataset.even_share=0", f"dataset.testers=[{tester}]",
             "dataset.random_testers=0", "dataset.rectangles=0", "dataset.testers_per_fabric=1",
             f"dataset.starts_per_fabric={DRAPES_PER_FABRIC}",
             f"edge_mm={edge_mm or 'null'}"]  # 0 in older datasets
    base = config_from_options(compose_config("generate", words, schema=Options))
    if not config.fabrics:
        return base
    return replace(base, prior=TablePrior(read_fabric_table(Path(config.fabrics)).theta))


def format_cell(name: str, result: dict[str, Any]) -> str:
    within = ", ".join(f"inside {level[:-1]} %: {share['mean']:.3f}"
                       for level, share in result["inside"].items())
    bound = result["bound"]
    least = f"{bound['log_alpha']:.3f}, {bound['beta_over_alpha']:.3f}" if bound else "–"
    return (f"{name}: log alpha {result['log_alpha']['rmse']:.3f}, "
            f"beta/alpha {result['beta_over_alpha']['rmse']:.3f}, bound {least}, {within}, "
            f"n {result['sets']}")


if __name__ == "__main__":
    main()
