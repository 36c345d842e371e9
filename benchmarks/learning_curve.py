"""Should the next dataset buy fabrics or starts? ``python -m benchmarks.learning_curve``.

Trains the network on parts of two datasets: on more and more fabrics with one drape each, and on
one number of fabrics with more and more drapes each. Every training takes the same steps, from
random weights and as many views an epoch: of fewer drapes, each is shown in more orientations. All
are judged on the same captures of other fabrics. Finished trainings are not repeated, an
interrupted one is gone on with.

Keys (``key=value``):

    data      dataset of one drape a fabric
    fabrics   numbers of its fabrics to train on
    several   dataset of several drapes a fabric; empty: leave that curve out
    starts    numbers of drapes of each fabric
    unseen    dataset of other fabrics, with stored views or without
    views     sets of four views an epoch
    epochs    of each training
    seeds     trainings of each size, with seeds 0, 1, ...
    workers   trainings at a time, each in a process of one thread
    work      folder of the trainings and their results
    out       the report, JSON; the picture lies beside it
"""

import os
from pathlib import Path

os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # as train.py does, before torch is loaded

import numpy as np
import torch
from matplotlib.figure import Figure

import train
from benchmarks.common import (
    ESTIMATOR,
    REPORTS,
    parse_settings,
    run_cases,
    table,
    write_figure,
    write_report,
)
from common.cli import run_command
from common.errors import InputError
from data.fresh import open_views
from data.sensor import load_sensor
from data.splits import SplitDataset, finished_manifest
from drapenet.checkpoint import read_header
from drapenet.convention import LINEAR, RATIO, TARGET_NAMES
from drapenet.evaluate import evaluate
from drapenet.targets import to_stiff_soft

DEFAULTS = {
    "data": "outputs/dataset",
    "fabrics": [225, 450, 900, 1800],
    "several": "outputs/dataset_starts",
    "starts": [1, 2, 4, 8],
    "unseen": "outputs/evaluate/dataset",
    "views": 14400,
    "epochs": 4,
    "seeds": 1,
    "workers": 2,
    "work": "outputs/learning_curve",
    "out": str(REPORTS / "learning_curve.json"),
}
HELD_OUT = 0.12  # of the fabrics, for the choice of the epoch


def plan(config: dict) -> list[dict]:
    """The trainings: dataset, number of fabrics, drapes of each, seed."""
    sizes = [{"curve": "fabrics", "data": config["data"], "fabrics": count, "drapes_each": 1}
             for count in config["fabrics"]]
    if config["several"]:
        several = finished_manifest(config["several"])
        # Few enough that the held-out share, which is chosen at random, leaves as many.
        count = int(several["fabrics"] * (1 - HELD_OUT) * 0.95)
        sizes += [{"curve": "starts", "data": config["several"], "fabrics": count,
                   "drapes_each": each} for each in config["starts"]]
    return [size | {"seed": seed} for size in sizes for seed in range(config["seeds"])]


def learn(
    *, curve: str, data: str, fabrics: int, drapes_each: int, seed: int, out: str, unseen: str,
    views: int, epochs: int, hashes: list[str],
) -> dict:
    """Train on a part of a dataset; the errors on unseen fabrics, in their standard deviations.

    ``hashes`` say what the folders ``data`` and ``unseen`` hold.
    """
    drapes = fabrics * drapes_each
    train.main([
        "experiment=cpu_small", f"data={data}", f"out={out}", f"seed={seed}",
        f"fabrics={fabrics}", f"drapes_each={drapes_each}", "views=cached",
        f"orientations_per_epoch={max(1, views // drapes)}", f"epochs={epochs}",
        f"validation_fraction={HELD_OUT}", "threads=1",
    ])
    others = open_unseen(unseen)
    header = read_header(Path(out) / "drapenet")
    spread = to_stiff_soft(torch.from_numpy(others.theta)).std(dim=0).numpy()
    rmse = evaluate(header, others)["network"]["rmse"]
    share = np.array([rmse[name] for name in TARGET_NAMES]) * header.scale.std.numpy() / spread
    return {"curve": curve, "fabrics": fabrics, "drapes_each": drapes_each, "seed": seed,
            "drapes": drapes, "hashes": hashes} | {
        name: float(np.sqrt(np.mean(share[part] ** 2)))
        for name, part in (("log_alpha", LINEAR), ("beta_over_alpha", RATIO))}


def open_unseen(folder: str) -> SplitDataset:
    """Two captures of each drape of a dataset."""
    return open_views(folder, noise=load_sensor("smooth"), orientations_per_epoch=2)


def picture(results: list[dict], out: Path) -> None:
    """Error against the number of drapes, both curves."""
    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    axes = figure.subplots()
    for curve, label in (("fabrics", "more fabrics, one drape each"),
                         ("starts", "more drapes of the same fabrics")):
        points = [(row["drapes"], row["log_alpha"]) for row in results if row["curve"] == curve]
        if points:
            axes.semilogx(*np.array(points).T, "o-", label=label)
    axes.set_xlabel("drapes")
    axes.set_ylabel("error of log α on unseen fabrics, in their deviations")
    axes.legend()
    write_figure(out, figure)


def main(argv: list[str]) -> None:
    """Train, print the table, and write the report."""
    config = parse_settings(DEFAULTS, argv)
    for key in ("views", "epochs", "seeds", "workers"):
        if config[key] < 1:
            raise InputError(f"{key}={config[key]} must be at least 1")
    open_unseen(config["unseen"])  # to be told of mistakes before the first training
    work, cases = Path(config["work"]), {}
    for case in plan(config):
        name = "{curve}_{fabrics}x{drapes_each}_{seed}".format(**case)
        hashes = [finished_manifest(folder)["hash"] for folder in (case["data"], config["unseen"])]
        cases[name] = case | {key: config[key] for key in ("unseen", "views", "epochs")} | {
            "hashes": hashes,
            "out": str(work / name)}
    results = list(run_cases(learn, cases, folder=work, workers=config["workers"],
                             sources=ESTIMATOR).values())
    print(table(
        ("fabrics", "drapes of each", "seed", "log alpha", "beta/alpha"),
        [(row["fabrics"], row["drapes_each"], row["seed"], f"{row['log_alpha']:.3f}",
          f"{row['beta_over_alpha']:.3f}") for row in results]))
    out = Path(config["out"])
    write_report(out, {"settings": config, "results": results})
    picture(results, out.with_suffix(".png"))


if __name__ == "__main__":
    run_command(main, usage=__doc__)
