"""Captures, optimisation, validation and state of ``train.py``.

Random numbers depend on (seed, epoch) only, so that weights, the optimiser's moments and the number
of finished epochs are the whole state: a resumed run gives the same weights.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from common.documents import differences, require_regular
from common.errors import InputError, one_line
from common.files import remove_partial, replacing
from common.provenance import release, sources_digest
from data.dataset.folder import finished_manifest, split_by_fabric
from data.fabrics.properties import ClothProperties
from data.render.setups import Setups
from drapenet.config import ModelConfig, OptimConfig, TrainConfig
from drapenet.network.checkpoint import MAX_WEIGHTS_BYTES
from drapenet.network.dataset import SOURCES, Maps, make_maps
from drapenet.network.model import Batch, DrapeNet, Facts
from drapenet.network.posterior import inside, ranks
from drapenet.network.targets import (
    CURL,
    MODULI,
    Symmetry,
    TargetScale,
    exchanged,
    stiffer_first,
    targets_of,
)
from drapenet.views.directions import AZIMUTH
from drapenet.views.outline import PERSPECTIVES, drape_coefficients
from sim.material import REFERENCE_DENSITY

if TYPE_CHECKING:
    from torch.utils.tensorboard import SummaryWriter
    from tqdm import tqdm

_VALIDATION_BATCH = 128
_APART = 1 << 40  # of numbers of fabrics and drapes of several datasets
_MEAN_SAMPLE = 1000  # captures used for mean and deviation of the distances
LEAST_HEIGHT = 0.5  # m, of the camera above the plate
PICTURE_OFFSET = 0.010  # of the outline's centre, in half sizes: 1.5 mm of a specimen of 300 mm
PICTURE_SCALE = 0.007  # of millimetres per pixel
PICTURE_NOISE = 0.008  # largest deviation of a radius, in half sizes
COEFFICIENT_ERROR = 0.010  # of drape coefficients as reported


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


@dataclass(frozen=True)
class Condition:
    """What the captures of a set are.

    Attributes:
        kinds: shares of depth captures, outlines, and numbers (drape coefficient and nodes) alone.
        sizes: shares of sets of 1, 2, ... captures, each of another drape.
        known: share of the sets in which the direction of the warp is stated.
        parallel, stated: shares of outlines under parallel light, and, of the others, of those
            whose camera's height is stated.
    """

    kinds: tuple[float, float, float] = (0.5, 0.42, 0.08)
    sizes: tuple[float, ...] = (0.5, 0.2, 0.1, 0.2)
    known: float = 0.7
    parallel: float = 0.3
    stated: float = 0.8


class CaptureSet:
    """Captures with the fabrics they show; ``scale`` of the targets is fitted if None."""

    def __init__(self, maps: Maps, *, scale: TargetScale | None = None) -> None:
        self.maps = maps
        # Neighbours of a fabric may have the same moduli by chance.
        _, first, which = np.unique(np.column_stack([maps.theta, maps.membrane]), axis=0,
                                    return_index=True, return_inverse=True)
        order = np.argsort(which.ravel(), kind="stable")
        self.members = np.split(order, np.cumsum(np.bincount(which.ravel()))[:-1])
        drapes = [len(np.unique(maps.index[rows])) for rows in self.members]
        self.turns = np.repeat(np.arange(len(self.members)), drapes)
        curl = np.array([maps.curl[rows].mean(axis=0) for rows in self.members])
        self.cloth = ClothProperties(maps.theta[first], curl, maps.membrane[first],
                                     maps.hysteresis[first])
        middle = np.exp(np.array([np.log(maps.size[rows]).mean() for rows in self.members]))
        self.scale = scale or TargetScale.fit(targets_of(self.cloth, middle))

    def __len__(self) -> int:
        return len(self.members)

    def network(self, config: ModelConfig) -> dict:
        """Arguments of :class:`drapenet.network.model.DrapeNet` for these captures."""
        sample = self.maps.distance[self.maps.views > 0][:_MEAN_SAMPLE].astype(np.float32)
        return {**asdict(config), "distance": round(float(sample.mean()), 4),
                "spread": round(float(sample.std()), 4),
                "rectangles": bool((self.maps.aspect != 1).any())}

    def batch(
        self, cloths: np.ndarray, condition: Condition, rng: np.random.Generator, *,
        symmetric: bool = True,
    ) -> tuple[Batch, Facts]:
        """A random set of captures of each of ``cloths`` (M,), and the facts of its captures;
        ``symmetric``: whether captures are turned at random."""
        maps, rows, group = self.maps, [], []
        sizes = rng.choice(len(condition.sizes), size=len(cloths), p=condition.sizes) + 1
        for number, (cloth, size) in enumerate(zip(cloths, sizes, strict=True)):
            candidates = rng.permutation(self.members[cloth])
            _, first = np.unique(maps.index[candidates], return_index=True)
            rows.append(candidates[rng.permutation(first)[:size]])
            group += [number] * len(rows[-1])
        rows, group = np.concatenate(rows), np.array(group)
        known = rng.random(len(cloths)) < condition.known
        flip = rng.choice([-1, 1], size=len(cloths))  # the face that is marked is arbitrary
        kind = np.array([rng.choice(3, p=condition.kinds) for _ in rows])
        kind[(maps.views[rows] == 0) & (kind == 0)] = 1
        deep, seen = kind == 0, kind == 1
        ratio, stated = _perspectives(maps.size[rows], condition, rng)
        outline = np.where(deep[:, None], maps.hem[rows].astype(np.float32), np.nan)
        outline[seen] = _photographed(maps.silhouettes[rows[seen]], ratio[seen], rng)
        radius = np.where((kind == 2)[:, None], maps.silhouettes[rows, 0], outline)
        coefficient = drape_coefficients(radius, maps.plate[rows], maps.disc[rows])
        coefficient += COEFFICIENT_ERROR * rng.standard_normal(len(rows)) * (kind == 2)
        counted = (kind == 2) & (rng.random(len(rows)) < 2 / 3)
        facts = Facts(
            size=maps.size[rows], plate=maps.plate[rows], disc=maps.disc[rows],
            aspect=maps.aspect[rows], face=maps.face[rows] * flip[group], known=known[group],
            views=np.where(deep, maps.views[rows], 0), perspective=np.where(
                deep, 0.0, np.where(seen & stated, ratio, np.nan)),
            coefficient=coefficient, nodes=np.where(counted, maps.folds[rows], np.nan),
            group=group)
        targets = targets_of(self.cloth.chosen(cloths), facts.sizes)
        targets[flip < 0, CURL] *= -1
        targets[~known] = stiffer_first(targets[~known])
        weft = symmetric & known & (rng.random(len(cloths)) < 0.5)  # along azimuth 0
        targets = exchanged(targets, weft)
        batch = Batch.of(
            np.where(deep[:, None, None], maps.distance[rows], np.float16(0)),
            np.where(deep[:, None, None], maps.weight[rows], np.uint8(0)), outline, facts,
            torch.from_numpy(self.scale.encode(targets)).float())
        if symmetric:
            batch = batch.turned(
                Symmetry.draw(known=known[group], disc=maps.disc[rows], exchanged=weft[group],
                              rng=rng))
        return batch, facts

    def epoch(
        self, *, seed: int, epoch: int, size: int, condition: Condition = Condition()
    ) -> Iterator[Batch]:
        """As many sets of each fabric and neighbour as it has drapes in random order, a function of
        (seed, epoch)."""
        rng = np.random.default_rng([seed, epoch])
        order = rng.permutation(self.turns)
        for start in range(0, len(order) - size + 1, size):
            yield self.batch(order[start : start + size], condition, rng)[0]


def _perspectives(
    size: np.ndarray, condition: Condition, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Sizes (N,) over the camera's height, and whether they are stated, with an error of 3 %."""
    parallel = rng.random(len(size)) < condition.parallel
    ratio = np.where(parallel, 0.0, size * rng.uniform(0, 1 / LEAST_HEIGHT, len(size)))
    return ratio, rng.random(len(size)) < condition.stated


def _photographed(
    silhouettes: np.ndarray, ratio: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Outlines (N, AZIMUTHS) of photographs, from exact ones (N, P, AZIMUTHS), in half sizes."""
    place = np.interp(ratio, PERSPECTIVES, np.arange(len(PERSPECTIVES)))
    low = np.minimum(place.astype(int), len(PERSPECTIVES) - 2)
    share = (place - low)[:, None]
    rows = np.arange(len(ratio))
    radius = silhouettes[rows, low] * (1 - share) + silhouettes[rows, low + 1] * share
    aside = rng.normal(0, PICTURE_OFFSET, (len(ratio), 2))
    radius = radius + aside[:, :1] * np.cos(AZIMUTH) + aside[:, 1:] * np.sin(AZIMUTH)
    radius *= 1 + rng.normal(0, PICTURE_SCALE, (len(ratio), 1))
    noise = rng.standard_normal(radius.shape)
    smooth = (np.roll(noise, 1, axis=1) + noise + np.roll(noise, -1, axis=1)) / math.sqrt(3)
    return radius + PICTURE_NOISE * rng.random((len(ratio), 1)) * smooth


def open_captures(config: TrainConfig) -> tuple[CaptureSet, CaptureSet, dict]:
    """Training and validation captures, of different fabrics, and a description of the datasets."""
    folders = config.data if isinstance(config.data, list) else [config.data]
    manifests, parts = [], []
    for number, folder in enumerate(folders):
        manifests.append(finished_manifest(Path(folder)))
        part = make_maps(folder, manifests[-1], Path(config.maps),
                         setups=Setups.from_config(config.setup), captures=config.captures,
                         outlines=config.outlines, seed=config.seed,
                         neighbours=config.neighbours, workers=config.workers)
        # Fabrics and drapes of different datasets are different.
        parts.append(replace(part, fabric=part.fabric + number * _APART,
                             index=part.index + number * _APART))
    maps = Maps.joined(parts)
    described = {"sha256": [manifest["hash"] for manifest in manifests],
                 "generation": [manifest["config"] for manifest in manifests],
                 "maps": sources_digest(*SOURCES)}
    shares = {"train": 1 - config.validation_fraction, "validation": config.validation_fraction}
    split = split_by_fabric(maps.fabric, fractions=shares)
    unseen = maps.chosen((split == "validation") & ~maps.moved)
    training = maps.chosen(split == "train")
    if config.fabrics:
        training = training.chosen(
            np.isin(training.fabric, np.unique(training.fabric)[: config.fabrics]))
    captures = CaptureSet(training) if len(training) else None
    if not captures or len(captures) < config.optim.batch_size or not len(unseen):
        raise InputError(f"{', '.join(folders)}: {len(captures or ())} fabrics and neighbours to "
                         f"train on and {len(unseen)} captures to validate with, but at least "
                         f"{config.optim.batch_size} (optim.batch_size) and 1 are needed: generate "
                         "more drapes, lower optim.batch_size or change "
                         f"validation_fraction={config.validation_fraction:g}")
    return captures, CaptureSet(unseen, scale=captures.scale), described


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
    steps = len(captures.turns) // size
    torch.manual_seed(np.random.default_rng([config.seed, epoch]).integers(1 << 62))  # of dropout
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
def validate(network: DrapeNet, captures: CaptureSet, condition: Condition = Condition()) -> dict:
    """Metrics of the network on sets of ``captures``, without symmetries, standardised."""
    network.eval()
    losses, errors, places = [], [], []
    rng = np.random.default_rng(0)
    for cloths in np.array_split(np.arange(len(captures)), -(-len(captures) // _VALIDATION_BATCH)):
        batch, _ = captures.batch(cloths, condition, rng, symmetric=False)
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
    config: TrainConfig, training: CaptureSet, datasets: dict, metrics: dict, epoch: int
) -> dict:
    """Description of a checkpoint's network, see :mod:`drapenet.network.checkpoint`."""
    theta = training.cloth.theta
    low, high = np.quantile(theta, [0.01, 0.99], axis=0)
    return {
        "reference_density_g_m2": REFERENCE_DENSITY * 1e3,
        "model": training.network(config.model),
        "targets": {name: part.tolist() for name, part in vars(training.scale).items()},
        # Of theta in the dataset's order: warp, bias, weft.
        "fabrics": {"low": low.tolist(), "high": high.tolist(),
                    "deviation": theta.std(axis=0).tolist()},
        "dataset": {
            **datasets,
            "drapes": len(np.unique(training.maps.index)),
            "fabrics": len(np.unique(training.maps.fabric)),
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
