"""Captures as stacked depth views, for networks whose input channels are the views."""

from dataclasses import dataclass, replace

import numpy as np
import torch

from data.cameras import CameraRig
from data.setups import Setups
from data.shards import Shard
from drapenet.canonical import AZIMUTHS
from drapenet.maps import Maps
from drapenet.targets import MODULI, Symmetry, TargetScale, targets_of
from drapenet.training import CaptureSet
from studies.networks import Answer

FOUR = (0.0, 0.0, 0.0, 1.0)  # shares of captures with 1, 2, ... views
SHRINK = 3  # pixels of the views to one of 80 x 60
CENTRE, SCALE, BACKGROUND = 0.55, 0.1, 2.0  # m, m, and what lies far behind the cloth
CHANNELS = 5  # four views and the focal length
TARGETS = MODULI + 2  # those of a disc
ONE_ORIENTATION = np.radians(10.0)  # up to which the warp lies aside where it is said to be fixed


def setups(*, fixed: bool = False) -> Setups:
    """Those trained on, but of four views; with ``fixed``, all specimens in one orientation."""
    return replace(Setups.load(), views=FOUR, **(
        {"orientation": (-ONE_ORIENTATION, ONE_ORIENTATION)} if fixed else {}))


def pictures(
    shard: str, rig: str, captures: int, seed: int, dataset: str, fixed: bool
) -> dict:
    """The captures that maps of a shard are made of (:func:`drapenet.maps.make_maps`), as arrays.

    ``views`` (N, 4, 60, 80) float16, see :func:`shrunk`; ``focal`` (N,), relative to the nominal
    one, less 1; ``orientation`` (N,) of the warp in the first view, rad. ``dataset`` says what the
    shard holds.
    """
    drawn, nominal = setups(fixed=fixed), CameraRig.load(rig).intrinsics
    views, focal, orientation = [], [], []
    drapes = Shard(shard)
    index = drapes.column("index")
    for row in np.flatnonzero(drapes.column("status") == "converged"):
        positions, _, faces = drapes.mesh(row)
        for number in range(captures):
            rng = np.random.default_rng([seed, int(index[row]), number])  # as maps have it
            seen = drawn.capture(positions, faces, rng, nominal=nominal)
            views.append(shrunk(seen.views))
            focal.append(seen.intrinsics.fx / nominal.fx - 1)
            orientation.append(seen.orientation)
    return {"dataset": dataset, "arrays": {
        "views": np.array(views).reshape(len(focal), 4, -1, nominal.width // SHRINK),
        "focal": np.array(focal), "orientation": np.array(orientation)}}


def shrunk(views: np.ndarray) -> np.ndarray:
    """(K, H/3, W/3) float16 without unit, of views (K, H, W), m: means where most is cloth."""
    blocks = views.reshape(len(views), views.shape[1] // SHRINK, SHRINK, -1, SHRINK)
    cloth = (blocks > 0).sum(axis=(2, 4))
    depth = blocks.sum(axis=(2, 4)) / np.maximum(cloth, 1)
    return np.where(2 * cloth > SHRINK**2, (depth - CENTRE) / SCALE, BACKGROUND).astype(np.float16)


def turned(views: torch.Tensor, symmetry: Symmetry) -> torch.Tensor:
    """Views (N, 4, H, W) of specimens in other quarter turns, or reflected first."""
    order = torch.arange(4) + symmetry.cells[:, None] // (AZIMUTHS // 4)
    order = torch.where(symmetry.mirror[:, None], -order, order) % 4
    views = views[torch.arange(len(views))[:, None], order]
    return torch.where(symmetry.mirror[:, None, None, None], views.flip(-1), views)


@dataclass(frozen=True)
class StackedBatch:
    """Pictures (N, 5, H, W) and standardised targets (N, 8)."""

    pictures: torch.Tensor
    targets: torch.Tensor

    def through(self, network: torch.nn.Module) -> Answer:
        """What the network answers."""
        return network(self.pictures)


class StackedSet(CaptureSet):
    """Pictures of captures with standardised targets: a disc's, for whatever specimen.

    Args:
        maps: of the same captures.
        views, focal, orientation: see :func:`pictures`.
        scale: of the targets; None: of these captures.
    """

    def __init__(self, maps: Maps, views: np.ndarray, focal: np.ndarray, orientation: np.ndarray,
                 *, scale: TargetScale | None = None) -> None:
        self.maps, self.disc = maps, False  # pictures can be shown in quarter turns only
        self.views, self.focal = torch.from_numpy(views), torch.from_numpy(focal).float()
        targets = targets_of(maps.theta, orientation, disc=True)
        self.scale = scale or TargetScale.fit(targets, disc=True)
        self.targets = torch.from_numpy(self.scale.encode(targets)).float()

    def batch(
        self, rows: np.ndarray, *, revealed: np.ndarray, symmetry: Symmetry | None = None
    ) -> StackedBatch:
        """As for maps, but that nothing is ``revealed``."""
        views, targets = self.views[rows].float(), self.targets[rows]
        if symmetry is not None:
            views, targets = turned(views, symmetry), symmetry.of_targets(targets, disc=True)
        focal = self.focal[rows, None, None, None].expand(-1, 1, *views.shape[2:])
        return StackedBatch(torch.cat([views, focal], dim=1), targets)
