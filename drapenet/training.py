"""The parts of training that ``train.py`` puts together.

Nothing random is drawn from a running generator: the order of an epoch, the noise and the view
order of a drape are functions of (seed, epoch, index). So the state at the end of an epoch is
the weights, Adam's moments and the number of epochs done, and a resumed run repeats exactly what
an uninterrupted one would have done.
"""

from dataclasses import asdict

import numpy as np
import torch
from torch.utils.data import DataLoader, Dataset
from torch.utils.tensorboard import SummaryWriter
from tqdm import tqdm

from common.errors import InputError
from common.provenance import release
from data.dataset import DrapeDataset
from data.fresh import FreshDataset, open_views
from data.sensor import sensor_from_config
from data.splits import SplitDataset
from data.view_order import ORDERS, reorder_axis, reorder_views
from drapenet.checkpoint import read_header
from drapenet.config import OptimConfig, TrainConfig
from drapenet.convention import TARGET_NAMES, TARGET_UNITS
from drapenet.metrics import regression_metrics
from drapenet.preprocess import InputFormat, prepare
from drapenet.targets import TargetScale, direction_vectors, to_stiff_soft
from sim.material import REFERENCE_DENSITY

Batch = tuple[torch.Tensor, torch.Tensor, torch.Tensor]
"""Views (N, 4, h, w), standardised targets (N, 6), stiff axes (N, 2)."""
CPU = torch.device("cpu")


def choose_device(config: TrainConfig) -> torch.device:
    """Set threads and reproducible kernels; return the device.

    Raises:
        InputError: CUDA is asked for and absent, or an unknown device.
    """
    if config.threads > 0:
        torch.set_num_threads(config.threads)
    torch.backends.cudnn.benchmark = False
    torch.backends.cudnn.deterministic = True
    if config.device == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    if config.device not in ("cpu", "cuda"):
        raise InputError(f"unknown device '{config.device}'; use auto, cpu or cuda")
    if config.device == "cuda" and not torch.cuda.is_available():
        raise InputError("no CUDA device is available; use device=cpu")
    return torch.device(config.device)


class PreparedViews(Dataset):
    """A dataset's items as batches: prepared views (N, 4, h, w), theta (N, 6), warps' angles (N,),
    turns (N, 4) of the table beyond its quarters.

    A DataLoader asks for a batch at once, and needs ``collate_fn=as_they_are``.
    """

    def __init__(self, drapes: SplitDataset, *, form: InputFormat) -> None:
        self.drapes, self.form = drapes, form
        # Other processes share neither a GPU nor what is ready in memory.
        self.in_process = isinstance(drapes, FreshDataset) and drapes.device != CPU

    def __len__(self) -> int:
        return len(self.drapes)

    def set_epoch(self, epoch: int) -> None:
        """Choose the epoch whose noise, orientations and view orders are drawn."""
        self.drapes.set_epoch(epoch)

    def __getitems__(self, items: list[int]) -> tuple[torch.Tensor, ...]:
        batch = self.drapes.batch(items)
        return (prepare(batch["views"], form=self.form), batch["theta"], batch["orientation"],
                batch["turns"])


class DrapeSet(PreparedViews):
    """Drapes as the network and the loss want them: each batch is a :data:`Batch`."""

    def __init__(self, drapes: SplitDataset, *, form: InputFormat, scale: TargetScale) -> None:
        super().__init__(drapes, form=form)
        self.scale = scale

    def __getitems__(self, items: list[int]) -> Batch:
        views, theta, psi, _ = super().__getitems__(items)
        return self.labelled(views, theta, psi)

    def labelled(self, views: torch.Tensor, theta: torch.Tensor, psi: torch.Tensor) -> Batch:
        """Join prepared views (N, 4, h, w) with the labels of theta (N, 6) and the warps' angles.
        """
        targets = self.scale.encode(to_stiff_soft(theta))
        return views, targets, direction_vectors(theta, psi)


class CachedSet(DrapeSet):
    """Drapes read, made noisy and shrunk once, and held in memory in half precision (0.1 mm).

    Doing that anew for every epoch costs a processor about half as much as the network does. Each
    item keeps one realisation of the noise here, and gets a new view order every epoch.

    Args:
        drapes: without augmentation.
        augment: draw view orders, from (``seed``, epoch, item).
        workers: processes that prepare.
    """

    def __init__(self, drapes: SplitDataset, *, form: InputFormat, scale: TargetScale,
                 augment: bool, seed: int, workers: int) -> None:
        super().__init__(drapes, form=form, scale=scale)
        self.augment, self.seed, self.epoch = augment, seed, 0
        shape = (len(drapes), 4, form.height, form.width)
        self.views = torch.empty(shape, dtype=torch.float16)
        loader = DataLoader(PreparedViews(drapes, form=form), batch_size=16,
                            num_workers=0 if self.in_process else workers, collate_fn=as_they_are)
        labels, filled = [], 0
        for views, *label in tqdm(loader, desc="preparing views", unit="batch", leave=False):
            self.views[filled : filled + len(views)] = views
            labels.append(label)
            filled += len(views)
        self.theta, self.psi, self.turns = (torch.cat(part) for part in zip(*labels, strict=True))
        self.in_process = True

    def set_epoch(self, epoch: int) -> None:
        self.epoch = epoch

    def __getitems__(self, items: list[int]) -> Batch:
        views, psi = self.views[items], self.psi[items]
        if self.augment:
            for k, item in enumerate(items):
                rng = np.random.default_rng([self.seed, self.epoch, item])
                first, mirror = ORDERS[rng.integers(len(ORDERS))]
                order = {"first": first, "mirror": mirror}
                views[k] = torch.from_numpy(reorder_views(views[k].numpy(), **order))
                # The view that becomes the first was off its quarter turn by this much.
                angle = psi[k].item() + self.turns[item, first].item()
                psi[k] = reorder_axis(angle, **order)
        return self.labelled(views.float(), self.theta[items], psi)


def as_they_are(batch: Batch) -> Batch:
    """In place of a DataLoader's own collation, where a dataset makes whole batches."""
    return batch


def open_splits(
    config: TrainConfig, *, device: torch.device = CPU
) -> tuple[DrapeSet, DrapeSet, TargetScale]:
    """Training and validation drapes of different fabrics, and the targets' scale.

    The scale is that of the initial weights, or else of the training set. Fresh views are rendered
    on ``device``.

    Raises:
        InputError: see :class:`data.dataset.DrapeDataset`; or too few drapes for one batch.
    """
    shares = {"train": 1 - config.validation_fraction, "validation": config.validation_fraction}
    options = {"fractions": shares, "noise": sensor_from_config(config.sensor),
               "seed": config.seed}
    many = {"orientations_per_epoch": config.orientations_per_epoch,
            "fabrics": config.fabrics, "drapes_each": config.drapes_each,
            "augment": config.views != "cached"}  # a cache has its own view orders
    if config.views == "stored":
        training = DrapeDataset(config.data, split="train", **many, **options)
    else:
        source = FreshDataset if config.views == "fresh" else open_views
        training = source(config.data, split="train", device=device, **many, **options)
    if len(training) < config.optim.batch_size:
        raise InputError(f"{config.data} has {len(training)} training samples an epoch, less "
                         f"than one batch of {config.optim.batch_size}; generate more drapes or "
                         "lower optim.batch_size")
    # Weights to go on from speak in the units they have learned.
    scale = (read_header(config.initial).scale if config.initial
             else TargetScale.fit(torch.from_numpy(training.theta)))
    common = {"form": config.model.form, "scale": scale}
    cached = {**common, "seed": config.seed, "workers": config.workers}
    # Validation sees the same pictures every epoch, so they are always worth keeping.
    validation = CachedSet(open_views(config.data, split="validation", device=device, **options),
                           augment=False, **cached)
    if config.views == "cached":
        return CachedSet(training, augment=True, **cached), validation, scale
    return DrapeSet(training, **common), validation, scale


def training_batches(drapes: DrapeSet, *, epoch: int, config: TrainConfig) -> DataLoader:
    """The batches of an epoch, in an order that depends on (seed, epoch) only.

    The last, incomplete batch is left out: its statistics would disturb the normalisation.
    """
    drapes.set_epoch(epoch)
    order = np.random.default_rng([config.seed, epoch]).permutation(len(drapes))
    return DataLoader(
        drapes,
        batch_size=config.optim.batch_size,
        sampler=order.tolist(),
        drop_last=True,
        num_workers=0 if drapes.in_process else config.workers,
        collate_fn=as_they_are,
    )


@torch.no_grad()
def validate(
    model: torch.nn.Module, drapes: DrapeSet, *, device: torch.device, optim: OptimConfig
) -> dict:
    """:func:`drapenet.metrics.regression_metrics` of the network on ``drapes``.

    Their ``loss`` is the one that is minimised on the training drapes.
    """
    model.eval()
    rows = [(model(views.to(device)).cpu(), targets, axes)
            for views, targets, axes in DataLoader(drapes, batch_size=128, collate_fn=as_they_are)]
    columns = (torch.cat(column) for column in zip(*rows, strict=True))
    return regression_metrics(*columns, direction_weight=optim.direction_weight,
                              ratio_weight=optim.ratio_weight)


def log_metrics(
    board: SummaryWriter, bar: tqdm, metrics: dict, *, epoch: int, train_loss: float, rate: float
) -> None:
    """Write an epoch's figures to TensorBoard and beside the progress bar."""
    board.add_scalar("loss/train", train_loss, epoch)
    board.add_scalar("loss/validation", metrics["loss"], epoch)
    board.add_scalar("learning_rate", rate, epoch)
    for name in ("rmse_log_alpha", "rmse_beta_over_alpha", "axis_error_deg"):
        if metrics[name] is not None:
            board.add_scalar(f"validation/{name}", metrics[name], epoch)
    for name, value in metrics["rmse"].items():
        board.add_scalar(f"validation_rmse/{name}", value, epoch)
    bar.set_postfix_str(f"epoch {epoch + 1}, loss {train_loss:.3f}, "
                        f"validation {metrics['loss']:.3f}, "
                        f"log alpha {metrics['rmse_log_alpha']:.3f}, "
                        f"beta/alpha {metrics['rmse_beta_over_alpha']:.3f}")


def describe(
    config: TrainConfig, training: DrapeSet, scale: TargetScale, metrics: dict, epoch: int
) -> dict:
    """The content of a checkpoint's JSON file, see :mod:`drapenet.checkpoint`."""
    drapes = training.drapes
    targets = to_stiff_soft(torch.from_numpy(drapes.theta))
    limits = torch.quantile(targets, torch.tensor([0.01, 0.99], dtype=targets.dtype), dim=0)
    return {
        "rig": drapes.manifest["config"]["rig"]["name"],
        "convention": "stiff/soft",
        "reference_density_g_m2": REFERENCE_DENSITY * 1e3,
        "model": {"backbone": config.model.backbone},
        "input": config.model.form.as_dict(),
        "targets": {
            "names": list(TARGET_NAMES),
            "units": list(TARGET_UNITS),
            "mean": scale.mean.tolist(),
            "std": scale.std.tolist(),
            # What 98 % of the training fabrics lie between: beyond it, estimates are guesses.
            "low": limits[0].tolist(),
            "high": limits[1].tolist(),
        },
        "dataset": {
            "sha256": drapes.hash,
            "training_drapes": drapes.drapes,
            "training_fabrics": len(set(drapes.fabric.tolist())),
            "generation": drapes.manifest["config"],
            # What the initial weights have seen: none of it counts as unseen.
            "earlier": read_header(config.initial).datasets if config.initial else [],
        },
        "validation": metrics,
        "epochs": epoch + 1,
        "config": asdict(config),
        "versions": {"project": release(), "torch": torch.__version__},
    }
