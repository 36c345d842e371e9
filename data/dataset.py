"""Training samples from stored views: one noisy set of four views, its fabric, its orientation."""

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from common.errors import InputError
from data.shards import Shard
from data.splits import SplitDataset
from data.view_order import ORDERS, reorder_axis, reorder_views

OPEN_SHARDS = 32  # files that one process keeps open


class DrapeDataset(SplitDataset):
    """The stored views of a split's drapes, with noise and augmentation drawn anew each epoch.

    With ``augment``, an item starts at a random view, may be a mirror image, and every epoch draws
    anew which stored orientations it visits; without, these are always the first ones.
    Randomness depends on (seed, epoch, drape) only, not on workers or the order of access.

    Args:
        root: folder written by :mod:`data.generate`.
        transform: applied to the views last.
        options: see :class:`data.splits.SplitDataset`, as the items are.

    Raises:
        InputError: as there; or there are fewer stored orientations than are asked for.
    """

    def __init__(
        self,
        root: str | Path,
        *,
        transform: Callable[[np.ndarray], np.ndarray] | None = None,
        **options: object,
    ) -> None:
        super().__init__(root, **options)
        self._transform = transform
        self._stored = self.manifest["config"]["sampling"]["orientations"]
        if not self._stored:
            raise InputError(f"{self.root} holds drapes without views; train with views=fresh, or "
                             "generate a dataset with dataset.orientations=8")
        if self._per_drape > self._stored:
            raise InputError(f"{self._per_drape} orientations of a drape are asked for, but there "
                             f"are {self._stored} stored ones; train.py's views=fresh makes more")
        table = self.columns("orientations", "turns", "intrinsics")
        self.orientations, self.turns, self.intrinsics = table.values()
        self._open: dict[str, Shard] = {}
        self._owner = os.getpid()

    def __getitem__(self, item: int) -> dict:
        drape, turn = self._locate(item)
        name, row = self.places[drape]
        orientation, first, mirror = turn, 0, False
        if self._augment:
            order = self._generator(drape, 0).permutation(self._stored)
            orientation = int(order[turn])
        rng = self._generator(drape, 1 + orientation)
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
            "turns": self.turns[drape, orientation].astype(np.float32),
            "fabric": int(self.fabric[drape]),
            "index": int(self.index[drape]),
        }

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
