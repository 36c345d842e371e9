"""Training samples rendered from drapes as they are asked for: no picture is shown twice.

A dataset then needs drapes only, a tenth of what it takes with eight stored sets of views, and
all of them stay in memory as whole counts of 10 µm.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch.nn.utils.rnn import pad_sequence

from data.cameras import Camera, CameraRig
from data.dataset import DrapeDataset
from data.rasterise import camera_tensors, render_batch
from data.render import VIEWS
from data.shards import LENGTH_UNIT, Shard
from data.splits import SplitDataset, finished_manifest


@dataclass(frozen=True)
class Shot:
    """How a drape is shown in four views.

    Attributes:
        camera: of all four.
        orientation: direction of the warp in the first view, counter-clockwise from above, rad.
        turns: (4,) what the table has turned beyond k quarter turns in view k, rad.
        mirror: show the drape's mirror image in the plane of warp and gravity. That is a drape of
            the same fabric, whose directions are alike on both sides of the warp.
        seed: of the sensor noise.
    """

    camera: Camera
    orientation: float
    turns: np.ndarray
    mirror: bool = False
    seed: int = 0


class FreshDataset(SplitDataset):
    """Views of a split's drapes, rendered anew for every item of every epoch.

    Orientation, camera, deviations of the turntable, with ``augment`` the mirror image, and noise
    are drawn from the distributions that the dataset was made for. They depend on (seed, epoch,
    drape) only, not on workers or the order of access; but on a GPU the noise of a batch is drawn
    at once, and depends on its first item. The items of a drape in an epoch are stratified over
    the full turn.

    Args:
        root: folder written by :mod:`data.generate`, with or without stored views.
        device: where the drapes are kept and :meth:`batch` is made.
        options: see :class:`data.splits.SplitDataset`, as the items are.

    Attributes:
        device: see above.

    Raises:
        InputError: see :class:`data.splits.SplitDataset`.
    """

    def __init__(
        self, root: str | Path, *, device: torch.device | str = "cpu", **options: object
    ) -> None:
        super().__init__(root, **options)
        self.device = torch.device(device)
        config = self.manifest["config"]
        self._cameras = CameraRig.from_dict(config["cameras"])
        self._turn = config["sampling"]["turn"]
        self._load()
        if self.device.type == "cpu":
            self.batch([0])  # compiled here, or each worker of a loader would do it anew

    def __getitem__(self, item: int) -> dict:
        row = {name: values[0].cpu().numpy() for name, values in self.batch([item]).items()}
        return row | {name: int(row[name]) for name in ("fabric", "index")}

    def batch(self, items: Sequence[int]) -> dict[str, torch.Tensor]:
        """Several items at once; ``views`` on the dataset's device, the rest on the CPU."""
        places = [self._locate(item) for item in items]
        drapes = [drape for drape, _ in places]
        shots = [self._draw(drape, turn) for drape, turn in places]
        axes = np.mod([shot.orientation for shot in shots], np.pi)
        return {
            "views": self.show(drapes, shots),
            "theta": torch.from_numpy(self.theta[drapes].astype(np.float32)),
            "orientation": torch.from_numpy(axes.astype(np.float32)),
            "turns": torch.from_numpy(np.stack([s.turns for s in shots]).astype(np.float32)),
            "fabric": torch.from_numpy(self.fabric[drapes]),
            "index": torch.from_numpy(self.index[drapes]),
        }

    def _draw(self, drape: int, turn: int) -> Shot:
        """What is random in a drape's item ``turn`` of this epoch."""
        rng = self._generator(drape, 1 + turn)
        turns = rng.normal(0.0, self._turn, VIEWS)
        turns[0] = 0.0
        return Shot(
            camera=self._cameras.sample(rng),
            orientation=float((turn + rng.random()) * (2 * np.pi / self._per_drape)),
            turns=turns,
            mirror=self._augment and bool(rng.integers(2)),
            seed=int(rng.integers(2**63)),
        )

    def show(self, drapes: Sequence[int], shots: Sequence[Shot]) -> torch.Tensor:
        """Views (B, 4, H, W) float32, m, of ``drapes`` (rows of ``index``), with noise."""
        intrinsics, poses = camera_tensors([shot.camera for shot in shots], device=self.device)
        angles = np.array([shot.orientation + shot.turns for shot in shots])
        angles += np.arange(VIEWS) * (np.pi / 2)
        picture = self._cameras.intrinsics
        views = render_batch(
            self._drapes(drapes, [shot.mirror for shot in shots]), self._faces(drapes),
            angles=torch.from_numpy(angles).to(self.device), intrinsics=intrinsics,
            world_to_camera=poses, height=picture.height, width=picture.width)
        if self._noise is None:
            return views
        if self.device.type == "cpu":
            # One at a time, as in a dataset of stored views: each has its own small window.
            return torch.stack([
                self._noise(*capture, torch.Generator().manual_seed(shot.seed))
                for *capture, shot in zip(views, intrinsics, shots, strict=True)])
        generator = torch.Generator(self.device).manual_seed(shots[0].seed)
        return self._noise(views, intrinsics, generator)

    def _load(self) -> None:
        """Keep each drape's counts (V, 3) int16, and triangles (F, 3) int32: once for each mesh."""
        self._counts, self._triangles = [], []
        known: dict[bytes, torch.Tensor] = {}
        columns = self._read("vertices", "positions", "mesh").values()
        for file, *parts in zip(self._rows, *columns, strict=True):
            meshes = {}
            with Shard(self.root / file) as shard:
                for mesh in set(parts[-1].tolist()):
                    faces = shard.triangulation(mesh).astype(np.int32)
                    kept = torch.from_numpy(faces).to(self.device)
                    meshes[mesh] = known.setdefault(faces.tobytes(), kept)
            for vertices, positions, mesh in zip(*parts, strict=True):
                # A copy: a part of the array would keep all of it.
                counts = positions[:vertices].copy()
                self._counts.append(torch.from_numpy(counts).to(self.device))
                self._triangles.append(meshes[mesh])

    def _drapes(self, drapes: Sequence[int], mirror: Sequence[bool]) -> torch.Tensor:
        """Vertices (B, V, 3), m, of drapes or their mirror images; zeros follow short rows."""
        counts = pad_sequence([self._counts[drape] for drape in drapes], batch_first=True)
        signs = torch.ones(len(drapes), 1, 3)
        signs[mirror, :, 1] = -1.0
        return counts.float() * LENGTH_UNIT * signs.to(self.device)

    def _faces(self, drapes: Sequence[int]) -> torch.Tensor:
        """Triangles (B, F, 3) of drapes; after short rows such as are a single point."""
        faces = [self._triangles[drape] for drape in drapes]
        return pad_sequence(faces, batch_first=True).long()


def open_views(
    root: str | Path, *, device: torch.device | str = "cpu", **options: object
) -> SplitDataset:
    """The stored views of a dataset where it has them; else views rendered on ``device``.

    Options and errors are those of :class:`data.splits.SplitDataset`.
    """
    if finished_manifest(root)["config"]["sampling"]["orientations"]:
        return DrapeDataset(root, **options)
    return FreshDataset(root, device=device, **options)
