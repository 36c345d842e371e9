"""Training samples from shards: one noisy set of four views, its fabric and its orientation."""

import hashlib
import logging
import os
from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np
import torch
from torch.utils.data import Dataset

from data.shards import Shard, read_manifest
from data.view_order import ORDERS, reorder_axis, reorder_views
from sim.errors import InputError

log = logging.getLogger(__name__)

FRACTIONS = MappingProxyType({"train": 0.8, "validation": 0.1, "test": 0.1})
OPEN_SHARDS = 32  # files that one process keeps open

Noise = Callable[[torch.Tensor, torch.Tensor, torch.Generator], torch.Tensor]
"""Of views (4, H, W) in m and intrinsics (4,), like :class:`data.sensor.SensorNoise`."""


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


def _uniform(key: str) -> float:
    """A number in [0, 1) that is the same for ``key`` everywhere and always."""
    return int.from_bytes(hashlib.sha256(key.encode()).digest()[:6], "big") / 2**48


class DrapeDataset(Dataset):
    """Converged drapes of one split, with noise and augmentation drawn anew each epoch.

    An item is a dict of

    - ``views`` (4, H, W) float32, z-depth in m, background 0, or what ``transform`` makes of it;
    - ``theta`` (6,) float32, see :mod:`data.fabrics`;
    - ``orientation`` float32, direction of the warp axis in the first view, in [0, pi);
    - ``fabric`` and ``index`` (of the drape in the dataset), int.

    Randomness depends on (seed, epoch, drape) only, not on workers or the order of access.

    Args:
        root: folder written by :mod:`data.generate`.
        split: name in ``fractions``; None takes all drapes.
        fractions, split_seed: see :func:`split_by_fabric`.
        noise: sensor noise, such as :class:`data.sensor.SensorNoise`; None leaves it out.
        transform: applied to the views last.
        augment: start at a random view and mirror at random; all the equivalents are valid
            captures (:mod:`data.view_order`).
        orientations_per_epoch: items of each drape in an epoch, each another stored orientation;
            without ``augment`` the first ones in every epoch.
        seed: seed of orientations, augmentation and noise.

    Raises:
        InputError: no dataset, an unfinished one, no converged drape in the split, or an option
            that makes no sense.
    """

    def __init__(
        self,
        root: str | Path,
        *,
        split: str | None = None,
        fractions: Mapping[str, float] = FRACTIONS,
        split_seed: int = 0,
        noise: Noise | None = None,
        transform: Callable[[np.ndarray], np.ndarray] | None = None,
        augment: bool = False,
        orientations_per_epoch: int = 1,
        seed: int = 0,
    ) -> None:
        self.root = Path(root)
        manifest = read_manifest(self.root)
        if manifest is None:
            raise InputError(f"{self.root} is no dataset: dataset.json is missing")
        if not manifest["complete"]:
            raise InputError(f"{self.root} is unfinished; complete it with python -m data.generate "
                             f"out={self.root} and the settings it was begun with")
        self.manifest = manifest
        self.hash: str = manifest["hash"]
        stored = manifest["config"]["sampling"]["orientations"]
        if not 1 <= orientations_per_epoch <= stored:
            raise InputError(f"orientations_per_epoch={orientations_per_epoch} must lie between 1 "
                             f"and the {stored} stored ones")
        if seed < 0:
            raise InputError(f"seed={seed} must not be negative")
        if split is not None and split not in fractions:
            raise InputError(f"unknown split '{split}'; known: {', '.join(fractions)}")
        self._noise, self._transform, self._augment = noise, transform, augment
        self._per_drape, self._stored, self._seed = orientations_per_epoch, stored, seed
        self.epoch = 0
        self._open: dict[str, Shard] = {}
        self._owner = os.getpid()
        self._read_index(list(manifest["shards"]), split, fractions, split_seed)

    def _read_index(
        self,
        names: Sequence[str],
        split: str | None,
        fractions: Mapping[str, float],
        split_seed: int,
    ) -> None:
        """Load what is small: parameters, outcomes and places of the drapes."""
        columns = {name: [] for name in (
            "index", "fabric", "theta", "status", "orientations", "turns", "intrinsics")}
        places = []
        for name in names:
            with Shard(self.root / name) as shard:
                for column, parts in columns.items():
                    parts.append(shard.column(column))
                places += [(name, row) for row in range(len(shard))]
        table = {name: np.concatenate(parts) for name, parts in columns.items()}
        chosen = np.ones(len(places), dtype=bool)
        if split is not None:
            chosen = split_by_fabric(table["fabric"], fractions=fractions, seed=split_seed) == split
        converged = table["status"] == "converged"
        self.left_out = Counter(table["status"][chosen & ~converged].tolist())
        kept = np.flatnonzero(chosen & converged)
        if self.left_out:
            log.warning("%s: %d drapes left out of %d (%s)", self.root, self.left_out.total(),
                        chosen.sum(), ", ".join(f"{n} {s}" for s, n in self.left_out.items()))
        if not len(kept):
            where = "" if split is None else f" in the split '{split}'"
            raise InputError(f"{self.root} holds no converged drape{where}; generate more drapes")
        self._places = [places[i] for i in kept]
        self.index = table["index"][kept]
        self.fabric = table["fabric"][kept]
        self.theta = table["theta"][kept]
        self.orientations = table["orientations"][kept]
        self.turns = table["turns"][kept]
        self.intrinsics = table["intrinsics"][kept]

    @property
    def drapes(self) -> int:
        """Converged drapes in the split; ``theta``, ``fabric``, ``index`` have a row for each."""
        return len(self._places)

    def set_epoch(self, epoch: int) -> None:
        """Choose the epoch whose randomness the next items have.

        Workers of a DataLoader copy the dataset when they start: call this before iterating,
        and leave ``persistent_workers`` off.
        """
        self.epoch = epoch

    def __len__(self) -> int:
        return self.drapes * self._per_drape

    def __getitem__(self, item: int) -> dict:
        if not 0 <= item < len(self):
            raise IndexError(item)
        drape, turn = divmod(item, self._per_drape)
        name, row = self._places[drape]
        orientation, first, mirror = turn, 0, False
        index = int(self.index[drape])
        if self._augment:
            order = self._generator(index, 0).permutation(self._stored)
            orientation = int(order[turn])
        rng = self._generator(index, 1 + orientation)
        if self._augment:
            first, mirror = ORDERS[rng.integers(len(ORDERS))]
        views = self._shard(name).views(row, orientation)
        if self._noise is not None:
            intrinsics = torch.from_numpy(self.intrinsics[drape, orientation])
            generator = torch.Generator().manual_seed(int(rng.integers(2**63)))
            views = self._noise(torch.from_numpy(views), intrinsics, generator).numpy()
        # After the noise: the intrinsics are those of the pictures before a mirror.
        views = reorder_views(views, first=first, mirror=mirror)
        if self._transform is not None:
            views = self._transform(views)
        # The view that becomes the first was off its quarter turn by this much.
        angle = self.orientations[drape, orientation] + self.turns[drape, orientation, first]
        axis = reorder_axis(angle, first=first, mirror=mirror)
        return {
            "views": views,
            "theta": self.theta[drape].astype(np.float32),
            "orientation": np.float32(axis),
            "fabric": int(self.fabric[drape]),
            "index": index,
        }

    def _generator(self, index: int, purpose: int) -> np.random.Generator:
        return np.random.default_rng([self._seed, self.epoch, index, purpose])

    def _shard(self, name: str) -> Shard:
        """The shard, opened on first use by each process: HDF5 files do not survive a fork."""
        if self._owner != os.getpid():
            self._open, self._owner = {}, os.getpid()
        if name not in self._open:
            if len(self._open) >= OPEN_SHARDS:
                self._open.pop(next(iter(self._open))).close()
            self._open[name] = Shard(self.root / name)
        return self._open[name]

    def __getstate__(self) -> dict:
        return self.__dict__ | {"_open": {}}
