"""Short trainings of networks on small sets of captures, for comparisons in studies.

The training drapes are simulated like those of the bundled network (:mod:`data.dataset.generate`),
on coarser meshes, with four views. All networks are evaluated on the same captures of held-out
fabrics. Drapes, maps and finished trainings are stored in ``work`` and shared by the studies.
"""

import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from itertools import chain, count
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from matplotlib.figure import Figure

from common.command import compose_config
from data.dataset.config import Options, config_from_options
from data.dataset.folder import finished_manifest, json_digest, split_by_fabric
from data.dataset.generate import generate_dataset
from data.fabrics.fabrics import read_fabric_table
from data.fabrics.prior import Prior, TablePrior, load_prior
from drapenet.config import TrainConfig
from drapenet.network.dataset import Maps, make_maps
from drapenet.network.evaluate import rms_with_interval
from drapenet.network.posterior import inside, ranks
from drapenet.network.targets import TargetScale
from drapenet.network.training import fit
from experiments.estimation.prior import MixturePrior
from experiments.papers.networks import (
    CaptureSet,
    FoldNetwork,
    MapNetwork,
    OutlineNetwork,
    ViewNetwork,
    capture_views,
    setups,
    stiff_first,
)
from experiments.result import ESTIMATOR, load_arrays, run_cases

HELD_OUT = {"train": 0.88, "unseen": 0.12}  # fractions of the fabrics of the first dataset
DATASETS: dict[str, tuple[str, int, tuple[str, ...]]] = {
    "fabrics": ("drapes", 0, ()),
    "starts": ("start_drapes", 1, ("dataset.starts_per_fabric=4",
                                   "dataset.starts=[sine,fold,ring]")),
    "vae": ("other_drapes", 2, ()),
    "mixture": ("other_drapes", 3, ()),
    "uniform": ("other_drapes", 4, ()),
    "table": ("table_drapes", 5, ()),
}
"""Sets of drapes by name: config key of their number, increment of the seed, and overrides of
``configs/generate.yaml``."""
_BOX_SAMPLES = 20_000  # samples of the prior for the bounds of "uniform"
_PREDICTION_BATCH = 64  # captures per batch of an evaluation
_MEAN_SAMPLE = 1000  # captures used for mean and deviation of the distances


@dataclass(frozen=True)
class Training:
    """Settings of a training: data, network and duration."""

    drapes: str = "fabrics"  # a key of DATASETS
    fabrics: int = 0  # 0: all that are not held out
    starts: int = 0  # drapes of each fabric; 0: all
    start: str = ""  # initial state of the drapes; empty: any
    input: str = "map"  # map, outline, numbers or views
    network: str = "16"  # for views, of torchvision; else the width of the first stage
    output: str = "posterior"  # see output_head
    fixed: bool = False  # all specimens in one orientation, without augmentation by symmetries
    steps: int = 0  # 0: limited by cpu_seconds
    cpu_seconds: float = 0.0
    keep_weights: bool = False
    evaluate_table: bool = False  # also on the fabrics of "table"


@dataclass(frozen=True, eq=False)
class UniformPrior(Prior):
    """Uniform distribution of theta between ``low`` (6,) and ``high`` (6,)."""

    low: np.ndarray
    high: np.ndarray
    kind: ClassVar[str] = "uniform"

    @classmethod
    def around(cls, theta: np.ndarray, *, tail: float = 0.01) -> "UniformPrior":
        """Bounds at the quantiles ``tail`` and 1 - ``tail`` of each entry of theta (F, 6)."""
        return cls(*np.quantile(theta, [tail, 1 - tail], axis=0))

    def sample(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Draw theta (n, 6), admissible or not."""
        return rng.uniform(self.low, self.high, (n, 6))


def train_all(trainings: dict[str, Training], config: dict[str, Any]) -> dict[str, dict]:
    """Results by name of all trainings, see :func:`train`; run those without a stored result."""
    used = {"fabrics"} | {one.drapes for one in trainings.values()}
    used |= {"table"} if any(one.evaluate_table for one in trainings.values()) else set()
    digests = {name: make_drapes(name, config) for name in DATASETS if name in used}
    for name in used:
        load_maps(name, config)
    for fixed in {one.fixed for one in trainings.values() if one.input == "views"}:
        load_images(config, fixed=fixed)
    settings = {key: config[key] for key in ("captures", "batch", "seed", "work", "data_seed")}
    cases = {}
    for name, one in trainings.items():
        case = {"training": asdict(one), "settings": settings, "dataset": digests[one.drapes]}
        cases[name] = (f"training_{json_digest(case)[:12]}", case)
    found = run_cases(train, dict(cases.values()), config, folder=Path(config["work"]),
                      sources=ESTIMATOR)
    return {name: found[key] | {"key": key} for name, (key, _) in cases.items()}


def make_drapes(name: str, config: dict[str, Any]) -> str:
    """Simulate a set of drapes unless it is stored; return its digest."""
    size, step, words = DATASETS[name]
    options = compose_config("generate", [
        f"drapes={config[size]}", f"seed={config['data_seed'] + step}",
        f"edge_mm={config['edge_mm']}", *words], schema=Options)
    dataset = config_from_options(options)
    if name == "uniform":
        fabrics = load_prior("vae").sample(_BOX_SAMPLES, np.random.default_rng(0))
        dataset = replace(dataset, prior=UniformPrior.around(fabrics))
    if name in ("table", "mixture"):
        fabrics = read_fabric_table(config["table"]).theta
        prior = TablePrior(fabrics) if name == "table" else MixturePrior.fit(fabrics)
        dataset = replace(dataset, prior=prior)
    return generate_dataset(dataset, drapes_folder(name, config), workers=config["workers"])["hash"]


def drapes_folder(name: str, config: dict[str, Any]) -> Path:
    """Path of a set of drapes."""
    return Path(config["work"]) / f"drapes_{name}"


def load_maps(name: str, config: dict[str, Any]) -> Maps:
    """Maps of the captures of a set, computed unless they are stored."""
    root = drapes_folder(name, config)
    return make_maps(root, finished_manifest(root), Path(config["work"]),
                     setups=setups(), captures=config["captures"], seed=config["seed"],
                     workers=config.get("workers", 1))


def load_images(config: dict[str, Any], *, fixed: bool) -> np.ndarray:
    """Images of the captures of the set "fabrics", see :func:`capture_views`."""
    root, work = drapes_folder("fabrics", config), Path(config["work"])
    manifest = finished_manifest(root)
    cases = {f"{Path(name).stem}{'_fixed' if fixed else ''}": {
        "shard": str(root / name), "captures": config["captures"], "seed": config["seed"],
        "dataset": manifest["hash"], "fixed": fixed} for name in manifest["shards"]}
    run_cases(capture_views, cases, config, folder=work, sources=("data",))
    return np.concatenate([load_arrays(work, name)["images"] for name in cases])


@dataclass(frozen=True)
class Experiment:
    """Training and test captures and network of a training."""

    training: CaptureSet
    unseen: dict[str, CaptureSet]
    network: torch.nn.Module


def make_experiment(one: Training, config: dict[str, Any]) -> Experiment:
    """Load the captures of a training and initialise its network."""
    maps = load_maps("fabrics", config)
    held = split_by_fabric(maps.fabric, fractions=HELD_OUT) == "unseen"
    theta = stiff_first(maps.theta[~held])
    scale = TargetScale(theta.mean(axis=0), theta.std(axis=0))
    if one.input == "views":
        captures, unseen = (CaptureSet.of_images(
            load_images(config, fixed=fixed)[rows], maps.theta[rows], maps.fabric[rows], scale)
            for rows, fixed in ((~held, one.fixed), (held, False)))
        return Experiment(captures, {"fabrics": unseen},
                          ViewNetwork(one.network, output=one.output))

    def captures_of(maps: Maps) -> CaptureSet:
        return CaptureSet.of_maps(maps.distance, maps.weight, maps.theta, maps.fabric, scale)

    chosen = maps.chosen(~held) if one.drapes == "fabrics" else load_maps(one.drapes, config)
    captures = captures_of(chosen.chosen(_selected(chosen, one, config)))
    unseen = {"fabrics": captures_of(maps.chosen(held))}
    if one.evaluate_table:
        unseen["table"] = captures_of(load_maps("table", config))
    return Experiment(captures, unseen, _map_network(one, captures.inputs[0]))


def _map_network(one: Training, distance: torch.Tensor) -> torch.nn.Module:
    """A network of maps with the mean and deviation of the ``distance`` (N, ...), m."""
    if one.input == "numbers":
        return FoldNetwork(one.output)
    sample = distance[:: -(-len(distance) // _MEAN_SAMPLE)]
    kind = {"map": MapNetwork, "outline": OutlineNetwork}[one.input]
    return kind(int(one.network), output=one.output, distance=float(sample.mean()),
                spread=float(sample.std()))


def _selected(maps: Maps, one: Training, config: dict[str, Any]) -> np.ndarray:
    """Mask (N,) of the captures used by a training."""
    sampling = finished_manifest(drapes_folder(one.drapes, config))["config"]["sampling"]
    number = maps.index % sampling["starts_per_fabric"]  # of the drape among those of its fabric
    names = np.array(sampling["starts"])[(maps.fabric + number) % len(sampling["starts"])]
    selected = np.ones(len(maps), bool)
    if one.fabrics:
        selected &= np.isin(maps.fabric, np.unique(maps.fabric)[: one.fabrics])
    if one.starts:
        selected &= number < one.starts
    if one.start:
        first = [index for fabric in np.unique(maps.fabric)
                 for index in maps.index[(maps.fabric == fabric) & (names == one.start)][:1]]
        selected &= np.isin(maps.index, first)
    return selected


def train(*, training: dict, settings: dict, dataset: str) -> dict[str, Any]:
    """Train and evaluate one network; ``dataset`` is a part of the result's key.

    Errors are in standard deviations over the training fabrics, stiffer yarns first.
    """
    one = Training(**training)
    torch.manual_seed(settings["seed"])
    experiment = make_experiment(one, settings)
    network = experiment.network
    optim = compose_config("train", [], schema=TrainConfig).optim
    optimizer = torch.optim.AdamW(network.parameters(), weight_decay=optim.weight_decay)
    began = time.process_time()
    fit(network, schedule(experiment.training, one, batch=settings["batch"],
                          seed=settings["seed"]), optimizer=optimizer, optim=optim)
    seconds = time.process_time() - began
    network.eval()
    result = {"unseen": {}, "steps": int(optimizer.state[next(network.parameters())]["step"]),
              "cpu_seconds": seconds, "captures": len(experiment.training),
              "parameters": sum(part.numel() for part in network.parameters())}
    for name, captures in experiment.unseen.items():
        estimates, all_ranks = predict(network, captures, posterior=one.output == "posterior")
        errors = estimates - captures.targets.numpy()
        result["unseen"][name] = {
            "log_alpha": rms_with_interval(errors[:, :3], captures.fabric),
            "beta_over_alpha": rms_with_interval(errors[:, 3:], captures.fabric),
            **({"inside": inside(all_ranks)} if all_ranks is not None else {})}
    if one.keep_weights:
        result["arrays"] = {name: value.numpy()
                            for name, value in network.state_dict().items()}
    return result


def schedule(
    captures: CaptureSet, one: Training, *, batch: int, seed: int
) -> Iterator[tuple[float, Any]]:
    """Steps for :func:`drapenet.network.training.fit`, with a number or a processor time as limit
    in place of epochs."""
    began = time.process_time()
    # Without augmentation where the orientation is fixed.
    batches = chain.from_iterable(
        captures.epoch(seed=seed, epoch=epoch, size=batch, symmetric=not one.fixed)
        for epoch in count())
    for done in count():
        progress = (done / one.steps if one.steps
                    else (time.process_time() - began) / one.cpu_seconds)
        if progress >= 1:
            return
        yield progress, next(batches)


@torch.no_grad()
def predict(
    network: torch.nn.Module, captures: CaptureSet, *, posterior: bool
) -> tuple[np.ndarray, np.ndarray | None]:
    """Estimates (N, 6) of standardised targets, and for a posterior ranks (N, 6) of the truth."""
    means, all_ranks = [], []
    for part in captures.in_order(_PREDICTION_BATCH):
        output = part.through(network)
        means.append(output.mean.numpy())
        if posterior:
            draws = output.sample(400, torch.Generator().manual_seed(0))
            all_ranks.append(ranks(draws.numpy(), part.targets.numpy()))
    return np.concatenate(means), np.concatenate(all_ranks) if posterior else None


def load_trained(one: Training, result: dict, config: dict[str, Any]) -> Experiment:
    """Load the trained network of a result of :func:`train_all` with stored weights."""
    experiment = make_experiment(one, config)
    weights = load_arrays(Path(config["work"]), result["key"])
    experiment.network.load_state_dict({name: torch.from_numpy(value)
                                  for name, value in weights.items()})
    experiment.network.eval()
    return experiment


def log_alpha(trainings: dict[str, dict[str, Any]]) -> dict[str, float]:
    """Errors of log alpha of trainings on unseen fabrics, by name."""
    return {name: one["unseen"]["fabrics"]["log_alpha"]["rmse"] for name, one in trainings.items()}


def limits(errors: list[dict[str, Any]]) -> tuple[np.ndarray, np.ndarray]:
    """Errors (N,), and the lengths (2, N) of their bars, from :func:`rms_with_interval`."""
    middle = np.array([one["rmse"] for one in errors])
    low, high = np.transpose([one["interval_95"] for one in errors])
    return middle, np.array([middle - low, high - middle])


def error_cell(result: dict[str, Any] | None, name: str, *, interval: bool = False) -> str:
    """Error of a training (:func:`train`) on unseen fabrics, as a table cell."""
    if result is None:
        return "–"
    error = result["unseen"]["fabrics"][name]
    low, high = error["interval_95"]
    return f"{error['rmse']:.3f}" + (f" ({low:.3f} to {high:.3f})" if interval else "")


def error_figure(groups: dict[str, dict[str, dict[str, Any]]]) -> Figure:
    """Plot errors and 95 % intervals of trainings by name; groups of trainings by label."""
    names = list(dict.fromkeys(name for group in groups.values() for name in group))
    figure = Figure(figsize=(9, 1.2 + 0.32 * len(names)), layout="constrained")
    for axes, (key, title) in zip(figure.subplots(1, 2, sharey=True), (
            ("log_alpha", "log α"), ("beta_over_alpha", "β/α")), strict=True):
        for k, (label, group) in enumerate(groups.items()):
            middle, bars = limits([one["unseen"]["fabrics"][key] for one in group.values()])
            places = np.array([names.index(name) for name in group])
            axes.errorbar(middle, places + 0.25 * (k - (len(groups) - 1) / 2), xerr=bars, fmt="o",
                          ms=4, label=label)
        axes.set(title=title, xlabel="error, in deviations over fabrics", xlim=(0, None))
        axes.set_yticks(range(len(names)), names)
        axes.grid(axis="x", color="0.9")
    axes.invert_yaxis()
    axes.legend(fontsize=8)
    return figure
