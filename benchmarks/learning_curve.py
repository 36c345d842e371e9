"""What more fabrics are worth: ``python -m benchmarks.learning_curve [key=value ...]``.

Trains the network on the captures of more and more fabrics of one dataset, from random weights and
for as many steps each, and judges all as :mod:`drapenet.evaluate` does on captures of the same
other fabrics, none of them a moved neighbour. Finished trainings are not repeated.

Keys (``key=value``):

    data        dataset of drapes
    fabrics     numbers of its fabrics to train on
    captures    of each drape
    neighbours  whether all but the first are of a neighbour of its fabric
    steps       of each training
    width       of the network
    batch       captures a step
    seeds       trainings of each size, with seeds 0, 1, ...
    workers     processes that make captures, and trainings at a time, one thread each
    work        folder of captures and results
    out         the report, JSON; the picture lies beside it
"""

from pathlib import Path

import numpy as np
import torch
from matplotlib.figure import Figure

from benchmarks.common import (
    ESTIMATOR,
    REPORTS,
    parse_settings,
    run_cases,
    table,
    write_figure,
    write_report,
)
from benchmarks.fitting import fit
from common.cli import run_command
from common.command import compose_config
from common.errors import InputError
from drapenet.checkpoint import Header
from drapenet.config import TrainConfig
from drapenet.evaluate import judge
from drapenet.network import MapNet
from drapenet.training import CaptureSet, open_captures

HELD_OUT = 0.12  # of the fabrics
DEFAULTS = {"data": "outputs/dataset", "fabrics": [250, 500, 1000, 2000], "captures": 6,
            "neighbours": True, "steps": 3000, "width": 32, "batch": 64, "seeds": 1, "workers": 2,
            "work": "outputs/learning_curve", "out": str(REPORTS / "learning_curve.json")}
KEYS = ("data", "captures", "neighbours", "work", "steps", "width", "batch")  # of one training


def settings(config: dict, workers: int = 1) -> TrainConfig:
    """Of a training on all fabrics."""
    words = [f"{key}={config[key]}" for key in ("data", "captures", "neighbours")]
    words += [f"out={config['work']}", f"workers={workers}", f"model.width={config['width']}",
              f"optim.batch_size={config['batch']}", f"validation_fraction={HELD_OUT}"]
    return compose_config("train", words, schema=TrainConfig)


def learn(*, config: dict, fabrics: int, seed: int, dataset: str) -> dict:
    """Train on so many fabrics; the errors on unseen ones. ``dataset`` says what ``data`` holds."""
    training, unseen, scale, manifest = open_captures(options := settings(config))
    maps = training.maps
    few = maps.chosen(np.isin(maps.fabric, np.unique(maps.fabric)[:fabrics]))
    # One scale, that of all fabrics, for errors to compare.
    captures = CaptureSet(few, scale=scale, disc=training.disc)
    torch.manual_seed(seed)
    network = MapNet(**training.network(options.model))
    fit(network, captures, share=lambda step: step / config["steps"], batch=config["batch"],
        seed=seed)
    header = Header(Path(), {"rig": manifest["config"]["rig"]["name"], "targets": {
        "mean": scale.mean.tolist(), "std": scale.std.tolist()}})
    return {"fabrics": fabrics, "seed": seed, "captures": len(few), "dataset": dataset,
            **judge(network, header, unseen.maps, known=False)}


def picture(rows: list[dict], out: Path) -> None:
    """Errors against the number of fabrics, with their intervals."""
    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    axis = figure.subplots()
    for key, label in (("log_alpha", "log α"), ("beta_over_alpha", "β/α")):
        middle = np.array([row[key]["rmse"] for row in rows])
        low, high = np.transpose([row[key]["interval_95"] for row in rows])
        axis.errorbar([row["fabrics"] for row in rows], middle, [middle - low, high - middle],
                      fmt="o-" if len({row["seed"] for row in rows}) == 1 else "o", label=label)
    axis.set(xscale="log", xlabel="fabrics trained on",
             ylabel="error on unseen fabrics, in their deviations")
    axis.legend()
    write_figure(out, figure)


def main(argv: list[str]) -> None:
    """Train, print the table, and write the report."""
    config = parse_settings(DEFAULTS, argv)
    if min(config[key] for key in ("steps", "seeds", "workers")) < 1:
        raise InputError("steps, seeds and workers must be at least 1")
    training, _, _, manifest = open_captures(settings(config, config["workers"]))
    least = -(-config["batch"] // config["captures"])
    most = len(np.unique(training.maps.fabric))
    if not least <= min(config["fabrics"]) <= max(config["fabrics"]) <= most:
        raise InputError(f"fabrics=...: give numbers from {least}, which fill a batch, to {most}, "
                         "which are not held out")
    common = {"config": {key: config[key] for key in KEYS}, "dataset": manifest["hash"]}
    cases = {f"fabrics_{count}_{seed}": {**common, "fabrics": count, "seed": seed}
             for count in config["fabrics"] for seed in range(config["seeds"])}
    rows = list(run_cases(learn, cases, folder=Path(config["work"]), workers=config["workers"],
                          sources=ESTIMATOR).values())
    print(table(("fabrics", "seed", "log alpha", "beta/alpha"),
                [(row["fabrics"], row["seed"], f"{row['log_alpha']['rmse']:.3f}",
                  f"{row['beta_over_alpha']['rmse']:.3f}") for row in rows]))
    out = Path(config["out"])
    write_report(out, {"settings": config, "results": rows})
    picture(rows, out.with_suffix(".png"))


if __name__ == "__main__":
    run_command(main, usage=__doc__)
