"""Optimisation, validation and state of ``train.py``.

Random numbers depend on (seed, epoch) only, so that weights, the optimiser's moments, the number of
finished epochs and the ends of the learning rate's cycles are the whole state: a resumed run gives
the same weights.
"""

import math
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from common.documents import differences, require_regular
from common.errors import InputError, one_line
from common.files import remove_partial, replacing
from common.graphs import MAX_WEIGHTS_BYTES
from common.provenance import release
from data.dataset.folder import finished_manifest, split_by_fabric
from data.fabrics.prior import prior_from_content
from data.fabrics.prior.even import spread_of
from data.render.setups import Setups
from data.rigs import named_tester
from drapenet.config import OptimConfig, TrainConfig
from drapenet.network.calibration import Calibration, seen_of
from drapenet.network.captures import CaptureSet, Condition, readable
from drapenet.network.checkpoint import read_description, read_header
from drapenet.network.dataset import VERSION, Maps, make_maps
from drapenet.network.inputs import Batch
from drapenet.network.mixture import Mixture
from drapenet.network.model import Network, make_network
from drapenet.network.optimizer import Optimizer
from drapenet.network.posterior import inside, ranks
from drapenet.network.predict import DRAWS, sample_targets
from drapenet.network.targets import MODULI
from drapenet.network.weights import Loaded, load_model, save_checkpoint
from sim.material import FIRST, REFERENCE_DENSITY, SECOND

if TYPE_CHECKING:
    from torch.utils.tensorboard import SummaryWriter
    from tqdm import tqdm

_VALIDATION_BATCH = 128
_SCALES = np.geomspace(1.0, 3.0, 12).tolist()
_CALIBRATED = 16  # sets for each fabric, on average
_DRAWN = 500  # samples of each of their posteriors
LEAST_CALIBRATING = 20  # fabrics
_APART = 1 << 40  # of numbers of fabrics and drapes of several datasets


def choose_device(config: TrainConfig) -> torch.device:
    """Set threads and reproducible kernels; return the device."""
    if config.threads:
        torch.set_num_threads(config.threads)
    torch.backends.cudnn.benchmark = False
    torch.backends.cudnn.deterministic = True
    if config.device == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    if config.device == "cuda" and not torch.cuda.is_available():
        raise InputError("no CUDA device is available; use device=cpu")
    return torch.device(config.device)


def open_captures(config: TrainConfig) -> tuple[CaptureSet, CaptureSet, dict]:
    """Training and validation captures, of different fabrics, and a description of the datasets."""
    if config.model.backbone and config.inputs != ["depth"]:
        raise InputError(f"inputs=[{','.join(config.inputs)}]: a network with a backbone reads "
                         "depth views alone; give inputs=[depth], or model=map")
    folders = config.data if isinstance(config.data, list) else [config.data]
    start = read_header(config.start) if config.start else None
    tester = named_tester(config.tester) if config.tester else None
    manifests, parts = [], []
    for number, folder in enumerate(folders):
        manifests.append(finished_manifest(Path(folder)))
        part = make_maps(folder, manifests[-1], Path(config.maps),
                         setups=Setups.from_config(config.setup), captures=config.captures,
                         outlines=config.outlines * (config.inputs != ["depth"]),
                         seed=config.seed, neighbours=config.neighbours, workers=config.workers,
                         pictures=config.model.backbone is not None, tester=tester)
        if tester:
            manifests[-1]["config"]["sampling"] |= {
                "testers": [tester.name], "random_testers": 0.0, "rectangles": 0.0}
        # Fabrics and drapes of different datasets are different.
        parts.append(replace(part, fabric=part.fabric + number * _APART,
                             index=part.index + number * _APART))
    maps = Maps.joined(parts)
    described: dict[str, Any] = {
        "sha256": [manifest["hash"] for manifest in manifests],
        "generation": [manifest["config"] for manifest in manifests], "maps": VERSION}
    if start:  # whose fabrics the weights have learned, too
        described["start"] = start.sha256
        described["sha256"] = [*start.dataset.sha256, *described["sha256"]]
        described["generation"] = [*start.dataset.generation, *described["generation"]]
    shares = {"train": 1 - config.validation_fraction, "validation": config.validation_fraction}
    split = split_by_fabric(maps.fabric, fractions=shares)
    usable = readable(maps, config.inputs)
    unseen = maps.chosen(usable & (split == "validation") & ~maps.moved)
    learned = usable & (split == "train")
    if config.fabrics:
        learned &= np.isin(maps.fabric, np.unique(maps.fabric[learned])[:config.fabrics])
    training = maps.chosen(learned)
    captures = CaptureSet(training, scale=start.scale if start else None) if len(
        training) else None
    if not captures or len(captures) < config.optim.batch_size or not len(unseen):
        raise InputError(f"{', '.join(folders)}: {len(captures or ())} fabrics and neighbours to "
                         f"train on and {len(unseen)} captures to validate with, but at least "
                         f"{config.optim.batch_size} (optim.batch_size) and 1 are needed: generate "
                         "more drapes, lower optim.batch_size or change "
                         f"validation_fraction={config.validation_fraction:g}")
    return captures, CaptureSet(unseen, scale=captures.scale), described


def initial_network(config: TrainConfig, captures: CaptureSet) -> Network:
    """The network that the training begins with: with random weights, or those of ``start``, whose
    scale the ``captures`` have; InputError if that has other layers than the settings ask for."""
    asked = arguments(config, captures)
    if not config.start:
        return make_network(**asked)
    header = read_header(config.start)
    found = header.model.model_dump()
    for name in sorted({"backbone", "output", "width", "components", "rectangles", "expected"}):
        if found[name] != asked[name]:
            raise InputError(f"start={config.start} has a network of {name}={found[name]}, the "
                             f"settings and drapes ask for {asked[name]}; start from another "
                             "checkpoint, or from none")
    return load_model(header)


def arguments(config: TrainConfig, captures: CaptureSet) -> dict:
    """Of :func:`drapenet.network.model.make_network`; weights of ``start`` keep the unit in which
    they have learned distances."""
    asked = captures.network(config.model)
    if not config.start:
        return asked
    found = read_header(config.start).model
    return asked | {"distance": found.distance, "spread": found.spread}


def learning_rate(optim: OptimConfig, progress: float) -> float:
    """A cosine cycle: rises and falls to zero; ``progress`` is the completed share of the cycle."""
    if progress < optim.warm_up:
        return optim.learning_rate * (0.04 + 0.96 * _half_cosine(1 - progress / optim.warm_up))
    return optim.learning_rate * _half_cosine((progress - optim.warm_up) / (1 - optim.warm_up))


def _half_cosine(x: float) -> float:
    return (1 + math.cos(math.pi * x)) / 2


def cycles_of(record: dict[str, Any], epochs: int) -> list[int]:
    """Ends of the cycles of a training to ``epochs``: those recorded, and a further one if there
    are more epochs; InputError if there are fewer."""
    cycles = record["cycles"]
    if cycles and epochs < cycles[-1]:
        raise InputError(f"epochs={epochs}: this training is one of {cycles[-1]}; give as many, "
                         "or more to extend it, or choose another out=")
    return cycles if cycles and epochs == cycles[-1] else [*cycles, epochs]


def schedule(
    captures: CaptureSet, config: TrainConfig, *, cycles: list[int], epoch: int, bar: "tqdm"
) -> Iterator[tuple[float, Batch]]:
    """Steps of an epoch for :func:`fit`, with a progress bar over all batches."""
    size = config.optim.batch_size
    start, end = next((start, end) for start, end in pairwise([0, *cycles]) if epoch < end)
    steps = len(captures.turns) // size
    torch.manual_seed(np.random.default_rng([config.seed, epoch]).integers(1 << 62))  # of dropout
    for step, batch in enumerate(_ahead(captures.epoch(
            seed=config.seed, epoch=epoch, size=size,
            condition=Condition.of_inputs(config.inputs)))):
        yield (epoch - start + step / steps) / (end - start), batch
        bar.update()


def _ahead(batches: Iterator[Batch]) -> Iterator[Batch]:
    """The ``batches``, the next of which is made while one is used."""
    with ThreadPoolExecutor(1) as pool:
        coming = pool.submit(next, batches, None)
        while (batch := coming.result()) is not None:
            coming = pool.submit(next, batches, None)
            yield batch


def fit(
    network: Network, schedule: Iterable[tuple[float, Batch]], *,
    optimizer: Optimizer, optim: OptimConfig,
) -> float:
    """Train ``network`` by maximum likelihood; return the mean loss of its posterior.

    ``schedule``: completed share of the cycle and :class:`Batch` of each step.
    """
    network.train()
    losses = []
    for progress, batch in schedule:
        targets, = network.tensors(batch, "targets")
        loss = -network.answer(batch).log_likelihood(targets).mean()
        (loss - network.log_density_of_shapes(batch).mean()).backward()
        for part in network.separate_parts():
            torch.nn.utils.clip_grad_norm_(part, optim.clip)
        optimizer.step(learning_rate(optim, progress))
        losses.append(loss.detach())
    return torch.stack(losses).mean().item()


@torch.no_grad()
def validate(network: Network, captures: CaptureSet, condition: Condition) -> dict:
    """Metrics of the network on sets of ``captures``, without symmetries, standardised; "loss" is
    minus the log density of the targets, of a regression with the covariance that it now states, of
    a mixture widened to suit them: a network that learns its drapes by heart becomes too sure while
    its errors still fall, which :func:`calibrate` mends."""
    network.eval()
    answers, targets = [], []
    rng = np.random.default_rng(0)
    for cloths in np.array_split(np.arange(len(captures)), -(-len(captures) // _VALIDATION_BATCH)):
        batch, _ = captures.batch(cloths, condition, rng, symmetric=False)
        answers.append(network.answer(batch).cpu())
        targets.append(network.tensors(batch, "targets")[0].cpu())
    truth = torch.cat(targets)
    mixture = network.calibrated(Mixture.joined(answers), truth)
    draws = mixture.posterior.sample(400, np.random.default_rng(0))
    squares = np.square(draws.mean(axis=0) - truth.numpy())[:, :MODULI]
    return {
        "loss": min(-mixture.widened(scale).log_likelihood(truth).double().mean().item()
                    for scale in _SCALES),
        "rmse_log_alpha": float(np.sqrt(squares[:, :3].mean())),
        "rmse_beta_over_alpha": float(np.sqrt(squares[:, 3:].mean())),
        "inside": inside(ranks(draws, truth.numpy())[:, :MODULI]),
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
                        f"validation {metrics['loss']:.2f} of "
                        f"{metrics['samples']} fabrics, log alpha {metrics['rmse_log_alpha']:.3f}, "
                        f"beta/alpha {metrics['rmse_beta_over_alpha']:.3f}")


def describe(
    config: TrainConfig, training: CaptureSet, datasets: dict, metrics: dict, *, epoch: int,
    cycles: list[int],
) -> dict:
    """Description of a checkpoint's network, see :mod:`drapenet.network.checkpoint`."""
    theta = training.cloth.theta
    low, high = np.quantile(theta, [0.01, 0.99], axis=0)
    sampling = datasets["generation"][-1]["sampling"]
    prior = {"fabrics": datasets["generation"][-1]["prior"], **{
        name: sampling[name] for name in ("even_share", "anisotropy", "anisotropy_varied",
                                          "nuisances")}}
    fabrics = prior_from_content(prior["fabrics"], origin="the dataset's prior")
    return {
        "reference_density_g_m2": REFERENCE_DENSITY * 1e3,
        "model": arguments(config, training),
        "targets": {name: part.tolist() for name, part in vars(training.scale).items()},
        # Of theta in the dataset's order: warp, bias, weft. The deviation is the prior's, which
        # errors are compared with; fabrics that were moved to even stiffness are not typical. The
        # deviation of the logarithm of the yarns' ratio is that of all.
        "fabrics": {"low": low.tolist(), "high": high.tolist(),
                    "deviation": spread_of(fabrics).tolist(),
                    "ratio": float((theta[:, FIRST] - theta[:, SECOND]).std())},
        "prior": prior,
        "dataset": {
            **datasets,
            "drapes": len(np.unique(training.maps.index)),
            "fabrics": len(np.unique(training.maps.fabric)),
        },
        "validation": metrics,
        "epochs": epoch + 1,
        "cycles": cycles,  # ends of the learning rate's
        "config": config.defining(),
        "versions": {"project": release(), "torch": torch.__version__},
    }


def calibrate(checkpoint: Path, captures: CaptureSet, config: TrainConfig) -> None:
    """Add to a ``checkpoint`` the scales of its deviations, fitted on ``captures`` of fabrics that
    it has not learned; none to one that has them, when a finished training is run again, and none
    by fewer than :data:`LEAST_CALIBRATING` fabrics, of which the scales would be noise."""
    header = read_header(checkpoint)
    if header.calibrated:
        return
    if len(captures) < LEAST_CALIBRATING:
        print(f"warning: {len(captures)} fabrics to validate with, fewer than {LEAST_CALIBRATING}: "
              "intervals are not calibrated")
        return
    model = load_model(header)
    rng = np.random.default_rng(config.seed)
    condition, drawn = Condition.of_inputs(config.inputs), []
    # As many sets of each kind of cloth and of curled cloth: errors of the rare ones are larger.
    kinds = np.where(captures.curled, -1, captures.kind)
    groups = [np.flatnonzero(kinds == kind) for kind in np.unique(kinds)]
    cloths = np.concatenate([rng.choice(group, len(captures) * _CALIBRATED // len(groups))
                             for group in groups])
    for rows in np.array_split(cloths, -(-len(cloths) // _VALIDATION_BATCH)):
        batch, facts = captures.batch(rows, condition, rng, symmetric=False)
        samples = sample_targets(Loaded(model), header, batch, facts.known)
        targets, = model.tensors(batch, "targets")
        drawn.append((samples[:: DRAWS // _DRAWN].swapaxes(0, 1),
                      header.scale.decode(targets.numpy()), seen_of(batch, samples)))
    samples, truth, seen = (np.concatenate(parts) for parts in zip(*drawn, strict=True))
    found = Calibration.fit(samples.swapaxes(0, 1), truth, seen)
    description = read_description(checkpoint) | {"calibrated": {
        name: part.tolist() for name, part in vars(found).items()}}
    save_checkpoint(checkpoint, model=model, half=config.half_precision, description=description)


def save_state(
    path: Path, *, model: torch.nn.Module, optimizer: Optimizer, record: dict[str, Any]
) -> None:
    """Write the state of a training run for an exact resume."""
    for pattern in ("*.safetensors", path.name):  # of runs killed during a write
        remove_partial(path.parent, pattern)
    with replacing(path) as file:
        torch.save({"record": record, "model": model.state_dict(),
                    "optimizer": optimizer.state_dict()}, file)


def load_state(
    path: Path, *, run: dict[str, Any], model: torch.nn.Module, optimizer: Optimizer
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
                         "another out=, or remove it")
    return record
