"""Captures as stacked depth views, for networks whose input channels are the views."""

from dataclasses import dataclass, replace

import numpy as np
import torch

from data.dataset.shards import Shard
from data.render.cameras import nominal_camera
from data.render.setups import Setups
from drapenet.network.dataset import Maps
from drapenet.network.targets import MODULI, Symmetry, TargetScale, targets_of
from drapenet.network.training import CaptureSet
from drapenet.views.directions import AZIMUTHS
from experiments.papers.networks import Prediction
from sim.rig import Rig

VIEW_SHARES = (0.0, 0.0, 0.0, 1.0)  # shares of captures with 1, 2, ... views
BLOCK = 3  # from 240 x 180 to 80 x 60 pixels
CENTRE, SCALE, BACKGROUND = 0.55, 0.1, 2.0  # m, m, scaled depth far behind the cloth
CHANNELS = 5  # four views and the focal length
TARGETS = MODULI + 2  # those of a disc
FIXED_RANGE = np.radians(10.0)  # largest angle of the warp where the orientation is fixed


def setups(*, fixed: bool = False) -> Setups:
    """Set-ups of training with four views; with ``fixed``, all specimens in one orientation."""
    return replace(Setups.load(), views=VIEW_SHARES, **(
        {"orientation": (-FIXED_RANGE, FIXED_RANGE)} if fixed else {}))


def capture_views(
    shard: str, rig: str, captures: int, seed: int, dataset: str, fixed: bool
) -> dict:
    """Capture a shard as :func:`drapenet.network.dataset.make_maps` does, and store the views as
    arrays.

    ``views`` (N, 4, 60, 80) float16, see :func:`downsample`; ``focal`` (N,), relative to the
    nominal focal length, less 1; ``orientation`` (N,) of the warp in the first view, rad.
    ``dataset`` is the digest of the drapes, a part of the key of the stored result.
    """
    distribution, tester = setups(fixed=fixed), Rig.from_name(rig)
    nominal = nominal_camera(tester)
    views, focal, orientation = [], [], []
    drapes = Shard(shard)
    index = drapes.column("index")
    for row in np.flatnonzero(drapes.column("status") == "converged"):
        positions, _, faces = drapes.mesh(row)
        for number in range(captures):
            rng = np.random.default_rng([seed, int(index[row]), number])  # as in make_maps
            capture = distribution.capture(positions, faces, rng, rig=tester)
            views.append(downsample(capture.views))
            focal.append(capture.intrinsics.fx / nominal.fx - 1)
            orientation.append(capture.orientation)
    return {"dataset": dataset, "arrays": {
        "views": np.array(views).reshape(len(focal), 4, -1, nominal.width // BLOCK),
        "focal": np.array(focal), "orientation": np.array(orientation)}}


def downsample(views: np.ndarray) -> np.ndarray:
    """Scaled means (K, H/3, W/3) float16 of views (K, H, W), m, of blocks that are mostly cloth."""
    blocks = views.reshape(len(views), views.shape[1] // BLOCK, BLOCK, -1, BLOCK)
    cloth = (blocks > 0).sum(axis=(2, 4))
    depth = blocks.sum(axis=(2, 4)) / np.maximum(cloth, 1)
    return np.where(2 * cloth > BLOCK**2, (depth - CENTRE) / SCALE, BACKGROUND).astype(np.float16)


def apply_symmetry(views: torch.Tensor, symmetry: Symmetry) -> torch.Tensor:
    """Views (N, 4, H, W) of the specimens after ``symmetry``, in quarter turns."""
    order = torch.arange(4) + symmetry.cells[:, None] // (AZIMUTHS // 4)
    order = torch.where(symmetry.mirror[:, None], -order, order) % 4
    views = views[torch.arange(len(views))[:, None], order]
    return torch.where(symmetry.mirror[:, None, None, None], views.flip(-1), views)


@dataclass(frozen=True)
class StackedBatch:
    """Images (N, 5, H, W) and standardised targets (N, 8)."""

    images: torch.Tensor
    targets: torch.Tensor

    def through(self, network: torch.nn.Module) -> Prediction:
        """Prediction of the network."""
        return network(self.images)


class StackedSet(CaptureSet):
    """Stacked views of captures, with the standardised targets of a disc for all specimens.

    Args:
        maps: of the same captures.
        views, focal, orientation: see :func:`capture_views`.
        scale: of the targets; None: fitted to these captures.
    """

    def __init__(self, maps: Maps, views: np.ndarray, focal: np.ndarray, orientation: np.ndarray,
                 *, scale: TargetScale | None = None) -> None:
        self.maps, self.disc = maps, False  # quarter turns are the only rotations
        self.views, self.focal = torch.from_numpy(views), torch.from_numpy(focal).float()
        targets = targets_of(maps.theta, orientation, disc=True)
        self.scale = scale or TargetScale.fit(targets, disc=True)
        self.targets = torch.from_numpy(self.scale.encode(targets)).float()

    def batch(
        self, rows: np.ndarray, *, revealed: np.ndarray, symmetry: Symmetry | None = None
    ) -> StackedBatch:
        """Batch of the captures ``rows``; ``revealed`` is ignored."""
        views, targets = self.views[rows].float(), self.targets[rows]
        if symmetry is not None:
            views = apply_symmetry(views, symmetry)
            targets = symmetry.of_targets(targets, disc=True)
        focal = self.focal[rows, None, None, None].expand(-1, 1, *views.shape[2:])
        return StackedBatch(torch.cat([views, focal], dim=1), targets)
