"""Views for training, fresh against stored: ``python -m benchmarks.training [key=value ...]``.

What does a batch of views cost beside the network's own step, for views rendered anew, stored and
cached? Timings are taken in turn, several times, and the shortest reported, for other programs may
disturb. With ``compare`` the network is also trained from stored and from fresh views of the same
drapes, and judged on the same pictures of others; ``drapes=832 compare=2`` takes hours. Interrupted
trainings are gone on with.

Keys (``key=value``):

    data          folder of the drapes; simulated on the first run
    drapes        number of drapes, each of its own fabric
    edge_mm       edges at the rim of a drape's mesh
    orientations  stored sets of four views of each drape
    batch         drapes a step
    threads       of the network; as many processes are taken to make its views
    repeats       timings of each
    compare       pairs of trainings, with seeds 0, 1, ...
    epochs        of each training
    an_epoch      sets of four views of each drape in an epoch
    workers       processes that simulate, and that make views in the trainings
    work          folder of the trainings
    out           the report, JSON; the picture of the trainings lies beside it
"""

import os
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # as train.py does, before torch is loaded

import matplotlib
import numpy as np
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

import train
from benchmarks.common import REPORTS, parse_settings, table, write_figure, write_report
from benchmarks.render import shortest, torch_threads
from common.cli import run_command
from common.errors import InputError
from data.configs import compose_config
from data.dataset import DrapeDataset
from data.fresh import FreshDataset
from data.generate import generate_dataset
from data.options import Options, config_from_options
from data.sensor import load_sensor
from drapenet.checkpoint import read_header
from drapenet.config import ModelConfig
from drapenet.losses import drape_loss
from drapenet.model import DrapeNet
from drapenet.preprocess import InputFormat, prepare
from drapenet.targets import TargetScale
from drapenet.training import CachedSet, DrapeSet

matplotlib.use("Agg")
import matplotlib.pyplot as plt

DEFAULTS = {
    "data": "outputs/bench_training",
    "drapes": 64,
    "edge_mm": 4.0,
    "orientations": 12,
    "batch": 64,
    "threads": 2,
    "repeats": 5,
    "compare": 0,
    "epochs": 18,
    "an_epoch": 4,
    "workers": 2,
    "work": "outputs/bench_training_runs",
    "out": str(REPORTS / "training.json"),
}
FORMS = {
    "80x64 of the middle 160x128": ModelConfig(input_width=80, input_height=64,
                                               crop_width=160, crop_height=128).form,
    "120x90 of the whole": ModelConfig().form,
}
FIGURES = ("loss", "rmse_log_alpha", "rmse_beta_over_alpha", "axis_error_deg")


def make_drapes(config: dict) -> Path:
    """The folder of the drapes, which are simulated where they are missing."""
    words = [f"drapes={config['drapes']}", f"edge_mm={config['edge_mm']}", "seed=6",
             "prior=gaussian", "dataset=one_start",
             f"dataset.orientations={config['orientations']}"]
    options = compose_config("generate", words, schema=Options)
    root = Path(config["data"])
    generate_dataset(config_from_options(options), root, workers=config["workers"])
    return root


def network_step(batch: tuple[torch.Tensor, ...]) -> Callable[[], None]:
    """One step of training on a batch."""
    model = DrapeNet().to(memory_format=torch.channels_last)
    optimizer = torch.optim.Adam(model.parameters())
    views, targets, axes = batch

    def step() -> None:
        loss = drape_loss(model(views), targets, axes, direction_weight=0.5)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()

    return step


def speed(root: Path, form: InputFormat, config: dict) -> dict[str, float]:
    """Milliseconds a batch of each way to make it, on one thread, and of the network's step."""
    options = {"noise": load_sensor(), "orientations_per_epoch": config["orientations"]}
    stored = DrapeDataset(root, augment=True, **options)
    fresh = FreshDataset(root, augment=True, **options)
    plain = FreshDataset(root, augment=True, orientations_per_epoch=config["orientations"])
    common = {"form": form, "scale": TargetScale.fit(torch.from_numpy(stored.theta))}
    cached = CachedSet(DrapeDataset(root, noise=options["noise"]), augment=True, seed=0,
                       workers=0, **common)
    items = np.random.default_rng(0).permutation(len(stored))[: config["batch"]].tolist()
    of_cache = [item // config["orientations"] for item in items]
    fresh_set, stored_set = DrapeSet(fresh, **common), DrapeSet(stored, **common)
    step = network_step(fresh_set.__getitems__(items))
    views = fresh.batch(items)["views"]

    def on(threads: int, function: Callable[[], object]) -> Callable[[], None]:
        def work() -> None:
            with torch_threads(threads):
                function()
        return work

    seconds = shortest({
        f"network, {config['threads']} threads": on(config["threads"], step),
        "network": on(1, step),
        "fresh": on(1, lambda: fresh_set.__getitems__(items)),
        "of it, rendering": on(1, lambda: plain.batch(items)),
        "of it, shrinking": on(1, lambda: prepare(views, form=form)),
        "stored": on(1, lambda: stored_set.__getitems__(items)),
        "cached": on(1, lambda: cached.__getitems__(of_cache)),
    }, config["repeats"])
    return {name: 1e3 * value for name, value in seconds.items()}


def compare(root: Path, config: dict) -> dict[str, list[dict]]:
    """Validation figures of both trainings of each seed, and their losses by epoch."""
    runs: dict[str, list[dict]] = {"stored": [], "fresh": []}
    for seed in range(config["compare"]):
        for views, results in runs.items():
            out = Path(config["work"]) / f"{views}_{seed}"
            train.main([
                "experiment=cpu_small", f"data={root}", f"out={out}", f"seed={seed}",
                f"views={views}", f"orientations_per_epoch={config['an_epoch']}",
                f"epochs={config['epochs']}", f"optim.batch_size={config['batch']}",
                f"threads={config['threads']}", f"workers={config['workers']}",
            ])
            best = read_header(out / "drapenet").content["validation"]
            log = EventAccumulator(str(out / "tensorboard"))
            log.Reload()
            results.append({name: best[name] for name in FIGURES} | {
                name: [event.value for event in log.Scalars(f"loss/{name}")]
                for name in ("train", "validation")})
    return runs


def picture(runs: dict[str, list[dict]], out: Path) -> None:
    """Losses by epoch: training thin, validation thick."""
    figure, axes = plt.subplots(figsize=(6.4, 4.0), layout="constrained")
    for k, (views, results) in enumerate(runs.items()):
        for seed, result in enumerate(results):
            epochs = 1 + np.arange(len(result["validation"]))
            axes.plot(epochs, result["validation"], color=f"C{k}", linewidth=2,
                      label=None if seed else f"{views} views, validation")
            axes.plot(epochs, result["train"], color=f"C{k}", linewidth=0.8, linestyle="--",
                      label=None if seed else f"{views} views, training")
    axes.set_xlabel("epoch")
    axes.set_ylabel("loss")
    axes.legend()
    write_figure(out, figure)
    plt.close(figure)


def main(argv: list[str]) -> None:
    """Run, print the tables, and write the report."""
    config = parse_settings(DEFAULTS, argv)
    for key, least in (("drapes", 8), ("orientations", 1), ("batch", 2), ("threads", 1),
                       ("repeats", 1), ("compare", 0), ("workers", 1)):
        if config[key] < least:
            raise InputError(f"{key}={config[key]} must be at least {least}")
    root = make_drapes(config)
    report = {"settings": {k: v for k, v in config.items()
                           if k not in ("out", "data", "work", "workers")}}
    report["milliseconds"] = {name: speed(root, form, config) for name, form in FORMS.items()}
    print(f"milliseconds a batch of {config['batch']}, one thread where nothing else is said")
    columns = list(report["milliseconds"].values())
    print(table(["", *FORMS], [[name, *(round(column[name]) for column in columns)]
                               for name in columns[0]]))
    report["fresh_over_network"] = {name: column["fresh"] / column["network"]
                                    for name, column in report["milliseconds"].items()}
    print("fresh batch over network's step, one thread each: " + ", ".join(
        f"{ratio:.2f} ({name})" for name, ratio in report["fresh_over_network"].items()))
    out = Path(config["out"])
    if config["compare"]:
        runs = compare(root, config)
        report["trainings"] = runs
        print(f"\nbest validation figures of {config['compare']} trainings each, "
              f"{config['an_epoch'] * config['epochs']} sets of views a drape")
        print(table(["views", "seed", *FIGURES], [
            [views, seed, *(result[name] for name in FIGURES)]
            for views, results in runs.items() for seed, result in enumerate(results)]))
        losses = {views: np.mean([result["loss"] for result in results])
                  for views, results in runs.items()}
        report["fresh_loss_over_stored"] = losses["fresh"] / losses["stored"]
        print(f"validation loss, fresh over stored: {report['fresh_loss_over_stored']:.3f}")
        picture(runs, out.with_suffix(".png"))
    write_report(out, report)


if __name__ == "__main__":
    run_command(main, usage=__doc__)
