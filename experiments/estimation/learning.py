"""Learning curves: errors of networks on unseen and on their own drapes, by drapes and steps.

Networks of several widths are trained on a share of a dataset's fabrics, for as many steps or for
steps in proportion. Each estimates single captures of the dataset's validation fabrics, which no
network is trained on, and of as many of the fabrics that it was trained on. Errors are root mean
squares of log alpha, over the spread of the prior's fabrics, and medians of the error of alpha; the
dataset's fabrics may be stiffer and limper than the prior's.
"""

from pathlib import Path
from typing import Any

import numpy as np
import torch
from matplotlib.figure import Figure

from common.command import compose_config
from data.dataset.folder import finished_manifest
from data.rigs import named_tester
from drapenet.config import TrainConfig
from drapenet.network.captures import PICTURE_NOISE, CaptureSet
from drapenet.network.checkpoint import Header, load_model, read_header
from drapenet.network.dataset import Maps
from drapenet.network.evaluate import CELLS, judge
from drapenet.network.model import Network
from drapenet.network.targets import SYMMETRIES, Symmetry
from drapenet.network.training import open_captures
from drapenet.views.directions import AZIMUTHS
from experiments.result import Config, Result, label_log_axes, rms, run_cases
from sim.material import LINEAR, SWAPPED
from train import train

INPUTS = {"depth views": CELLS["depth, 4 views"].condition,
          "outline": CELLS["outline, parallel light"].condition}
"""Conditions of the evaluation; the number of views varies as in training."""
SHAPES = ("squares", "discs", "rectangles")
"""Specimens of any size on any plate."""
SOURCES = ("drapenet.network", "train")


def of_tester(maps: Maps, tester: str) -> np.ndarray:
    """Mask (N,) of the captures on a ``tester``, or of one of :data:`SHAPES`."""
    even = maps.aspect == 1
    shapes = dict(zip(SHAPES, (~maps.disc & even, maps.disc, ~maps.disc & ~even), strict=True))
    if tester in shapes:
        return shapes[tester]
    rig = named_tester(tester)
    return (shapes["discs" if rig.specimen == "disc" else "squares"]
            & np.isclose(maps.size, rig.specimen_size)
            & np.isclose(maps.plate, rig.plate_diameter / rig.specimen_size))


def errors_of(
    network: Network, header: Header, captures: CaptureSet, testers: list[str]
) -> dict[str, dict[str, Any]]:
    """Errors of single captures by input and tester, none of a tester without captures."""
    found: dict[str, dict[str, Any]] = {}
    for name, condition in INPUTS.items():
        found[name] = {}
        for tester in testers:
            rows = of_tester(captures.maps, tester) & (captures.maps.views > 0)
            if rows.any():
                found[name][tester] = judge(
                    network, header, captures.maps.chosen(rows), condition, seed=0
                ).summary(header.spread)
    return found


def train_and_judge(
    *, data: str, maps: str, share: float, steps: int, width: int, testers: list[str], seed: int,
    work: str,
) -> dict[str, Any]:
    """Errors of a network of ``width`` features that is trained on a ``share`` of the fabrics for
    about ``steps`` steps, whole epochs."""
    words = [f"data={data}", f"maps={maps}", f"model.width={width}", f"seed={seed}", "threads=1",
             "workers=1", f"out={work}/{share:g}_{steps}_{width}"]
    config = compose_config("train", words, schema=TrainConfig)
    manifest = finished_manifest(Path(data))
    fabrics = manifest["drapes"] / manifest["config"]["sampling"]["starts_per_fabric"]
    config.fabrics = round(share * fabrics * (1 - config.validation_fraction))
    training, unseen, _ = open_captures(config)
    in_epoch = len(training.turns) // config.optim.batch_size
    config.epochs = max(1, round(steps / in_epoch))
    header = read_header(train(config))
    network = load_model(header)
    shown = training.maps.chosen(~training.maps.moved)
    first = np.unique(shown.fabric)[: len(np.unique(unseen.maps.fabric))]
    own = CaptureSet(shown.chosen(np.isin(shown.fabric, first)), scale=training.scale)
    return {"drapes": len(np.unique(training.maps.index)), "fabrics": config.fabrics,
            "steps": config.epochs * in_epoch, "validation": header.validation,
            "unseen": errors_of(network, header, unseen, testers),
            "own": errors_of(network, header, own, testers)}


def nearest_drape(
    *, data: str, maps: str, shares: list[float], testers: list[str], seed: int
) -> dict[str, Any]:
    """Errors of the fabric of the nearest training outline, by tester and share of the fabrics: a
    reader that knows each simulated drape and its neighbours, and nothing between them."""
    words = [f"data={data}", f"maps={maps}", f"seed={seed}", "workers=1"]
    training, unseen, _ = open_captures(compose_config("train", words, schema=TrainConfig))
    rng = np.random.default_rng(seed)
    found: dict[str, Any] = {}
    for tester in testers:
        known, asked = (captures.maps.chosen(of_tester(captures.maps, tester))
                        for captures in (training, unseen))
        seen = asked.silhouettes[:, 0] + PICTURE_NOISE / 3**0.5 * rng.standard_normal(
            (len(asked), AZIMUTHS))
        gap = np.stack([_squares(seen, Symmetry.number(k, len(known)).of_rows(
            torch.from_numpy(known.silhouettes[:, 0])).numpy()) for k in range(SYMMETRIES)])
        order = np.random.default_rng(0).permutation(np.unique(known.fabric))
        found[tester] = {}
        for share in shares:
            within = np.isin(known.fabric, order[: round(share * len(order))])
            some = np.where(within, gap, np.inf).transpose(1, 0, 2).reshape(len(asked), -1)
            turn, row = np.unravel_index(some.argmin(axis=1), gap[:, 0].shape)
            theta = np.where((turn % 2 > 0)[:, None], known.theta[row][:, SWAPPED],
                             known.theta[row])
            error = theta[:, LINEAR] - asked.theta[:, LINEAR]
            found[tester][f"{share:g}"] = {
                "drapes": len(np.unique(known.index[within])), "rms": rms(error),
                "median": float(np.expm1(np.median(np.abs(error)))),
                "distance": float(np.sqrt(np.median(some.min(axis=1)) / AZIMUTHS))}
    return found


def _squares(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(N, M) squared distances of outlines (N, A) and (M, A)."""
    return (np.square(one).sum(axis=1)[:, None] + np.square(other).sum(axis=1)
            - 2 * one @ other.T)


def run(config: Config) -> Result:
    """Train and judge all networks."""
    common = {key: config[key] for key in ("data", "maps", "testers", "seed", "work")}
    cases = {name: common | dict(zip(("share", "steps", "width"), one, strict=True))
             for name, one in config["runs"].items()}
    found = run_cases(train_and_judge, cases, config, sources=SOURCES)
    nearest = {key: config[key] for key in ("data", "maps", "seed")} | {
        "shares": sorted({case["share"] for case in cases.values()}),
        "testers": [name for name in config["testers"] if name not in SHAPES]}
    report = {"runs": {name: cases[name] | found[name] for name in cases},
              "nearest": run_cases(nearest_drape, {"nearest": nearest}, config,
                                   sources=SOURCES)["nearest"]}
    return Result(report, draw(report))


def draw(report: dict) -> Figure:
    """Plot errors of log alpha, of the spread, against the number of drapes."""
    figure = Figure(figsize=(8.0, 3.4), layout="constrained")
    runs = sorted(report["runs"].values(), key=lambda one: one["drapes"])
    for axis, name in zip(figure.subplots(1, 2, sharey=True), INPUTS, strict=True):
        for k, tester in enumerate(SHAPES):
            for whose, line in (("unseen", "o-"), ("own", "^:")):
                values = [one[whose][name][tester]["log_alpha"]["rmse"] for one in runs]
                axis.loglog([one["drapes"] for one in runs], values, line, color=f"C{k}", ms=4,
                            label=f"{tester}, {whose}")
        label_log_axes(axis.yaxis)
        axis.set_xlabel("training drapes", fontsize=8)
        axis.set_title(f"error of log α, of the spread: {name}", fontsize=9)
        axis.legend(fontsize=7, frameon=False)
    return figure
