"""Evaluation of a checkpoint: errors and interval coverage on unseen fabrics.

    python -m drapenet.network.evaluate [checkpoint=FILE] [testers=[NAME,...]] [bounds=FILE]

Four drapes of each new fabric of the prior are simulated on each tester and estimated as by
``infer.py``, one condition at a time of those that the network has learned to read. Then fabrics of
evenly distributed stiffness are, by drape coefficient and by stiffness.

Errors of alpha are those of the posterior's geometric mean, as factors: 10 % is 1.1 times too much
or too little. Root mean squares are over the standard deviation of the prior's fabrics; beside them
stands the smallest possible error where it is known (docs/validation/bounds.json).
"""

import common.interrupt  # noqa: F401

# isort: split
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, get_args

import numpy as np
from tqdm import tqdm

from common.command import command, compose_config
from common.documents import read_json
from common.errors import InputError
from common.files import folder_named, replace_json, require_folder
from common.provenance import machine
from common.types import Theta
from data.dataset.config import DatasetConfig, Options, config_from_options
from data.dataset.generate import generate_dataset
from data.fabrics.fabrics import read_fabric_table
from data.fabrics.nuisances import KINDS
from data.fabrics.prior import TablePrior, log_stiffness
from data.rigs import named_tester
from drapenet.config import EvaluateConfig, Input
from drapenet.network.captures import CURLED, CaptureSet, Condition, readable
from drapenet.network.checkpoint import Header, read_header
from drapenet.network.dataset import Maps, make_maps
from drapenet.network.expected import LEVEL
from drapenet.network.posterior import LEVELS, Ranks, covered, ranks
from drapenet.network.predict import network_of, sample_targets
from drapenet.network.targets import cloth_of, stiffer_first, targets_of
from drapenet.network.trained import Trained
from sim.material import MICRO

DRAPES_PER_EVEN_FABRIC = 2
_BATCH_SIZE = 32  # sets
_REPEATS = 2  # sets of each fabric and size, of other drapes or other captures of them
_RESAMPLES = 400  # of the bootstrap
COEFFICIENTS = (20.0, 40.0, 60.0, 80.0)
"""Borders of the bands of drape coefficients, %."""
STIFFNESSES = (4.0, 16.0, 64.0, 200.0)
"""Borders of the bands of stiffness, µN·m at 300 g/m²."""
CLOTHS = (*KINDS, f"curled by more than {CURLED:g} 1/m", "bias softer than the yarns by a third",
          "yarns beyond 4:1")
"""Kinds of fabrics, of which one may be several."""
DEPTH = (1.0, 0.0, 0.0)
OUTLINE = (0.0, 1.0, 0.0)
NUMBERS = (0.0, 0.0, 1.0)


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
    return (*[0.0] * (size - 1), 1.0)


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
    "outline, read over the mat": Cell(replace(_PARALLEL, parallel=0.0, stated=1.0, read=1.0)),
    **{f"outline, {error} mm of 300 stated": Cell(replace(
        _PARALLEL, doubted=1.0, errors=(error / 150,) * 2)) for error in (1, 3, 10)},
    **{f"outline, sets of {size}": Cell(replace(_PARALLEL, sizes=_sets(size)))
       for size in (2, 4, 10)},
    "drape coefficient and nodes": Cell(replace(_PARALLEL, kinds=NUMBERS)),
}
SINGLES = ("depth, 4 views", "outline, parallel light", "drape coefficient and nodes")
"""Cells that are judged by band."""


@dataclass(frozen=True)
class Judged:
    """Estimates of N sets of captures of known fabrics."""

    error: np.ndarray  # (N, 6) of the posterior's mean, log alpha and beta/alpha, m
    places: Ranks
    fabric: np.ndarray  # (N,) number
    stiffness: np.ndarray  # (N,) true mean alpha (geometric), N·m at 300 g/m²
    coefficient: np.ndarray  # (N,) mean drape coefficient of the captures as the network reads it
    cloth: np.ndarray  # (N, CLOTHS) mask
    likeness: np.ndarray  # (N,) of the captures, the least probability, NaN if it is not known

    @classmethod
    def joined(cls, parts: Sequence["Judged"]) -> "Judged":
        """Those of all ``parts``, whose fabrics are different."""
        before = np.cumsum([0, *(part.fabric.max() + 1 for part in parts)])
        parts = [replace(part, fabric=part.fabric + first)
                 for part, first in zip(parts, before[:-1], strict=True)]
        return cls(*(np.concatenate(columns) for columns in
                     zip(*(vars(part).values() for part in parts), strict=True)))

    def summary(self, spread: Theta, rows: np.ndarray | slice = slice(None)) -> dict[str, Any]:
        """Errors and coverage of the sets ``rows``, a mask; ``spread``: (6,) unit of errors."""
        error, places, fabric = (column[rows] / unit for column, unit in (
            (self.error, spread), (self.places, 1), (self.fabric, 1)))
        factor = np.expm1(np.abs(self.error[rows, :3]))
        outside = np.abs(places - 0.5) > 0.495
        alarm = self.likeness[rows] < LEVEL
        return {
            "log_alpha": rms_with_interval(error[:, :3], fabric),
            "beta_over_alpha": rms_with_interval(error[:, 3:], fabric),
            "alpha": {"median": float(np.median(factor)),
                      "ninth_decile": float(np.quantile(factor, 0.9))},
            "inside": {f"{level:.0%}": {
                "mean": float(each.mean()), "each": each.mean(axis=0).round(3).tolist(),
                "error": float(resampled(each.mean(axis=1), fabric).std())}
                for level, each in zip(LEVELS, covered(places), strict=True)},
            "outside_99": float(outside.mean()),
            "outside_99_in_silence": float((outside & ~alarm[:, None]).mean()),
            "alarms": float(alarm.mean()),
            "sets": len(error), "fabrics": len(np.unique(fabric)),
        }

    def by_band(self, spread: Theta) -> dict[str, dict[str, dict[str, Any]]]:
        """Summaries by drape coefficient, stiffness and cloth, of bands that have any sets."""
        found: dict[str, dict[str, dict[str, Any]]] = {}
        for name, values, borders, unit in (
                ("drape coefficient", 100 * self.coefficient, COEFFICIENTS, "%"),
                ("stiffness", self.stiffness / MICRO, STIFFNESSES, "µN·m")):
            band = np.where(np.isfinite(values), np.digitize(values, borders), -1)
            found[name] = {label: self.summary(spread, band == k)
                           for k, label in enumerate(_labels(borders, unit)) if (band == k).any()}
        found["cloth"] = {label: self.summary(spread, mask) for label, mask in
                          zip(CLOTHS, self.cloth.T, strict=True) if mask.any()}
        return found


def _labels(borders: Sequence[float], unit: str) -> list[str]:
    """Names of the bands between ``borders`` (B,), below the first and above the last."""
    return [f"below {borders[0]:g} {unit}",
            *(f"{low:g} to {high:g} {unit}" for low, high in pairwise(borders)),
            f"above {borders[-1]:g} {unit}"]


def _cloths(captures: CaptureSet) -> np.ndarray:
    """(M, CLOTHS) mask of the fabrics."""
    alpha = captures.cloth.theta[:, :3]
    warp, bias, weft = alpha.T
    return np.column_stack([
        *(captures.kind == k for k in range(len(KINDS))),
        captures.curled, bias - (warp + weft) / 2 < np.log(2 / 3),
        np.abs(warp - weft) > np.log(4)])


def judge(
    network: Trained, header: Header, maps: Maps, condition: Condition, *, seed: int
) -> Judged:
    """Estimates of sets of captures of unseen fabrics."""
    captures = CaptureSet(maps.chosen(readable(maps, header.config.inputs)), scale=header.scale)
    rng = np.random.default_rng(seed)
    cloths = np.tile(np.arange(len(captures)), _REPEATS)
    sorts = _cloths(captures)
    parts = []
    for rows in np.array_split(cloths, -(-len(cloths) // _BATCH_SIZE)):
        batch, facts = captures.batch(rows, condition, rng, symmetric=False)
        samples = sample_targets(network, header, batch, facts.known)
        truth = targets_of(captures.cloth.chosen(rows), facts.sizes)
        if not condition.known:
            truth = stiffer_first(truth)
        drawn = cloth_of(samples, facts.sizes).theta
        theta = cloth_of(truth, facts.sizes).theta
        coefficient = (np.bincount(facts.group, facts.coefficient) / np.bincount(facts.group))
        least = np.full(len(rows), np.nan)
        for k, found in enumerate(
                network.likeness(batch, header.scale.encode(samples))):
            least[facts.group[k]] = np.fmin(least[facts.group[k]], found.probability)
        parts.append((drawn.mean(axis=0) - theta, ranks(drawn, theta), rows,
                      np.exp(log_stiffness(theta)), coefficient, sorts[rows], least))
    return Judged(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def rms_with_interval(errors: np.ndarray, fabric: np.ndarray) -> dict[str, Any]:
    """Root mean square of errors (N, 3), and its 95 % bootstrap interval over fabrics (N,)."""
    squares = np.square(errors).mean(axis=1)
    return {"rmse": float(np.sqrt(squares.mean())), "interval_95": np.quantile(
        np.sqrt(resampled(squares, fabric)), [0.025, 0.975]).tolist()}


def resampled(values: np.ndarray, fabric: np.ndarray) -> np.ndarray:
    """Means of values (N,) of bootstrap samples of the fabrics (N,)."""
    _, place = np.unique(fabric, return_inverse=True)
    count, total = np.bincount(place), np.bincount(place, values)
    drawn = np.random.default_rng(0).integers(len(count), size=(_RESAMPLES, len(count)))
    return total[drawn].sum(axis=1) / count[drawn].sum(axis=1)


def require_unseen(header: Header, generation: dict) -> None:
    """InputError if a dataset's configuration gives fabrics that a checkpoint was trained on."""
    seed = generation["sampling"]["seed"]
    for training in header.dataset.generation:
        # A fabric depends on the prior, the seed and its index only.
        if generation["prior"] == training["prior"] and seed == training["sampling"]["seed"]:
            raise InputError(f"seed={seed} is that of a training set with the same prior, so these "
                             "fabrics are not unseen; choose another seed")


def judged(
    header: Header, tester: str, cells: dict[str, Cell], config: EvaluateConfig, *,
    even: bool = False
) -> Iterator[tuple[str, Judged]]:
    """Estimates of each of the ``cells`` by name, of drapes on a ``tester`` that are made, or made
    on, in the folder ``config.out``; ``even`` as for :func:`make_config`."""
    network = network_of(header)
    base = make_config(header, tester, config, even=even)
    require_unseen(header, base.as_dict())
    folder = Path(config.out) / (f"{tester}_even" if even else tester)
    manifest = generate_dataset(base, folder, workers=config.workers)
    for name, cell in tqdm(cells.items(), desc=folder.name, unit="cell", leave=False):
        maps = make_maps(
            folder, manifest, folder, setups=replace(header.setups, **cell.setups),
            captures=config.captures, seed=config.seed, workers=config.workers,
            pictures=header.model.backbone is not None)
        if cell.rows:
            maps = maps.chosen(cell.rows(maps))
        yield name, judge(network, header, maps, cell.condition, seed=config.seed)


@command("evaluate", EvaluateConfig)
def main(config: EvaluateConfig) -> None:
    """Evaluate all cells and bands, print their results and write ``evaluation.json``."""
    header = read_header(config.checkpoint)
    out = folder_named(config.out)
    require_folder(out)
    for tester in config.testers:
        header.require_learned(named_tester(tester))
    bounds = read_json(Path(config.bounds))["cells"] if config.bounds else {}
    known = {name: cell for name, cell in CELLS.items() if cell.kind in header.config.inputs
             and len(cell.condition.sizes) <= config.drapes_per_fabric}

    content: dict[str, Any] = {"machine": machine(), "settings": asdict(config),
                               "checkpoint": header.identity, "spread": header.spread.tolist(),
                               "cells": {tester: {} for tester in config.testers}}
    for tester, cells in content["cells"].items():
        for name, found in judged(header, tester, known, config):
            cells[name] = found.summary(header.spread) | {
                "bound": bounds.get(tester, {}).get(name)}
            tqdm.write(format_cell(f"{tester}, {name}", cells[name]))
    if config.even_fabrics:
        singles = {name: known[name] for name in SINGLES if name in known}
        even = {tester: dict(judged(header, tester, singles, config, even=True))
                for tester in config.testers}
        content["even"] = {tester: {name: {
            "all": found.summary(header.spread), **found.by_band(header.spread)}
            for name, found in each.items()} for tester, each in even.items()}
        content["bands"] = {name: Judged.joined([each[name] for each in even.values()]).by_band(
            header.spread) for name in singles}
        for name, kinds in content["bands"].items():
            for kind, bands in kinds.items():
                for label, result in bands.items():
                    print(format_cell(f"{name}, {kind} {label}", result))
    replace_json(out / "evaluation.json", content)
    print(f"written to {out / 'evaluation.json'}")


def make_config(
    header: Header, tester: str, config: EvaluateConfig, *, even: bool = False
) -> DatasetConfig:
    """Configuration of new drapes on a ``tester``, with the nuisances of the training set's;
    ``even``: of fabrics of evenly distributed stiffness."""
    edge_mm = header.dataset.generation[-1]["solver"]["edge_mm"]
    drapes = DRAPES_PER_EVEN_FABRIC if even else config.drapes_per_fabric
    fabrics = config.even_fabrics if even else config.fabrics_per_tester
    words = [f"drapes={drapes * fabrics}", f"seed={config.seed + even}",
             "dataset=testers", f"dataset.even_share={float(even)}", f"dataset.testers=[{tester}]",
             "dataset.random_testers=0", "dataset.rectangles=0",
             "dataset.testers_per_fabric=1", f"dataset.starts_per_fabric={drapes}",
             f"edge_mm={edge_mm or 'null'}",  # 0 in older datasets
             *config.generate]
    base = config_from_options(compose_config("generate", words, schema=Options))
    if not config.fabrics:
        return base
    return replace(base, prior=TablePrior(read_fabric_table(Path(config.fabrics)).theta))


def format_cell(name: str, result: dict[str, Any]) -> str:
    """A line about a cell."""
    within = ", ".join(f"{level[:-1]} %: {share['mean']:.3f}"
                       for level, share in result["inside"].items())
    bound, alpha = result.get("bound"), result["alpha"]
    error = ", ".join(
        f"{key.replace('_over_', '/').replace('_', ' ')} {result[key]['rmse']:.3f}"
        + (f" (bound {bound[key]:.3f})" if bound else "")
        for key in ("log_alpha", "beta_over_alpha"))
    return (f"{name}: alpha off by {alpha['median']:.1%} in the median, "
            f"{alpha['ninth_decile']:.1%} in nine of ten; of the spread: {error}; inside {within}; "
            f"false alarms {result['alarms']:.1%}; {result['sets']} sets of {result['fabrics']} "
            "fabrics")


if __name__ == "__main__":
    main()
