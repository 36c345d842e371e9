"""Train a network that cuts cloth out of photographs (data/pictures/cut.py): over a mat, or not.

    python -m data.dataset.cloth data=FOLDER pictures=FOLDER [out=FILE]

FOLDER of ``data`` is a dataset of drapes, finished or not. Each is photographed in random scenes,
once, into ``pictures``, a second a picture. The training goes on from weights ``start``, if any.
Prints errors on fabrics held out. The network is a U-Net (Ronneberger et al. 2015) on squares of
two by two pixels.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import torch
from pydantic import Field
from safetensors.torch import load_file
from torch import nn
from torch.nn.functional import (
    binary_cross_entropy_with_logits,
    interpolate,
    max_pool2d,
    pixel_shuffle,
    pixel_unshuffle,
)

from common.cases import load_arrays, progress_bar, run_cases
from common.command import command
from common.configs import Seed
from common.errors import InputError
from common.files import require_file
from data.dataset.folder import require_dataset
from data.dataset.learning import converged, fit, save
from data.dataset.shards import SHARDS, Shard
from data.pictures.cut import COARSE, FINE, SIDES, ClothView, steps
from data.render.cloth_scenes import scene_of

_WIDTHS = (16, 24, 48, 96, 128)
HELD_OUT = 0.05  # of the fabrics
_BATCH = 8
_GAINS = 0.15, 0.25  # deviations of log light, of each colour and of all
VERSION = 3
"""Of the pictures of a shard: raise it when they change."""


def _block(inputs: int, outputs: int) -> nn.Sequential:
    layers: list[nn.Module] = []
    for width in (inputs, outputs):
        layers += [nn.Conv2d(width, outputs, 3, padding=1, bias=False), nn.BatchNorm2d(outputs),
                   nn.ReLU(inplace=True)]
    return nn.Sequential(*layers)


class ClothNetwork(nn.Module):
    """Log odds that pixels show the specimen."""

    def __init__(self) -> None:
        super().__init__()
        inputs = (4 * FINE + COARSE, *_WIDTHS[:-1])
        self.down = nn.ModuleList(map(_block, inputs, _WIDTHS))
        above = [sum(pair) for pair in zip(_WIDTHS[1:], _WIDTHS[:-1], strict=True)]
        self.up = nn.ModuleList(map(_block, above[::-1], _WIDTHS[-2::-1]))
        self.last = nn.Conv2d(_WIDTHS[0], 4, 1)

    def forward(self, fine: torch.Tensor, coarse: torch.Tensor) -> torch.Tensor:
        """(N, S, S) of ``fine`` (N, FINE, S, S) and ``coarse`` (N, COARSE, S/2, S/2)."""
        values, kept = torch.cat([pixel_unshuffle(fine, 2), coarse], dim=1), []
        for level, block in enumerate(self.down):
            values = block(max_pool2d(values, 2) if level else values)
            kept.append(values)
        for block, finer in zip(self.up, kept[-2::-1], strict=True):
            values = block(torch.cat([interpolate(values, scale_factor=2.0), finer], dim=1))
        return pixel_shuffle(self.last(values), 2)[:, 0]


@dataclass
class ClothConfig:
    """``configs/cloth.yaml``."""

    data: str
    pictures: str
    out: str
    shards: Annotated[int, Field(ge=1)]
    scenes: Annotated[int, Field(ge=1)]
    epochs: Annotated[int, Field(ge=1)]
    workers: Annotated[int, Field(ge=1)]
    on_mat: bool
    start: str
    learning_rate: Annotated[float, Field(gt=0)]
    seed: Seed


@command("cloth", ClothConfig)
def main(config: ClothConfig) -> None:
    """Render, train and write the network; print its errors."""
    root = require_dataset(config.data)
    require_file(Path(config.out))
    folder = Path(config.pictures)
    shards = sorted(root.glob(SHARDS))[:config.shards]
    cases = {shard.stem: {"shard": shard, "scenes": config.scenes, "seed": config.seed}
             for shard in shards}
    run_cases(photographed, cases, folder=folder, workers=config.workers, version=VERSION,
              unit="shard")
    pictures = Pictures.of(folder, list(cases), on_mat=config.on_mat)
    torch.manual_seed(config.seed)
    network = train(pictures, config)
    save(network, Path(config.out), {
        name: torch.randn(2, *one.shape[1:])
        for name, one in (("fine", pictures.fine), ("coarse", pictures.coarse))}, "odds")
    print("\n".join(errors(network, pictures)) + f"\nwritten to {config.out}")


def photographed(*, shard: Path, scenes: int, seed: int) -> dict:
    """Arrays of ``scenes`` pictures of each drape of a shard."""
    drapes = Shard(shard)
    index, rows = drapes.column("index"), list[dict]()
    for row, held_out in converged(drapes, HELD_OUT):
        positions, rest, faces = drapes.mesh(row)
        rig = drapes.rig(row)
        for scene in range(scenes):
            rng = np.random.default_rng([seed, index[row], scene])
            one = scene_of(positions, rest, faces, rig.plate_radius, rig.reach, rng)
            rows.append(one | {"held_out": held_out})
    return {"count": len(rows), "arrays": {name: np.stack([row[name] for row in rows])
                                           for name in (rows[0] if rows else ())}}


@dataclass(frozen=True)
class Pictures:
    """N pictures: inputs of the network and truth (N, S, S), of half precision or of 255, the
    size of a pixel, m, and whether their fabrics are held out."""

    fine: np.ndarray
    coarse: np.ndarray
    cloth: np.ndarray
    pixel: np.ndarray
    held_out: np.ndarray

    @classmethod
    def of(cls, folder: Path, names: list[str], *, on_mat: bool) -> "Pictures":
        """The pictures of the cases of a folder over a mat, or the others."""
        found: list[tuple] = []
        side = SIDES[on_mat]
        for name in progress_bar(names, desc="reading", unit="shard", leave=False):
            arrays = load_arrays(folder, name)
            for row in range(len(arrays.get("cloth", ()))):
                one = {key: values[row] for key, values in arrays.items()}
                if one["on_mat"].any() != on_mat:
                    continue
                off = None if np.isnan(one["off"]).any() else one["off"]
                reach = float(one["reach"])
                picture, printed, paper, covered = (
                    cv2.resize(one[key].astype(np.uint8), (side, side),
                               interpolation=cv2.INTER_AREA)
                    for key in ("picture", "printed", "on_mat", "cloth"))
                view = ClothView(picture, printed, paper > 0, np.zeros((side, side), bool),
                                 float(one["plate"]), reach, off)
                fine, coarse = (part.astype(np.float16) for part in view.channels())
                pixel = np.diff(steps(reach, side))[0]
                found.append((fine, coarse, covered, pixel, one["held_out"]))
        if not found:
            raise InputError(f"{folder} has no pictures to train on; complete more shards")
        return cls(*(np.array(part) for part in zip(*found, strict=True)))

    def batch(self, rows: np.ndarray) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Inputs and truth of pictures."""
        fine, coarse = (torch.from_numpy(part[rows].astype(np.float32))
                        for part in (self.fine, self.coarse))
        return fine, coarse, torch.from_numpy(self.cloth[rows] / np.float32(255))


def train(pictures: Pictures, config: ClothConfig) -> ClothNetwork:
    """A network trained on the pictures of fabrics that are not held out."""
    network, rng = ClothNetwork(), np.random.default_rng(config.seed)
    if config.start:
        network.load_state_dict(load_file(config.start))
    network.to(memory_format=torch.channels_last)
    rows = np.flatnonzero(~pictures.held_out)
    count = len(rows) // _BATCH

    def losses() -> Iterator[torch.Tensor]:
        for _ in range(config.epochs):
            order = rng.permutation(rows)
            for k in range(count):
                fine, coarse, truth = varied(
                    *pictures.batch(order[k * _BATCH:(k + 1) * _BATCH]), rng)
                yield binary_cross_entropy_with_logits(network(fine, coarse), truth)

    fit(network, losses(), config.epochs * count, config.learning_rate, rise=0.1, momentum=True,
        clip=np.inf, decay=0.02)
    return network.eval()


def varied(fine: torch.Tensor, coarse: torch.Tensor, truth: torch.Tensor,
           rng: np.random.Generator) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Inputs (N, C, ...) and truth (N, S, S) turned and mirrored, with other colours, and
    partly unseen."""
    quarter, mirror = int(rng.integers(4)), rng.random() < 0.5
    found = []
    for one in (fine, coarse, truth):
        turned = torch.rot90(one, quarter, (-2, -1))
        found.append((turned.flip(-1) if mirror else turned).contiguous())
    fine, coarse, truth = found
    fine[:, :3] = fine[:, rng.permutation(3)]
    gains = rng.normal(0, _GAINS[0], (len(fine), 3, 1, 1)) + rng.normal(
        0, _GAINS[1], (len(fine), 1, 1, 1))
    fine[:, :3] += torch.from_numpy(gains.astype(np.float32))
    for k in np.flatnonzero(rng.random(len(fine)) < 0.15):  # beyond the picture's border
        cut = 2 * int(rng.integers(1, truth.shape[-1] // 16))
        fine[k, :3, :cut], coarse[k, 1, :cut // 2] = 0.0, 1.0
        truth[k, :cut] = 0.0
    return (fine.contiguous(memory_format=torch.channels_last),
            coarse.contiguous(memory_format=torch.channels_last), truth)


@torch.inference_mode()
def errors(network: ClothNetwork, pictures: Pictures) -> list[str]:
    """Lines: area that is wrong over the length of the hem, mm, of pictures held out."""
    rows = np.flatnonzero(pictures.held_out)
    wrong = []
    for row in rows:
        fine, coarse, truth = pictures.batch(np.array([row]))
        found = (network(fine, coarse)[0] > 0).numpy()
        cloth = truth[0].numpy() > 0.5
        outer, _ = cv2.findContours(cloth.astype(np.uint8), cv2.RETR_EXTERNAL,
                                    cv2.CHAIN_APPROX_NONE)
        length = sum(cv2.arcLength(one, closed=True) for one in outer)
        wrong.append(1e3 * pictures.pixel[row] * float((found != cloth).sum()) / max(length, 1.0))
    if not wrong:
        return ["no picture is held out"]
    shares = "".join(f"{np.quantile(wrong, q):8.2f}" for q in (0.5, 0.9, 0.98))
    return ["pictures   mean distance of the outlines, mm (median, 90 %, 98 %)",
            f"{len(rows):8}{shares}"]


if __name__ == "__main__":
    main()
