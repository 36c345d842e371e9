"""Train the network on a dataset of simulated drapes.

    python train.py data=outputs/dataset out=outputs/train

After an interruption the same command resumes from the last finished epoch and gives the same
weights. Settings are in ``configs/train.yaml``; override any of them by ``key=value``.
"""

import common.interrupt  # noqa: F401

# isort: split
import math
from pathlib import Path

from common.command import command
from common.ctrl_c import deferred
from common.errors import InputError
from common.files import folder_named, require_folder
from drapenet.config import TrainConfig, learning_rate


def train(config: TrainConfig) -> Path:
    """Train, or resume, and return the checkpoint with the lowest validation loss."""
    out = folder_named(config.out)
    require_folder(out / "tensorboard")
    with deferred():  # importing torch takes seconds; input errors come first
        import torch
        from torch.utils.tensorboard import SummaryWriter
        from tqdm import tqdm

        from drapenet.network.checkpoint import load_state, save_checkpoint, save_state
        from drapenet.network.model import MapNet
        from drapenet.network.training import (
            choose_device,
            describe,
            log_metrics,
            open_captures,
            validate,
        )

    device = choose_device(config)
    training, unseen, manifest = open_captures(config)
    checkpoint, state = out / "drapenet.safetensors", out / "state.pt"

    torch.manual_seed(config.seed)  # used for the initial weights only
    network = MapNet(**training.network(config.model))
    network = network.to(device)
    optimizer = torch.optim.AdamW(network.parameters(), weight_decay=config.optim.weight_decay)

    # Must agree with an existing state for a resume.
    run = {"settings": config.defining(), "dataset": manifest["hash"]}
    record = {"run": run, "epochs_done": 0, "best_loss": None}
    if state.exists():
        record = load_state(state, run=run, model=network, optimizer=optimizer)

    size = config.optim.batch_size
    steps = len(training) // size
    bar = tqdm(total=config.epochs * steps, initial=record["epochs_done"] * steps, unit="batch")
    with SummaryWriter(out / "tensorboard", purge_step=record["epochs_done"]) as board, bar:
        for epoch in range(record["epochs_done"], config.epochs):
            network.train()
            losses = []
            batches = training.epoch(seed=config.seed, epoch=epoch, size=size)
            for step, batch in enumerate(batches):
                rate = learning_rate(config.optim, (epoch + step / steps) / config.epochs)
                for group in optimizer.param_groups:
                    group["lr"] = rate
                posterior = batch.through(network)
                loss = -posterior.log_likelihood(batch.targets.to(device)).mean()
                optimizer.zero_grad()
                loss.backward()
                torch.nn.utils.clip_grad_norm_(network.parameters(), config.optim.clip)
                optimizer.step()
                losses.append(loss.detach())
                bar.update()

            train_loss = torch.stack(losses).mean().item()
            finite = all(part.isfinite().all() for part in network.parameters())
            if not math.isfinite(train_loss) or not finite:
                raise InputError(f"the loss of epoch {epoch} is not finite; train again with a "
                                 "smaller optim.learning_rate and another out=")
            metrics = validate(network, unseen)
            log_metrics(board, bar, metrics, epoch=epoch, train_loss=train_loss, rate=rate)
            if record["best_loss"] is None or metrics["loss"] < record["best_loss"]:
                record["best_loss"] = metrics["loss"]
                content = describe(config, training, manifest, metrics, epoch)
                save_checkpoint(checkpoint, model=network, half=config.half_precision,
                                description=content)
            # Last, so that an interruption before this line repeats the epoch and nothing else.
            record["epochs_done"] = epoch + 1
            save_state(state, model=network, optimizer=optimizer, record=record)
    return checkpoint


@command("train", TrainConfig)
def main(config: TrainConfig) -> None:
    """Train and print the paths of weights and log."""
    checkpoint = train(config)
    print(f"weights: {checkpoint}\nlog:     tensorboard --logdir {config.out}")


if __name__ == "__main__":
    main()
