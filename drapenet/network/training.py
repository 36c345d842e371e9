"""Captures, optimisation, validation and state of ``train.py``.

Random numbers depend on (seed, epoch) only, so that weights, the optimiser's moments and the number
of finished epochs are the whole state: a resumed run gives the same weights.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from common.documents import differences, require_regular
from common.errors import InputError, one_line
from common.files import remove_partial, replacing
from common.provenance import release
from data.dataset.folder import finished_manifest, only_tester, split_by_fabric
from data.render.setups import Setups
from drapenet.config import ModelConfig, OptimConfig, TrainConfig
from drapenet.network.checkpoint import MAX_WEIGHTS_BYTES
from drapenet.network.dataset import Maps, make_maps
from drapenet.network.model import Batch, MapNet
from drapenet.network.posterior import inside, ranks
from drapenet.network.targets import MODULI, Symmetry, TargetScale, targets_of
from sim.material import REFERENCE_DENSITY

if TYPE_CHECKING:
    from torch.utils.tensorboard import SummaryWriter
    from tqdm import tqdm

_VALIDATION_BATCH = 128
_MEAN_SAMPLE = 1000  # captures used for mean and deviation of the distances


def choose_device(config: TrainConfig) -> torch.device:
    """Set threads and reproducible kernels; return the device."""
    if config.threads > 0:
        torch.set_num_threads(config.threads)
    torch.backends.cudnn.benchmark = False
    torch.backends.cudnn.deterministic = True
    if config.device == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    if config.device == "cuda" and not torch.cuda.is_available():
        raise InputError("no CUDA device is available; use device=cpu")
    return torch.device(config.device)


class CaptureSet:
    """Maps of captures with their targets, ``scale`` fitted to them if None; ``truth``: (N, T),
    not standardised.
    """

    def __init__(self, maps: Maps, *, disc: bool, scale: TargetScale | None = None) -> None:
        self.maps, self.disc = maps, disc
        self.truth = targets_of(maps.theta, maps.warp, disc=disc)
        self.scale = scale or TargetScale.fit(self.truth, disc=disc)
        self.targets = torch.from_numpy(self.scale.encode(self.truth)).float()

    def __len__(self) -> int:
        return len(self.maps)

    def network(self, config: ModelConfig) -> dict:
        """Arguments of :class:`drapenet.network.model.MapNet` for these captures."""
        sample = self.maps.distance[:: -(-len(self) // _MEAN_SAMPLE)].astype(np.float32)
        return {**asdict(config), "targets": self.targets.shape[1],
                "distance": round(float(sample.mean()), 4), "spread": round(float(sample.std()), 4)}

    def batch(
        self, rows: np.ndarray, *, revealed: np.ndarray, symmetry: Symmetry | None = None
    ) -> Batch:
        """Captures of ``rows`` (N,) after ``symmetry``, the membrane given if ``revealed`` (N,)."""
        maps, targets = self.maps, self.targets[rows]
        if symmetry is not None:
            targets = symmetry.of_targets(targets, disc=self.disc)
        membrane = np.where(revealed, maps.nuisance("membrane")[rows], np.nan)
        batch = Batch.of(maps.distance[rows], maps.weight[rows], maps.views[rows], membrane,
                         targets)
        return batch if symmetry is None else batch.turned(symmetry)

    def in_order(self, size: int, *, known: bool = False) -> Iterator[tuple[np.ndarray, Batch]]:
        """Rows and captures in order, without symmetries; ``known``: whether the membrane is given.
        """
        for rows in np.array_split(np.arange(len(self)), -(-len(self) // size)):
            yield rows, self.batch(rows, revealed=np.full(len(rows), known))

    def epoch(self, *, seed: int, epoch: int, size: int) -> Iterator[Batch]:
        """Full batches in random order with random symmetries, a function of (seed, epoch)."""
        rng = np.random.default_rng([seed, epoch])
        order = rng.permutation(len(self))
        for start in range(0, len(self) - size + 1, size):
            revealed = rng.integers(2, size=size) > 0
            symmetry = Symmetry.draw(size, disc=self.disc, rng=rng)
            yield self.batch(order[start : start + size], revealed=revealed, symmetry=symmetry)


def open_captures(config: TrainConfig) -> tuple[CaptureSet, CaptureSet, dict]:
    """Training and validation captures, of different fabrics, and the dataset's manifest."""
    manifest = finished_manifest(Path(config.data))
    disc = only_tester(config.data, manifest).specimen == "disc"
    maps = make_maps(config.data, manifest, Path(config.maps),
                     setups=Setups.from_config(config.setup), captures=config.captures,
                     seed=config.seed, neighbours=config.neighbours, workers=config.workers)
    shares = {"train": 1 - config.validation_fraction, "validation": config.validation_fraction}
    split = split_by_fabric(maps.fabric, fractions=shares)
    unseen = maps.chosen((split == "validation") & ~maps.moved)
    training = maps.chosen(split == "train")
    if config.fabrics:
        training = training.chosen(
            np.isin(training.fabric, np.unique(training.fabric)[: config.fabrics]))
    if len(training) < config.optim.batch_size or not len(unseen):
        raise InputError(f"{config.data} has {len(training)} captures to train on and "
                         f"{len(unseen)} to validate with, but needs at least "
                         f"{config.optim.batch_size} (optim.batch_size) and 1: generate more "
                         "drapes, lower optim.batch_size or change "
                         f"validation_fraction={config.validation_fraction:g}")
    captures = CaptureSet(training, disc=disc)
    return captures, CaptureSet(unseen, disc=disc, scale=captures.scale), manifest


def learning_rate(optim: OptimConfig, progress: float) -> float:
    """One-cycle cosine schedule; ``progress`` is the completed share of the training."""
    if progress < optim.warm_up:
        return optim.learning_rate * (0.04 + 0.96 * _half_cosine(1 - progress / optim.warm_up))
    return optim.learning_rate * _half_cosine((progress - optim.warm_up) / (1 - optim.warm_up))


def _half_cosine(x: float) -> float:
    return (1 + math.cos(math.pi * x)) / 2


def schedule(
    captures: CaptureSet, config: TrainConfig, *, epoch: int, bar: "tqdm"
) -> Iterator[tuple[float, Batch]]:
    """Steps of an epoch for :func:`fit`, with a progress bar over all batches."""
    size = config.optim.batch_size
    steps = len(captures) // size
    for step, batch in enumerate(captures.epoch(seed=config.seed, epoch=epoch, size=size)):
        yield (epoch + step / steps) / config.epochs, batch
        bar.update()


def fit(
    network: torch.nn.Module, schedule: Iterable[tuple[float, Any]], *,
    optimizer: torch.optim.Optimizer, optim: OptimConfig,
) -> float:
    """Train ``network`` by maximum likelihood; return the mean loss.

    ``schedule``: completed share of the training and :class:`Batch` of each step.
    """
    device = next(network.parameters()).device
    network.train()
    losses = []
    for progress, batch in schedule:
        for group in optimizer.param_groups:
            group["lr"] = learning_rate(optim, progress)
        loss = -batch.through(network).log_likelihood(batch.targets.to(device)).mean()
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), optim.clip)
        optimizer.step()
        losses.append(loss.detach())
    return torch.stack(losses).mean().item()


@torch.no_grad()
def validate(network: MapNet, captures: CaptureSet) -> dict:
    """Metrics of the network on ``captures`` without membrane and symmetries, standardised."""
    network.eval()
    losses, errors, places = [], [], []
    for _, batch in captures.in_order(_VALIDATION_BATCH):
        mixture = batch.through(network).cpu()
        losses.append(-mixture.log_likelihood(batch.targets))
        draws = mixture.sample(400, torch.Generator().manual_seed(0))
        errors.append((draws.mean(dim=0) - batch.targets)[:, :MODULI])
        places.append(ranks(draws.numpy(), batch.targets.numpy())[:, :MODULI])
    squares = torch.cat(errors).double().square()
    return {
        "loss": torch.cat(losses).double().mean().item(),
        "rmse_log_alpha": squares[:, :3].mean().sqrt().item(),
        "rmse_beta_over_alpha": squares[:, 3:].mean().sqrt().item(),
        "inside": inside(np.concatenate(places)),
        "samples": len(captures),
    }


def log_metrics(
    board: "SummaryWriter", bar: "tqdm", metrics: dict, *, epoch: int, train_loss: float,
    rate: float,
) -> None:
    """Write an epoch's metrics to TensorBoard and to the progress bar."""
    scalars = {"loss/train": train_loss, "loss/validation": metrics["loss"], "learning_rate": rate}
    scalars |= {f"validation/{name}": metrics[name]
                for name in ("rmse_log_alpha", "rmse_beta_over_alpha")}
    scalars |= {f"validation_inside/{level}": share for level, share in metrics["inside"].items()}
    for name, value in scalars.items():
        board.add_scalar(name, value, epoch)
    bar.set_postfix_str(f"epoch {epoch + 1}, loss {train_loss:.2f}, "
                        f"validation {metrics['loss']:.2f}, "
                        f"log alpha {metrics['rmse_log_alpha']:.3f}, "
                        f"beta/alpha {metrics['rmse_beta_over_alpha']:.3f}")


def describe(
    config: TrainConfig, training: CaptureSet, manifest: dict, metrics: dict, epoch: int
) -> dict:
    """Description of a checkpoint's network, see :mod:`drapenet.network.checkpoint`."""
    theta = training.maps.theta
    low, high = np.quantile(theta, [0.01, 0.99], axis=0)
    return {
        "rig": only_tester(config.data, manifest).name,
        "reference_density_g_m2": REFERENCE_DENSITY * 1e3,
        "model": training.network(config.model),
        "targets": {name: part.tolist() for name, part in vars(training.scale).items()},
        # Of theta in the dataset's order: warp, bias, weft.
        "fabrics": {"low": low.tolist(), "high": high.tolist(),
                    "deviation": theta.std(axis=0).tolist()},
        "dataset": {
            "sha256": manifest["hash"],
            "drapes": len(np.unique(training.maps.index)),
            "fabrics": len(np.unique(training.maps.fabric)),
            "generation": manifest["config"],
        },
        "validation": metrics,
        "epochs": epoch + 1,
        "config": config.defining(),
        "versions": {"project": release(), "torch": torch.__version__},
    }


def save_state(
    path: Path, *, model: torch.nn.Module, optimizer: torch.optim.Optimizer, record: dict[str, Any]
) -> None:
    """Write the state of a training run for an exact resume."""
    for pattern in ("*.safetensors", path.name):  # of runs killed during a write
        remove_partial(path.parent, pattern)
    with replacing(path) as file:
        torch.save({"record": record, "model": model.state_dict(),
                    "optimizer": optimizer.state_dict()}, file)


def load_state(
    path: Path, *, run: dict[str, Any], model: torch.nn.Module, optimizer: torch.optim.Optimizer
) -> dict[str, Any]:
    """Load the state of :func:`save_state`, of the same ``run``; return its record."""
    require_regular(path, MAX_WEIGHTS_BYTES, "training's state")
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
        record = state["record"]
        changed = differences(record["run"], run)
        if not changed:
            model.load_state_dict(state["model"])
            optimizer.load_state_dict(state["optimizer"])
    except Exception as error:  # damaged files raise any exception
        raise InputError(f"{path} cannot be resumed ({one_line(error)}); remove it to start again"
                         ) from None
    if changed:
        names = ", ".join(name.removeprefix("settings.") for name in changed)
        raise InputError(f"{path.parent} contains a training with other settings ({names}); choose "
                         "another out=, or remove it (epochs must be the same, because the "
                         "learning rate depends on them)")
    return record
