"""Short trainings of networks on small sets of captures, for comparisons in studies.

The training drapes are simulated like those of the bundled network (:mod:`data.generate`), on
coarser meshes, with four views. All networks are evaluated on the same captures of held-out
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

from benchmarks.common import ESTIMATOR_SOURCES, load_arrays, run_cases
from common.command import compose_config
from data.fabrics import read_fabric_table
from data.generate import generate_dataset
from data.manifest import finished_manifest, json_digest
from data.options import Options, config_from_options
from data.prior import load_prior
from data.prior.base import Stored
from data.prior.table import TablePrior
from data.splits import split_by_fabric
from drapenet.calibration import inside, ranks, rms_with_interval
from drapenet.config import ModelConfig, TrainConfig, learning_rate
from drapenet.convention import FIRST, SECOND, SWAPPED
from drapenet.maps import Maps, make_maps
from drapenet.targets import MODULI, TargetScale
from drapenet.training import CaptureSet
from sim.scene import Rig
from studies.networks import COMPONENTS, OnMaps, OnNumbers, OnOutlines, OnViews
from studies.stacked_views import CHANNELS, TARGETS, StackedSet, pictures, setups

RIG = "square300_cylinder100"
HELD_OUT = {"train": 0.88, "unseen": 0.12}  # of the fabrics of DATASETS' first
DATASETS: dict[str, tuple[str, int, tuple[str, ...]]] = {
    "fabrics": ("drapes", 0, ()),
    "starts": ("start_drapes", 1, ("dataset.starts_per_fabric=4",
                                   "dataset.starts=[sine,fold,ring]")),
    "vae": ("other_drapes", 2, ("dataset.soft_share=0",)),
    "mixture": ("other_drapes", 3, ("prior=mixture", "dataset.soft_share=0")),
    "uniform": ("other_drapes", 4, ("dataset.soft_share=0",)),
    "table": ("table_drapes", 5, ("dataset.soft_share=0",)),
}
"""Sets of drapes: the key of the config that counts them, what is added to its seed, and words for
``configs/generate.yaml``."""
_AROUND = 20_000  # samples of the prior that the box of "uniform" is taken around
_AT_ONCE = 64  # captures


@dataclass(frozen=True)
class Training:
    """Settings of a training: data, network and duration.

    Attributes:
        drapes: a key of :data:`DATASETS`.
        fabrics: how many of its fabrics; 0: all that are not held out.
        starts: how many drapes of each; 0: all.
        start: only drapes from this initial state; empty: from all.
        sees: "map", "outline", "numbers" or "views".
        network: for views, the name of a network of torchvision; else the width of the first stage.
        answer: see :func:`studies.networks.head`.
        fixed: whether specimens lie in one orientation, and are not shown turned.
        steps: of the training; 0: by the clock.
        cpu_seconds: of the training, where ``steps`` is 0.
        keep: whether the weights are kept.
        table: whether it is also judged on the fabrics of "table".
    """

    drapes: str = "fabrics"
    fabrics: int = 0
    starts: int = 0
    start: str = ""
    sees: str = "map"
    network: str = "16"
    answer: str = "posterior"
    fixed: bool = False
    steps: int = 0
    cpu_seconds: float = 0.0
    keep: bool = False
    table: bool = False


@dataclass(frozen=True)
class UniformPrior(Stored):
    """Uniform distribution of theta between ``low`` (6,) and ``high`` (6,)."""

    low: np.ndarray
    high: np.ndarray
    kind: ClassVar[str] = "uniform"

    @classmethod
    def around(cls, theta: np.ndarray, *, tail: float = 0.01) -> "UniformPrior":
        """Between the quantiles ``tail`` and 1 - ``tail`` of each entry of theta (F, 6)."""
        return cls(*np.quantile(theta, [tail, 1 - tail], axis=0))

    def sample(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Draw theta (n, 6), admissible or not."""
        return rng.uniform(self.low, self.high, (n, 6))


def train_all(trainings: dict[str, Training], config: dict[str, Any]) -> dict[str, dict]:
    """Results of all trainings by name, see :func:`learn`; finished ones are not repeated."""
    used = {"fabrics"} | {one.drapes for one in trainings.values()}
    used |= {"table"} if any(one.table for one in trainings.values()) else set()
    digests = {name: make_drapes(name, config) for name in DATASETS if name in used}
    for name in used:
        captured(name, config)
    for fixed in {one.fixed for one in trainings.values() if one.sees == "views"}:
        seen(config, fixed=fixed)
    settings = {key: config[key] for key in ("captures", "batch", "seed", "work", "data_seed")}
    cases = {}
    for name, one in trainings.items():
        case = {"training": asdict(one), "settings": settings, "dataset": digests[one.drapes]}
        cases[name] = (f"training_{json_digest(case)[:12]}", case)
    found = run_cases(learn, dict(cases.values()), folder=Path(config["work"]),
                      workers=config["workers"], sources=ESTIMATOR_SOURCES)
    return {name: found[key] | {"key": key} for name, (key, _) in cases.items()}


def make_drapes(name: str, config: dict[str, Any]) -> str:
    """Make a set of drapes where it is missing; its digest."""
    size, step, words = DATASETS[name]
    options = compose_config("generate", [
        f"drapes={config[size]}", f"seed={config['data_seed'] + step}",
        f"edge_mm={config['edge_mm']}", *words], schema=Options)
    dataset = config_from_options(options)
    if name == "uniform":
        fabrics = load_prior("vae").sample(_AROUND, np.random.default_rng(0))
        dataset = replace(dataset, prior=UniformPrior.around(fabrics))
    if name == "table":
        fabrics = read_fabric_table(config["table"]).theta
        dataset = replace(dataset, prior=TablePrior(fabrics))
    return generate_dataset(dataset, folder(name, config), workers=config["workers"])["hash"]


def folder(name: str, config: dict[str, Any]) -> Path:
    """Of a set of drapes."""
    return Path(config["work"]) / f"drapes_{name}"


def captured(name: str, config: dict[str, Any]) -> Maps:
    """Maps of a set's captures, made where they are missing."""
    return make_maps(folder(name, config), Path(config["work"]), rig=Rig.from_name(RIG),
                     setups=setups(), captures=config["captures"], seed=config["seed"],
                     workers=config.get("workers", 1))


def seen(config: dict[str, Any], *, fixed: bool) -> list[np.ndarray]:
    """Views, focal lengths and orientations of the captures of "fabrics", see :func:`pictures`."""
    root, work = folder("fabrics", config), Path(config["work"])
    manifest = finished_manifest(root)
    cases = {f"{Path(name).stem}{'_fixed' if fixed else ''}": {
        "shard": str(root / name), "rig": RIG, "captures": config["captures"],
        "seed": config["seed"], "dataset": manifest["hash"], "fixed": fixed}
        for name in manifest["shards"]}
    run_cases(pictures, cases, folder=work, workers=config.get("workers", 1), sources=("data",))
    parts = [load_arrays(work, name) for name in cases]
    return [np.concatenate([part[key] for part in parts])
            for key in ("views", "focal", "orientation")]


@dataclass(frozen=True)
class Learner:
    """Training and test captures, target scale and network of a training."""

    training: CaptureSet
    unseen: dict[str, CaptureSet]
    scale: TargetScale
    network: torch.nn.Module


def learner(one: Training, config: dict[str, Any]) -> Learner:
    """The captures and the untrained network of a training."""
    rig, maps = Rig.from_name(RIG), captured("fabrics", config)
    held = split_by_fabric(maps.fabric, fractions=HELD_OUT) == "unseen"
    if one.sees == "views":
        parts, other = seen(config, fixed=one.fixed), seen(config, fixed=False)
        stacked = StackedSet(maps.chosen(~held), *(part[~held] for part in parts))
        rest = StackedSet(maps.chosen(held), *(part[held] for part in other), scale=stacked.scale)
        return Learner(stacked, {"fabrics": rest}, stacked.scale, OnViews(
            one.network, channels=CHANNELS, answer=one.answer, targets=TARGETS))
    scale = CaptureSet(maps.chosen(~held), disc=False).scale
    unseen = {"fabrics": maps.chosen(held)}
    if one.table:
        unseen["table"] = captured("table", config)
    chosen = maps.chosen(~held) if one.drapes == "fabrics" else captured(one.drapes, config)
    chosen = chosen.chosen(_wanted(chosen, one, config))
    captures = CaptureSet(chosen, scale=scale, disc=False)
    shape = captures.network(ModelConfig(width=1, components=COMPONENTS))
    kinds = {"map": OnMaps, "outline": OnOutlines}
    network: torch.nn.Module
    if one.sees == "numbers":
        network = OnNumbers(rig=rig, answer=one.answer, targets=shape["targets"])
    else:
        network = kinds[one.sees](answer=one.answer, **shape | {"width": int(one.network)}, **(
            {"rig": rig} if one.sees == "outline" else {}))
    return Learner(captures, {name: CaptureSet(part, scale=scale, disc=False)
                              for name, part in unseen.items()}, scale, network)


def _wanted(maps: Maps, one: Training, config: dict[str, Any]) -> np.ndarray:
    """Mask (N,) of the captures used by a training."""
    sampling = finished_manifest(folder(one.drapes, config))["config"]["sampling"]
    number = maps.index % sampling["starts_per_fabric"]  # of the drape among its fabric's
    names = np.array(sampling["starts"])[(maps.fabric + number) % len(sampling["starts"])]
    wanted = np.ones(len(maps), bool)
    if one.fabrics:
        wanted &= np.isin(maps.fabric, np.unique(maps.fabric)[: one.fabrics])
    if one.starts:
        wanted &= number < one.starts
    if one.start:
        first = [index for fabric in np.unique(maps.fabric)
                 for index in maps.index[(maps.fabric == fabric) & (names == one.start)][:1]]
        wanted &= np.isin(maps.index, first)
    return wanted


def learn(*, training: dict, settings: dict, dataset: str) -> dict[str, Any]:
    """Train and judge one network; ``dataset`` says what it learned from.

    Returns:
        ``unseen``: by set, ``log_alpha`` and ``beta_over_alpha`` (:func:`rms_with_interval`) in
        deviations of the training's fabrics, stiffer yarns first, and of a posterior ``inside``,
        shares of moduli in its intervals; ``steps``, ``cpu_seconds``, ``captures``, ``parameters``.
    """
    one = Training(**training)
    torch.manual_seed(settings["seed"])
    made = learner(one, settings)
    began = time.process_time()
    steps = fit(made.network, made.training, one, batch=settings["batch"], seed=settings["seed"])
    seconds = time.process_time() - began
    spread = stiff_first(captured("fabrics", settings).theta).std(axis=0)
    result = {"unseen": {}, "steps": steps, "cpu_seconds": seconds, "captures": len(made.training),
              "parameters": sum(part.numel() for part in made.network.parameters())}
    for name, captures in made.unseen.items():
        estimates, places = judged(made, captures, posterior=one.answer == "posterior")
        errors = (estimates - stiff_first(captures.maps.theta)) / spread
        result["unseen"][name] = {
            "log_alpha": rms_with_interval(errors[:, :3], captures.maps.fabric),
            "beta_over_alpha": rms_with_interval(errors[:, 3:], captures.maps.fabric),
            **({"inside": inside(places)} if places is not None else {})}
    if one.keep:
        result["arrays"] = {name: value.numpy()
                            for name, value in made.network.state_dict().items()}
    return result


def fit(
    network: torch.nn.Module, captures: CaptureSet, one: Training, *, batch: int, seed: int
) -> int:
    """Train as ``train.py`` does, without epochs; the number of steps. The network is left in
    evaluation mode.
    """
    optim = compose_config("train", [f"optim.batch_size={batch}"], schema=TrainConfig).optim
    began, done = time.process_time(), 0
    optimizer = torch.optim.AdamW(network.parameters(), weight_decay=optim.weight_decay)
    network.train()
    batches = chain.from_iterable(_shown(captures, one, size=batch, seed=seed, epoch=epoch)
                                  for epoch in count())
    while True:
        progress = (done / one.steps if one.steps
                    else (time.process_time() - began) / one.cpu_seconds)
        if progress >= 1:
            break
        part = next(batches)
        for group in optimizer.param_groups:
            group["lr"] = learning_rate(optim, progress)
        loss = -part.through(network).log_likelihood(part.targets).mean()
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), optim.clip)
        optimizer.step()
        done += 1
    network.eval()
    return done


def _shown(
    captures: CaptureSet, one: Training, *, size: int, seed: int, epoch: int
) -> Iterator[Any]:
    """Batches of an epoch; of specimens in one orientation without turns."""
    if not one.fixed:
        yield from captures.epoch(seed=seed, epoch=epoch, size=size)
        return
    order = np.random.default_rng([seed, epoch]).permutation(len(captures))
    for start in range(0, len(captures) - size + 1, size):
        yield captures.batch(order[start : start + size], revealed=np.zeros((size, 2), bool))


@torch.no_grad()
def judged(
    made: Learner, captures: CaptureSet, *, posterior: bool
) -> tuple[np.ndarray, np.ndarray | None]:
    """(N, 6) estimates of theta, stiffer yarns first, and of a posterior (N, 6) ranks of the truth
    along the targets' own yarns.
    """
    means, places = [], []
    for _, part in captures.in_order(_AT_ONCE):
        answer = part.through(made.network)
        means.append(made.scale.decode(answer.mean.numpy())[:, :MODULI])
        if posterior:
            draws = answer.sample(400, torch.Generator().manual_seed(0))
            places.append(ranks(draws.numpy(), part.targets.numpy())[:, :MODULI])
    return stiff_first(np.concatenate(means)), np.concatenate(places) if posterior else None


def kept(one: Training, result: dict, config: dict[str, Any]) -> Learner:
    """Load the trained network of a result of :func:`train_all` with stored weights."""
    made = learner(one, config)
    weights = load_arrays(Path(config["work"]), result["key"])
    made.network.load_state_dict({name: torch.from_numpy(value)
                                  for name, value in weights.items()})
    made.network.eval()
    return made


def stiff_first(theta: np.ndarray) -> np.ndarray:
    """theta (N, 6) with the stiffer yarns first."""
    return np.where(theta[:, [FIRST]] < theta[:, [SECOND]], theta[:, SWAPPED], theta)
