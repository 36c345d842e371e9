"""Train the network on a dataset of simulated drapes.

    python train.py data=outputs/dataset out=outputs/train

After an interruption the same command resumes from the last finished epoch and gives the same
weights; with a larger ``epochs=`` it extends the training, and ``start=FILE`` begins another from
the weights of a checkpoint. Settings are in ``configs/train.yaml``;
override any of them by ``key=value``. ``model=views`` trains the network of Feng et al. 2022.
"""

import common.interrupt  # noqa: F401

# isort: split
import math
from pathlib import Path
from typing import Any

from common.command import command
from common.errors import InputError
from common.files import folder_named, require_folder
from drapenet.config import TrainConfig


def train(config: TrainConfig) -> Path:
    """Train, or resume, and return the checkpoint with the lowest validation loss."""
    out = folder_named(config.out)
    require_folder(out / "tensorboard")
    # Importing torch takes seconds; input errors come first.
    import torch
    from torch.utils.tensorboard import SummaryWriter
    from tqdm import tqdm

    from drapenet.network import training as steps
    from drapenet.network.checkpoint import read_header
    from drapenet.network.optimizer import Optimizer, multiplies_bfloat16
    from drapenet.network.weights import save_checkpoint, save_graphs

    device = steps.choose_device(config)
    training, unseen, datasets = steps.open_captures(config)
    checkpoint, state = out / "drapenet.safetensors", out / "state.pt"

    torch.manual_seed(config.seed)  # used for the initial weights only
    network = steps.initial_network(config, training).to(device)
    network.in_bfloat16 = config.bfloat16 and multiplies_bfloat16(device)
    optimizer = Optimizer(network, weight_decay=config.optim.weight_decay)

    # Must agree with an existing state for a resume.
    settings = {name: one for name, one in config.defining().items() if name != "epochs"}
    run = {"settings": settings, "datasets": datasets["sha256"],
           **{name: datasets[name] for name in ("maps", "start") if name in datasets}}
    record: dict[str, Any] = {"run": run, "cycles": [], "epochs_done": 0, "best_loss": None}
    if state.exists():
        record = steps.load_state(state, run=run, model=network, optimizer=optimizer)
    record["cycles"] = steps.cycles_of(record, config.epochs)

    count = len(training.turns) // config.optim.batch_size
    bar = tqdm(total=config.epochs * count, initial=record["epochs_done"] * count, unit="batch")
    with SummaryWriter(out / "tensorboard", purge_step=record["epochs_done"]) as board, bar:
        for epoch in range(record["epochs_done"], config.epochs):
            schedule = steps.schedule(training, config, cycles=record["cycles"], epoch=epoch,
                                      bar=bar)
            loss = steps.fit(network, schedule, optimizer=optimizer, optim=config.optim)
            finite = all(part.isfinite().all() for part in network.parameters())
            if not math.isfinite(loss) or not finite:
                raise InputError(f"the loss of epoch {epoch} is not finite; train again with a "
                                 "smaller optim.learning_rate and another out=")
            metrics = steps.validate(network, unseen, steps.Condition.of_inputs(config.inputs))
            steps.log_metrics(board, bar, metrics, epoch=epoch, train_loss=loss,
                              rate=optimizer.rate)
            if record["best_loss"] is None or metrics["loss"] < record["best_loss"]:
                record["best_loss"] = metrics["loss"]
                content = steps.describe(config, training, datasets, metrics, epoch=epoch,
                                         cycles=record["cycles"])
                save_checkpoint(checkpoint, model=network, half=config.half_precision,
                                description=content)
            # Last, so that an interruption before this line repeats the epoch and nothing else.
            record["epochs_done"] = epoch + 1
            steps.save_state(state, model=network, optimizer=optimizer, record=record)
    steps.calibrate(checkpoint, unseen, config)
    if config.graphs:
        save_graphs(read_header(checkpoint))
    return checkpoint


@command("train", TrainConfig)
def main(config: TrainConfig) -> None:
    """Train and print the paths of weights and log."""
    checkpoint = train(config)
    print(f"weights: {checkpoint}\nlog:     tensorboard --logdir {config.out}")


if __name__ == "__main__":
    main()
