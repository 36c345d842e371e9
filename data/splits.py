"""Which drapes of a dataset make a split, whatever shows them: stored views or fresh ones."""

import hashlib
import logging
from abc import ABC, abstractmethod
from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np
import torch
from torch.utils.data import Dataset, default_collate

from common.errors import InputError
from data.shards import ANEW, MANIFEST, Shard, json_digest, read_manifest, require_unchanged

log = logging.getLogger(__name__)

FRACTIONS = MappingProxyType({"train": 0.8, "validation": 0.1, "test": 0.1})

Noise = Callable[[torch.Tensor, torch.Tensor, torch.Generator], torch.Tensor]
"""Of views (..., 4, H, W) in m and intrinsics (..., 4), like :class:`data.sensor.SensorNoise`."""


def split_by_fabric(
    fabrics: np.ndarray, *, fractions: Mapping[str, float] = FRACTIONS, seed: int = 0
) -> np.ndarray:
    """Name of the split of each drape, from the ids ``fabrics`` (N,) of their fabrics.

    A fabric's split depends on its id and ``seed`` alone: drapes of a fabric stay together, and
    no fabric changes sides when a dataset grows.

    Raises:
        InputError: the fractions are negative or do not add up to 1.
    """
    shares = list(fractions.values())
    if min(shares) < 0 or abs(sum(shares) - 1) > 1e-9:
        raise InputError(f"the fractions of the splits must add up to 1, not {sum(shares):g}")
    bounds = np.cumsum(shares)[:-1].tolist()
    names = list(fractions)
    ids, position = np.unique(np.asarray(fabrics), return_inverse=True)
    chosen = [names[bisect_right(bounds, _uniform(f"{seed}:{fabric}"))] for fabric in ids]
    return np.array(chosen)[position]


def thin_out(
    fabrics: np.ndarray, *, count: int = 0, drapes_each: int = 0, seed: int = 0
) -> np.ndarray:
    """Which drapes (N,) bool to keep of fewer fabrics, and of fewer drapes of each.

    Smaller choices are parts of larger ones, so that learning curves compare like with like.

    Args:
        fabrics: (N,) id of each drape's fabric.
        count: fabrics to keep; 0 keeps all.
        drapes_each: drapes of a fabric to keep, the first ones; 0 keeps all.
        seed: of the order in which fabrics are taken.

    Raises:
        InputError: there are fewer fabrics than ``count``.
    """
    ids, position, held = np.unique(fabrics, return_inverse=True, return_counts=True)
    if count > len(ids):
        raise InputError(f"fabrics={count} are asked for, the dataset trains on {len(ids)}")
    order = np.argsort([_uniform(f"{seed}:{fabric}:order") for fabric in ids])
    kept = np.isin(position, order[: count or None])
    if drapes_each:
        rank = np.empty(len(fabrics), dtype=int)
        rank[np.argsort(position, kind="stable")] = np.concatenate([np.arange(n) for n in held])
        kept &= rank < drapes_each
    return kept


def _uniform(key: str) -> float:
    """A number in [0, 1) that is the same for ``key`` everywhere and always."""
    return int.from_bytes(hashlib.sha256(key.encode()).digest()[:6], "big") / 2**48


def finished_manifest(root: str | Path) -> dict:
    """The content of a dataset's ``dataset.json``.

    Raises:
        InputError: it is missing, unfinished or damaged, or contradicts itself.
    """
    manifest = read_manifest(Path(root))
    if manifest is None:
        raise InputError(f"{root} is no dataset: dataset.json is missing")
    if not manifest["complete"]:
        raise InputError(f"{root} is unfinished; complete it with python -m data.generate "
                         f"out={root} and the settings it was begun with")
    require_digest(root, manifest["config"], manifest["identity"])
    return manifest


def require_digest(root: str | Path, content: dict, digest: str) -> None:
    """InputError unless a part of the ``dataset.json`` in ``root`` has the digest given there."""
    if json_digest(content) != digest:
        raise InputError(f"{Path(root) / MANIFEST} contradicts itself: its digests are not those "
                         f"of its content; {ANEW}")


class SplitDataset(Dataset, ABC):
    """The converged drapes of one split, ``orientations_per_epoch`` items each.

    An item is a dict of

    - ``views`` (4, H, W) float32, z-depth in m, background 0;
    - ``theta`` (6,) float32, see :mod:`data.fabrics`;
    - ``orientation`` float32, direction of the warp axis in the first view, in [0, pi);
    - ``turns`` (4,) float32, what the table had turned beyond k quarter turns in view k, rad,
      before views are reordered or mirrored;
    - ``fabric`` and ``index`` (of the drape in the dataset), int.

    Args:
        root: folder written by :mod:`data.generate`.
        split: name in ``fractions``; None takes all drapes.
        fractions, split_seed: see :func:`split_by_fabric`.
        noise: sensor noise, such as :class:`data.sensor.SensorNoise`; None leaves it out.
        augment: show each drape in one of its equivalents (:mod:`data.view_order`), at random.
        orientations_per_epoch: items of each drape in an epoch, each in another orientation.
        seed: seed of orientations, augmentation and noise.
        fabrics, drapes_each: keep fewer, see :func:`thin_out`; 0 keeps all.

    Attributes:
        manifest, hash: content of dataset.json, and what identifies the dataset's content.
        index, fabric: (N,) of each drape in the dataset; theta: (N, 6) float64.
        left_out: how many drapes of the split have each status other than converged.
        epoch: whose randomness the items have.

    Raises:
        InputError: no dataset, an unfinished or damaged one, no converged drape in the split, or
            an option that makes no sense.
    """

    def __init__(
        self,
        root: str | Path,
        *,
        split: str | None = None,
        fractions: Mapping[str, float] = FRACTIONS,
        split_seed: int = 0,
        noise: Noise | None = None,
        augment: bool = False,
        orientations_per_epoch: int = 1,
        seed: int = 0,
        fabrics: int = 0,
        drapes_each: int = 0,
    ) -> None:
        self.root = Path(root)
        self.manifest = finished_manifest(self.root)
        self.hash: str = self.manifest["hash"]
        require_unchanged(self.root, self.manifest["shards"])
        if orientations_per_epoch < 1:
            raise InputError(f"orientations_per_epoch={orientations_per_epoch} must be at least 1")
        if seed < 0:
            raise InputError(f"seed={seed} must not be negative")
        if split is not None and split not in fractions:
            raise InputError(f"unknown split '{split}'; known: {', '.join(fractions)}")
        self._noise, self._augment = noise, augment
        self._per_drape, self._seed = orientations_per_epoch, seed
        self.epoch = 0
        self._choose(split, fractions, split_seed, {"count": fabrics, "drapes_each": drapes_each})

    def _choose(
        self, split: str | None, fractions: Mapping[str, float], split_seed: int, fewer: dict
    ) -> None:
        """Find the drapes: where they are, and what is small of them."""
        # Everything, until it is known what to keep.
        self._rows = {name: slice(None) for name in self.manifest["shards"]}
        parts = self._read("index", "fabric", "theta", "status")
        table = {name: np.concatenate(part) for name, part in parts.items()}
        chosen = np.ones(len(table["index"]), dtype=bool)
        if split is not None:
            chosen = split_by_fabric(table["fabric"], fractions=fractions, seed=split_seed) == split
        converged = table["status"] == "converged"
        self.left_out = Counter(table["status"][chosen & ~converged].tolist())
        kept = chosen & converged
        if self.left_out:
            log.warning("%s: %d drapes left out of %d (%s)", self.root, self.left_out.total(),
                        chosen.sum(), ", ".join(f"{n} {s}" for s, n in self.left_out.items()))
        if not kept.any():
            where = "" if split is None else f" in the split '{split}'"
            raise InputError(f"{self.root} holds no converged drape{where}; generate more drapes")
        kept[kept] = thin_out(table["fabric"][kept], seed=split_seed, **fewer)
        ends = np.cumsum([len(part) for part in parts["index"]])
        for name, in_shard in zip(self._rows, np.split(kept, ends[:-1]), strict=True):
            self._rows[name] = np.flatnonzero(in_shard)
        self.places = [(name, int(row)) for name, rows in self._rows.items() for row in rows]
        self.index, self.fabric, self.theta = (
            table[name][kept] for name in ("index", "fabric", "theta"))

    def columns(self, *names: str) -> dict[str, np.ndarray]:
        """Arrays of the shards, as stored, with a row for each drape of the split."""
        return {name: np.concatenate(part) for name, part in self._read(*names).items()}

    def _read(self, *names: str) -> dict[str, list[np.ndarray]]:
        """The same, each shard's part on its own."""
        parts: dict[str, list[np.ndarray]] = {name: [] for name in names}
        for file, rows in self._rows.items():
            with Shard(self.root / file) as shard:
                for name in names:
                    parts[name].append(shard.column(name)[rows])
        return parts

    @property
    def drapes(self) -> int:
        """Converged drapes in the split; ``theta``, ``fabric``, ``index`` have a row for each."""
        return len(self.places)

    def set_epoch(self, epoch: int) -> None:
        """Choose the epoch whose randomness the next items have.

        Workers of a DataLoader copy the dataset when they start: call this before iterating,
        and leave ``persistent_workers`` off.
        """
        self.epoch = epoch

    def __len__(self) -> int:
        return self.drapes * self._per_drape

    @abstractmethod
    def __getitem__(self, item: int) -> dict:
        """One item."""

    def batch(self, items: Sequence[int]) -> dict[str, torch.Tensor]:
        """Several items at once, each entry with a new first axis."""
        return default_collate([self[item] for item in items])

    def _locate(self, item: int) -> tuple[int, int]:
        """The drape of an item, and which of the drape's items it is; IndexError if there is none.
        """
        if not 0 <= item < len(self):
            raise IndexError(item)
        return divmod(item, self._per_drape)

    def _generator(self, drape: int, purpose: int) -> np.random.Generator:
        """Random numbers for one purpose, the same for a drape in every split of its dataset."""
        return np.random.default_rng([self._seed, self.epoch, int(self.index[drape]), purpose])
