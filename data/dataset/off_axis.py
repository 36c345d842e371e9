"""Train the network that reads outlines from beside the axis (data/captures/off_axis.py).

    python -m data.dataset.off_axis data=FOLDER [out=FILE]

FOLDER is a dataset of drapes, finished or not. Each drape is seen by random cameras beside the axis
and on it, on one core in ten minutes for 8000 drapes. Prints the errors on fabrics held out.

All lengths are over the specimen's size, so that the network serves testers of any size.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import torch
from pydantic import Field
from torch.nn.functional import conv1d, pad

from common.command import command
from common.types import Edges, Metres, Points
from data.captures.off_axis import AZIMUTHS as SAMPLES
from data.captures.off_axis import MAX_LEAN
from data.dataset.learning import Around, LearningConfig, first_drapes, fit, save
from sim.mesh import Mesh
from sim.outlines import farthest

AZIMUTHS = 360
"""Of the outlines that the network has learned, equally spaced from 0 on."""
_COLUMNS = 180  # of its layers
_TURN, _STEP = 0.5, 0.2  # rad and sizes for an output of 1, per place beside the axis over height
HELD_OUT = 0.1  # of the fabrics
HEIGHTS = (1.0, 7.5)  # of cameras above the plate, in sizes of the specimen
FARTHEST = 0.65  # place beside the axis over height
BANDS = (0.0, MAX_LEAN, 0.2, 0.35, FARTHEST)  # of it, for the errors printed
NOISE = 3e-4  # m, of each radius read
_BATCH, _RATE = 64, 4e-3  # largest learning rate
_LEAST_LEAN, _LEAST_HANG = 0.03, 0.04  # added in the loss's denominators


class Seen(NamedTuple):
    """N outlines as seen, in sizes of their specimens.

    Attributes:
        radius: (N, A) on the plane of the plate, A a multiple of 180.
        border: (N, A) of the flat specimen at the same azimuths.
        plate: (N,) radius of the plate.
        height: (N,) of the camera above the plate.
        lean: (N, 2) place of the camera beside the axis over its height.
    """

    radius: torch.Tensor
    border: torch.Tensor
    plate: torch.Tensor
    height: torch.Tensor
    lean: torch.Tensor


class OffAxisNetwork(Around):
    """Moves an outline along azimuth and radius, in proportion to the camera's place beside the
    axis: none where the camera is on it."""

    def __init__(self) -> None:
        super().__init__(7, (1, 2, 4, 8, 16))

    def forward(self, radius: torch.Tensor, border: torch.Tensor, plate: torch.Tensor,
                height: torch.Tensor, lean: torch.Tensor) -> torch.Tensor:
        """Radii (N, A), in sizes (m/m), of the outlines from the axis, of the parts of
        :class:`Seen`."""
        seen, count = Seen(radius, border, plate, height, lean), radius.shape[1]
        far = lean.norm(dim=1, keepdim=True)
        turn, step = _spread(self.outputs(_columns(seen)), count).unbind(1)
        place = torch.arange(count) + far * turn * (_TURN * count / (2 * torch.pi))
        return _between(radius, place) + far * step * _STEP


def _columns(seen: Seen) -> list[torch.Tensor]:
    """Inputs (N, _COLUMNS) of the layers."""
    azimuth = torch.arange(_COLUMNS) * (2 * torch.pi / _COLUMNS)
    cos, sin = torch.cos(azimuth), torch.sin(azimuth)
    x, y = seen.lean[:, :1], seen.lean[:, 1:]
    radius, border = _pooled(seen.radius), _pooled(seen.border)
    same = [(2 * value - 1)[:, None].expand_as(radius)
            for value in (2 * seen.plate, 1 / seen.height, 2 * seen.lean.norm(dim=1))]
    return [8 * radius - 3, 4 * border - 2, *same, 3 * (x * cos + y * sin),
            3 * (y * cos - x * sin)]


def _pooled(values: torch.Tensor) -> torch.Tensor:
    """(N, _COLUMNS) of (N, A): means weighted by the distance from each column."""
    step = values.shape[1] // _COLUMNS
    weights = 1 - torch.arange(1 - step, step).abs() / step
    padded = pad(values[:, None], (step - 1, step - 1), mode="circular")
    return conv1d(padded, (weights / weights.sum())[None, None], stride=step)[:, 0]


def _spread(values: torch.Tensor, count: int) -> torch.Tensor:
    """(N, C, ``count``) of (N, C, _COLUMNS), linearly between the columns."""
    place = (torch.arange(count) * (_COLUMNS / count)).expand(*values.shape[:2], -1)
    return _between(values, place)


def _between(values: torch.Tensor, place: torch.Tensor) -> torch.Tensor:
    """``values`` (..., A) around an outline at ``place`` (..., B), in samples, linearly."""
    count, low = values.shape[-1], place.detach().floor()
    part, index = place - low, low.long()
    return (torch.gather(values, -1, index % count) * (1 - part)
            + torch.gather(values, -1, (index + 1) % count) * part)


@dataclass
class OffAxisConfig(LearningConfig):
    """``configs/off_axis.yaml``."""

    cameras: Annotated[int, Field(ge=1)]


@dataclass(frozen=True)
class Pairs:
    """Outlines of drapes from beside the axis, with noise, and from it, float32, in sizes of the
    specimen; ``size``: (N,) m; ``held_out``: (N,) bool."""

    seen: Seen
    radius: torch.Tensor
    size: torch.Tensor
    held_out: np.ndarray

    def rows(self, chosen: np.ndarray) -> tuple[Seen, torch.Tensor]:
        """The outlines seen, and from the axis, of the rows (M,)."""
        return Seen(*(part[chosen] for part in self.seen)), self.radius[chosen]


@command("off_axis", OffAxisConfig)
def main(config: OffAxisConfig) -> None:
    """Train and write the network; print its errors."""
    pairs = see(config.begin(), config)
    network = train(pairs, config)
    one = torch.full((2,), 0.3)
    azimuth = torch.arange(SAMPLES) * (2 * torch.pi / SAMPLES)
    folds = torch.cos(azimuth * torch.tensor([[4], [7]]))
    save(network, Path(config.out), {
        "radius": 0.35 + 0.1 * folds, "border": 0.5 + 0.1 * folds, "plate": one,
        "height": 10 * one, "lean": 0.1 * torch.rand(2, 2)}, "from_axis")
    print("\n".join(errors(network, pairs)) + f"\nwritten to {config.out}")


def see(root: Path, config: OffAxisConfig) -> Pairs:
    """The first drapes of a dataset, each seen by random cameras."""
    rows: list[tuple] = []
    azimuth = np.arange(AZIMUTHS) * (2 * np.pi / AZIMUTHS)
    for shard, row, index, unseen in first_drapes(root, config.drapes, HELD_OUT):
        positions, rest, faces = shard.mesh(row)
        edges, rig = Mesh(rest, faces).edges, shard.rig(row)
        rng, size = np.random.default_rng([config.seed, index]), rig.specimen_size
        for _ in range(config.cameras):
            height = np.exp(rng.uniform(*np.log(HEIGHTS)))
            lean = FARTHEST * rng.uniform() ** 1.5  # most cameras are near to the axis
            turn = rng.uniform(0, 2 * np.pi)
            lean = lean * np.array([np.cos(turn), np.sin(turn)])
            seen, radius = (silhouette(positions, edges, size * height * place, size * height)
                            for place in (lean, np.zeros(2)))
            seen += rng.normal(0, NOISE, AZIMUTHS)
            rows.append((seen / size, rig.border(azimuth) / size, rig.plate_radius / size,
                         height, lean, radius / size, size, unseen))
    parts = [np.array(part) for part in zip(*rows, strict=True)]
    held_out = parts.pop()
    *seen, radius, size = (torch.tensor(part, dtype=torch.float32) for part in parts)
    return Pairs(Seen(*seen), radius, size, held_out)


def silhouette(
    positions: Points, edges: Edges, beside: np.ndarray, height: Metres, *, azimuths: int = AZIMUTHS
) -> np.ndarray:
    """Radii (azimuths,), m, of a drape's outline on the plane of the plate from a camera at
    ``height`` above it and at the place ``beside`` (2,), m, from the axis."""
    depth = -positions[:, 2:]
    flat = (height * positions[:, :2] + depth * beside) / (height + depth)
    return farthest(flat[edges], azimuths)


def train(pairs: Pairs, config: OffAxisConfig) -> OffAxisNetwork:
    """A network trained on the drapes that are not held out."""
    network, rng = OffAxisNetwork(), np.random.default_rng(config.seed)
    rows = np.flatnonzero(~pairs.held_out)

    def losses() -> Iterator[torch.Tensor]:
        for step in range(config.steps):
            seen, radius = pairs.rows(rng.choice(rows, _BATCH))
            if step % 2:
                seen, radius = mirrored(seen, radius)
            # An error counts the more, the shorter the part that is seen beyond the plate: of limp
            # cloth, small differences matter.
            unit = ((seen.lean.norm(dim=1) + _LEAST_LEAN)
                    * (radius.mean(dim=1) - seen.plate + _LEAST_HANG))
            error = (network(*seen) - radius) / unit[:, None]
            area = (error * radius).mean(dim=1) / radius.mean(dim=1)
            yield (error.square().mean(dim=1) + 1e-5).sqrt().mean() + area.abs().mean()

    fit(network, losses(), config.steps, _RATE)
    return network


def mirrored(seen: Seen, radius: torch.Tensor) -> tuple[Seen, torch.Tensor]:
    """The same outlines, and ``radius`` (N, AZIMUTHS) in sizes, reflected in the axis of x."""
    back = -torch.arange(AZIMUTHS) % AZIMUTHS
    return seen._replace(radius=seen.radius[:, back], border=seen.border[:, back],
                         lean=seen.lean * torch.tensor([1.0, -1.0])), radius[:, back]


@torch.inference_mode()
def errors(network: OffAxisNetwork, pairs: Pairs) -> list[str]:
    """Lines of a table: rms errors of outlines of the fabrics held out, without and with it."""
    rows = np.flatnonzero(pairs.held_out)
    seen, radius = pairs.rows(rows)
    found = torch.cat([network(*(part[k:k + _BATCH] for part in seen))
                       for k in range(0, len(rows), _BATCH)])
    raw, left = (1e3 * pairs.size[rows].numpy() * (part - radius).square().mean(1).sqrt().numpy()
                 for part in (seen.radius, found))
    lean = seen.lean.norm(dim=1).numpy()
    lines = ["place/height   outlines   as seen, rms mm (median, 90 %)   from the axis"]
    for low, high in pairwise(BANDS):
        inside = (lean >= low) & (lean < high)
        if inside.any():
            figures = [np.quantile(part[inside], (0.5, 0.9)) for part in (raw, left)]
            lines.append(f"{low:4.2f} to {high:4.2f}{inside.sum():11}" + "".join(
                f"{a:16.2f}{b:7.2f}" for a, b in figures))
    return lines


if __name__ == "__main__":
    main()
