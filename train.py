"""Train the network on a dataset of simulated drapes.

    python train.py data=outputs/dataset out=outputs/train
    python train.py experiment=cpu_small        # without a GPU: small views, few epochs

Run the same command again after an interruption: it goes on from the last finished epoch and
ends with the same weights. Settings are in ``configs/train.yaml``; any of them is ``key=value``.
"""

import common.interrupt  # noqa: F401

# isort: split
import math
import os
from pathlib import Path
from typing import NoReturn

from common.ctrl_c import deferred

# Threads that wait for each other sleep: on a busy processor, and the workers that make views keep
# it busy, waiting in a loop makes a step up to 17 times as long. Read when torch is loaded.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

with deferred():
    import torch
from omegaconf import OmegaConf
from torch.utils.tensorboard import SummaryWriter
from tqdm import tqdm

from common.cli import run_command
from common.errors import InputError
from common.files import require_folder
from data.configs import compose_config
from drapenet.checkpoint import (
    load_model,
    load_state,
    read_header,
    save_checkpoint,
    save_state,
)
from drapenet.config import TrainConfig, learning_rate
from drapenet.losses import drape_loss
from drapenet.model import DrapeNet
from drapenet.training import (
    choose_device,
    describe,
    log_metrics,
    open_splits,
    training_batches,
    validate,
)


def train(config: TrainConfig) -> Path:
    """Train, or go on training, and return the checkpoint with the least validation loss."""
    config.check()
    out = Path(config.out)
    require_folder(out)
    device = choose_device(config)
    training, validation, scale = open_splits(config, device=device)
    checkpoint, state = out / "drapenet.safetensors", out / "state.safetensors"

    torch.manual_seed(config.seed)  # the first weights are the only thing drawn from it
    model = DrapeNet(backbone=config.model.backbone)
    if config.initial:
        model.load_state_dict(load_model(read_header(config.initial)).state_dict())
    model = model.to(device, memory_format=torch.channels_last)
    optimizer = torch.optim.Adam(model.parameters(), weight_decay=config.optim.weight_decay)

    # What must agree for an old state in this folder to be gone on from.
    run = {"settings": config.defining(), "dataset": training.drapes.hash}
    record = {"run": run, "epochs_done": 0, "best_loss": None}
    if state.exists():
        record = load_state(state, model=model, optimizer=optimizer)
        if record["run"] != run:
            raise InputError(f"{out} holds a training with other settings or another dataset; "
                             "choose another out= or remove it")

    steps = len(training_batches(training, epoch=0, config=config))
    bar = tqdm(total=config.epochs * steps, initial=record["epochs_done"] * steps, unit="batch")
    with SummaryWriter(out / "tensorboard", purge_step=record["epochs_done"]) as board, bar:
        for epoch in range(record["epochs_done"], config.epochs):
            model.train()
            losses = []
            for step, (views, targets, axes) in enumerate(
                training_batches(training, epoch=epoch, config=config)
            ):
                progress = (epoch + step / steps) / config.epochs
                rate = learning_rate(config.optim, epoch=epoch, progress=progress)
                for group in optimizer.param_groups:
                    group["lr"] = rate
                loss = drape_loss(model(views.to(device)), targets.to(device), axes.to(device),
                                  direction_weight=config.optim.direction_weight,
                                  ratio_weight=config.optim.ratio_weight)
                optimizer.zero_grad()
                loss.backward()
                optimizer.step()
                losses.append(loss.detach())
                bar.update()

            metrics = validate(model, validation, device=device, optim=config.optim)
            train_loss = torch.stack(losses).mean().item()
            if not math.isfinite(train_loss) or not math.isfinite(metrics["loss"]):
                raise InputError(f"the loss of epoch {epoch} is no finite number; try a smaller "
                                 "optim.learning_rate, and another out=")
            log_metrics(board, bar, metrics, epoch=epoch, train_loss=train_loss, rate=rate)
            if record["best_loss"] is None or metrics["loss"] < record["best_loss"]:
                record["best_loss"] = metrics["loss"]
                save_checkpoint(checkpoint, model=model, half=config.half_precision,
                                description=describe(config, training, scale, metrics, epoch))
            # Last, so that an interruption before this line repeats the epoch and nothing else.
            record["epochs_done"] = epoch + 1
            save_state(state, model=model, optimizer=optimizer, record=record)
    return checkpoint


def main(argv: list[str]) -> None:
    """The command line: words ``key=value`` over ``configs/train.yaml``."""
    config = OmegaConf.to_object(compose_config("train", argv, schema=TrainConfig))
    checkpoint = train(config)
    print(f"weights: {checkpoint}\nlog:     tensorboard --logdir {config.out}")


def entry() -> NoReturn:
    """Console script."""
    run_command(main, usage=__doc__)


if __name__ == "__main__":
    entry()
