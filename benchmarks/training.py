"""Maps against stacked views, and how wide a network: ``python -m benchmarks.training``.

Networks are trained on the same captures of one dataset, four views each, for the same processor
time, and judged on captures of other fabrics. Those of :mod:`drapenet.network` see the map that all
views add to. A plain ResNet-18 sees the four pictures, shrunk to 80 x 60, as channels, and the
focal length as one more (:mod:`benchmarks.stacked_views`). Pictures show no yarns to count from:
its posterior is that of a disc (:mod:`drapenet.targets`), stiffer yarns first, their direction that
in the first view. So all are judged by stiff, bias and soft. All learn from captures turned and
mirrored.

Keys (``key=value``):

    data         dataset of drapes
    captures     of each drape
    widths       of the networks on maps
    cpu_seconds  of a training, one thread; each network is trained anew for each number
    batch        captures a step
    seed         of captures, order and first weights
    workers      processes that make captures
    work         folder of the captures
    out          the report, JSON
"""

from pathlib import Path

import numpy as np
import torch

from benchmarks.common import REPORTS, load_arrays, parse_settings, run_cases, table, write_report
from benchmarks.fitting import errors, fit, processor_seconds, stiff_first
from benchmarks.stacked_views import StackedSet, pictures, resnet, setups
from common.cli import run_command
from common.errors import InputError
from data.splits import finished_manifest, split_by_fabric
from drapenet.config import ModelConfig
from drapenet.maps import make_maps
from drapenet.network import MapNet
from drapenet.targets import TargetScale, targets_of
from drapenet.training import CaptureSet
from sim.scene import Rig

HELD_OUT = {"train": 0.85, "unseen": 0.15}  # of the fabrics
DEFAULTS = {"data": "outputs/dataset", "captures": 2, "widths": [16, 32, 64],
            "cpu_seconds": [300.0, 1200.0], "batch": 64, "seed": 0, "workers": 2,
            "work": "outputs/bench_training", "out": str(REPORTS / "training.json")}
Sets = tuple[CaptureSet, CaptureSet, TargetScale]
"""Captures to learn from, those of other fabrics, and the scale of both."""


def captured(config: dict) -> tuple[Sets, Sets]:
    """The same captures as maps and as stacked views."""
    root, work = Path(config["data"]), Path(config["work"])
    manifest = finished_manifest(root)
    rig = Rig.from_name(manifest["config"]["rig"]["name"])
    options = {"captures": config["captures"], "seed": config["seed"]}
    maps = make_maps(root, work, rig=rig, setups=setups(), workers=config["workers"], **options)
    cases = {Path(name).stem: {"shard": str(root / name), "rig": rig.name, **options,
                               "dataset": manifest["hash"]} for name in manifest["shards"]}
    run_cases(pictures, cases, folder=work, workers=config["workers"], sources=("data",))
    shards = [load_arrays(work, name) for name in cases]
    seen = [np.concatenate([part[k] for part in shards]) for k in ("views", "focal", "orientation")]
    train, unseen = (np.flatnonzero(split_by_fabric(maps.fabric, fractions=HELD_OUT) == name)
                     for name in HELD_OUT)
    if len(train) < config["batch"] or not len(unseen):
        raise InputError(f"{root} has {len(train)} captures to learn from and {len(unseen)} to "
                         "judge by; generate more drapes or lower batch")
    disc = rig.specimen == "disc"
    scale = TargetScale.fit(targets_of(maps.theta[train], maps.warp[train], disc=disc), disc=disc)
    stacked = StackedSet(maps.chosen(train), *(part[train] for part in seen))
    others = StackedSet(maps.chosen(unseen), *(part[unseen] for part in seen), scale=stacked.scale)
    return ((*(CaptureSet(maps.chosen(rows), scale=scale, disc=disc) for rows in (train, unseen)),
             scale), (stacked, others, stacked.scale))


def main(argv: list[str]) -> None:
    """Train and judge, print the table, write the report."""
    config = parse_settings(DEFAULTS, argv)
    torch.set_num_threads(1)  # what processor time is counted of
    on_maps, stacked = captured(config)
    networks = {f"map, {width} wide": (on_maps, lambda width=width: MapNet(
        **on_maps[0].network(ModelConfig(width=width)))) for width in config["widths"]}
    networks["four views, ResNet-18"] = stacked, resnet
    spread, rows = stiff_first(on_maps[0].maps.theta).std(axis=0), []
    for name, ((training, unseen, scale), make) in networks.items():
        for seconds in config["cpu_seconds"]:
            torch.manual_seed(config["seed"])
            network = make()
            steps = fit(network, training, share=processor_seconds(seconds),
                        batch=config["batch"], seed=config["seed"])
            gaps = np.square(errors(network, unseen, scale) / spread)
            rows.append({"network": name, "cpu_seconds": seconds, "steps": steps,
                         "log_alpha": float(np.sqrt(gaps[:, :3].mean())),
                         "beta_over_alpha": float(np.sqrt(gaps[:, 3:].mean()))})
            print(f"{name}, {seconds:g} s: {steps} steps", flush=True)
    print(table(["network", "CPU seconds", "steps", "log alpha", "beta/alpha"],
                [row.values() for row in rows]))
    write_report(Path(config["out"]), {"settings": config, "rows": rows,
                                       "captures": [len(s) for s in on_maps[:2]]})


if __name__ == "__main__":
    run_command(main, usage=__doc__)
