"""Learning curves: errors of networks on unseen and on their own drapes, by drapes and steps.

Networks of several widths are trained on a share of a dataset's fabrics, for as many steps or for
steps in proportion. Each estimates single captures of the dataset's validation fabrics, which no
network is trained on, and of as many of the fabrics that it was trained on. Errors are root mean
squares of log alpha, over the spread of the prior's fabrics, and medians of the error of alpha; the
dataset's fabrics may be stiffer and limper than the prior's.
"""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from common.command import compose_config
from data.rigs import named_tester
from drapenet.config import TrainConfig
from drapenet.network.captures import CaptureSet
from drapenet.network.checkpoint import Header, load_model, read_header
from drapenet.network.dataset import Maps
from drapenet.network.evaluate import CELLS, judge
from drapenet.network.model import Network
from drapenet.network.training import open_captures
from experiments.result import Config, Result, label_log_axes, run_cases
from train import train

INPUTS = {"depth views": CELLS["depth, 4 views"].condition,
          "outline": CELLS["outline, parallel light"].condition}
"""Conditions of the evaluation; the number of views varies as in training."""
SOURCES = ("drapenet/network", "train.py")


def of_tester(maps: Maps, tester: str) -> np.ndarray:
    """Mask (N,) of the captures on a ``tester``; "squares" and "discs" are those of any size,
    "rectangles" have different sides."""
    shapes = {"discs": maps.disc, "rectangles": ~maps.disc & (maps.aspect != 1),
              "squares": ~maps.disc & (maps.aspect == 1)}
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
    config.fabrics = round(share * len(np.unique(open_captures(config)[0].maps.fabric)))
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


def run(config: Config) -> Result:
    """Train and judge all networks."""
    common = {key: config[key] for key in ("data", "maps", "testers", "seed", "work")}
    cases = {name: common | dict(zip(("share", "steps", "width"), one, strict=True))
             for name, one in config["runs"].items()}
    found = run_cases(train_and_judge, cases, config, sources=SOURCES)
    report = {"runs": {name: cases[name] | found[name] for name in cases}}
    return Result(report, draw(report))


def draw(report: dict) -> Figure:
    """Plot errors of log alpha, of the spread, against the number of drapes."""
    figure = Figure(figsize=(8.0, 3.4), layout="constrained")
    runs = sorted(report["runs"].values(), key=lambda one: one["drapes"])
    for axis, name in zip(figure.subplots(1, 2, sharey=True), INPUTS, strict=True):
        for k, tester in enumerate(("discs", "squares", "rectangles")):
            for whose, line in (("unseen", "o-"), ("own", "^:")):
                values = [one[whose][name][tester]["log_alpha"]["rmse"] for one in runs]
                axis.loglog([one["drapes"] for one in runs], values, line, color=f"C{k}", ms=4,
                            label=f"{tester}, {whose}")
        label_log_axes(axis.yaxis)
        axis.set_xlabel("training drapes", fontsize=8)
        axis.set_title(f"error of log α, of the spread: {name}", fontsize=9)
        axis.legend(fontsize=7, frameon=False)
    return figure
