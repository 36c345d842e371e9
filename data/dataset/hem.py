"""Train the network that says where an outline is not one that cloth has (data/captures/hem.py).

    python -m data.dataset.hem data=FOLDER [out=FILE]

FOLDER is a dataset of drapes, finished or not. Each drape is seen from above or beside, and half of
the outlines are misread: shadows, paper and feet are taken for cloth, borders and stripes for
ground. Half an hour on one core for 8000 drapes. Prints how the errors found agree with the true
ones on fabrics held out. All lengths are over the specimen's size.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
from pydantic import Field
from scipy.ndimage import gaussian_filter1d
from torch import nn
from torch.nn.functional import conv1d, gelu, pad

from common.cases import progress_bar
from common.command import command
from common.configs import Seed
from common.errors import InputError
from common.files import require_file
from common.graph_export import save_graph, save_weights
from common.graphs import SUFFIX
from data.captures.hem import USUAL
from data.captures.off_axis import AZIMUTH, AZIMUTHS
from data.dataset.folder import over_shards, require_dataset, split_by_fabric
from data.dataset.off_axis import HELD_OUT, silhouette
from data.dataset.shards import SHARDS, Shard
from sim.mesh import Mesh

_WIDTH, _KERNEL, _DILATIONS = 32, 5, (1, 2, 4, 8, 16, 1)
_SMOOTH = ((3.0, 100.0), (10.0, 20.0))  # azimuths, and factors of what is finer
_BATCH, _RATE = 32, 3e-3  # largest learning rate
HEIGHTS, LEAN = (0.4, 1.5), 0.3  # m, of cameras above the plate; farthest place beside over height
FAULTS = (0, 0, 0, 1, 1, 2)  # of an outline, one as often as another
_MM = 1 / 300  # of a usual specimen
_BLUR, _NOISE, _EVEN = (0.3, 2.0), (0.15, 0.5), (2.0, 6.0)  # mm, of all that is read
_WIDE, _SIDES, _RAGGED = (1.0, 150.0), (0.3, 10.0), (0.5, 8.0)  # mm, along the hem, of faults
_DEEP, _PERIOD = 15.0, (8.0, 40.0)  # mm


class HemNetwork(nn.Module):
    """Errors of radii from their course around an outline, by two azimuths in a column."""

    def __init__(self) -> None:
        super().__init__()
        self.first, *layers = (
            nn.Conv1d(inputs, _WIDTH, _KERNEL, dilation=step, padding="same",
                      padding_mode="circular")
            for inputs, step in ((8, 1), *((_WIDTH, step) for step in _DILATIONS)))
        self.layers = nn.ModuleList(layers)
        self.last = nn.Conv1d(_WIDTH, 2, 1)
        for value in self.last.parameters():
            nn.init.zeros_(value)

    def forward(self, radius: torch.Tensor, plate: torch.Tensor, reach: torch.Tensor
                ) -> torch.Tensor:
        """Logarithm (N, AZIMUTHS) of the errors, in units of :data:`USUAL`, of radii (N, AZIMUTHS),
        of plates and of the flat specimens' reaches (N,)."""
        about = radius - radius.mean(dim=1, keepdim=True)  # rounding errors count a hundredfold
        parts = [8 * radius - 3, *(factor * (about - _smoothed(about, width))
                                   for width, factor in _SMOOTH)]
        columns = [part[:, first::2] for part in parts for first in (0, 1)]
        same = [value[:, None].expand_as(columns[0]) for value in (4 * plate - 1, 4 * reach - 2)]
        values = gelu(self.first(torch.stack(columns + same, dim=1)))
        for layer in self.layers:
            values = values + gelu(layer(values))
        return self.last(values).transpose(1, 2).flatten(1)


def _smoothed(radius: torch.Tensor, width: float) -> torch.Tensor:
    reach = round(3 * width)
    weights = torch.exp(-(torch.arange(-reach, reach + 1) / width).square() / 2)
    around = pad(radius[:, None], (reach, reach), mode="circular")
    return conv1d(around, (weights / weights.sum())[None, None])[:, 0]


def misread(radius: np.ndarray, plate: float, rng: np.random.Generator) -> np.ndarray:
    """Radii (AZIMUTHS,) as a picture may be read, of true ones and their plate's, in sizes."""
    arc = 2 * np.pi * float(radius.mean()) / AZIMUTHS / _MM  # mm

    def even(values: np.ndarray, span: tuple[float, float]) -> np.ndarray:
        width = np.exp(rng.uniform(*np.log(span))) / arc
        return gaussian_filter1d(np.asarray(values, float), width, mode="wrap")

    def uneven(span: tuple[float, float]) -> np.ndarray:
        values = even(rng.standard_normal(AZIMUTHS), span)
        return values / values.std()

    found = even(radius, _BLUR)
    for _ in range(rng.choice(FAULTS)):
        azimuth = AZIMUTH - rng.choice(AZIMUTH)
        far = np.abs((azimuth + np.pi) % (2 * np.pi) - np.pi) / AZIMUTH[1] * arc
        inside = even(far < np.exp(rng.uniform(*np.log(_WIDE))), _SIDES)
        if rng.random() < 0.3:  # the edge of paper, a square or round foot, a filled valley
            corner = np.pi / rng.choice([1, 4, AZIMUTHS])
            outwards = np.cos((azimuth + corner) % (2 * corner) - corner)
            edge = rng.uniform(found.min(), found.max()) / np.maximum(outwards, 0.3)
            found = found + inside * np.where(edge < 1.1 * found.max(),
                                              np.maximum(edge - found, 0), 0)
            continue
        if rng.random() < 0.3:  # stripes
            period, share = rng.uniform(*_PERIOD) * _MM, rng.uniform(0.3, 0.6)
            inside = inside * even(np.cos(azimuth) * found % period < share * period, (0.3, 2.0))
        depth = rng.choice([-1, 1]) * np.exp(rng.uniform(0, np.log(_DEEP))) * _MM
        found = found + inside * depth * (rng.choice([0, 1, 1]) + rng.uniform(0, 0.7) * uneven(
            _RAGGED))
    return np.maximum(found, 0.97 * plate) + _MM * rng.uniform(*_NOISE) * uneven(_EVEN)


@dataclass
class HemConfig:
    """``configs/hem.yaml``."""

    data: str
    out: str
    drapes: Annotated[int, Field(ge=1)]
    steps: Annotated[int, Field(ge=1)]
    seed: Seed


@command("hem", HemConfig)
def main(config: HemConfig) -> None:
    """Train and write the network; print how its errors agree with the true ones."""
    root, file = require_dataset(config.data), Path(config.out)
    require_file(file)
    torch.set_num_threads(1)
    torch.manual_seed(config.seed)
    outlines, held_out = see(root, config)
    network = train(outlines[~held_out], config)
    save_weights(file, network, half=True)
    half, turn = torch.full((2,), 0.5), torch.tensor(AZIMUTH, dtype=torch.float32)
    folded = 0.4 + torch.tensor([[0.0], [0.03]]) * torch.cos(8 * turn)
    save_graph(file.with_suffix(SUFFIX), network, [
        ("radius", "n", folded), ("plate", "n", 0.6 * half), ("reach", "n", half)],
        ["log_error"], identity=file.stem)
    print(f"{agreement(network, outlines[held_out], config)}\nwritten to {file}")


def see(root: Path, config: HemConfig) -> tuple[np.ndarray, np.ndarray]:
    """Radii as seen, plate's radius and reach of each drape (N, AZIMUTHS + 2), in sizes, and which
    are held out."""
    rows: list[np.ndarray] = []
    held_out: list[bool] = []
    for path in over_shards(sorted(root.glob(SHARDS)), "reading"):
        shard = Shard(path)
        index, split = shard.column("index"), split_by_fabric(
            shard.column("fabric"), fractions={"training": 1 - HELD_OUT, "held out": HELD_OUT})
        usable = (shard.column("status") == "converged") & (index < config.drapes)
        for row in np.flatnonzero(usable):
            positions, rest, faces = shard.mesh(row)
            rig, rng = shard.rig(row), np.random.default_rng([config.seed, index[row]])
            height, turn = rng.uniform(*HEIGHTS), rng.uniform(0, 2 * np.pi)
            beside = height * rng.uniform(0, LEAN) * np.array([np.cos(turn), np.sin(turn)])
            seen = silhouette(positions, Mesh(rest, faces).edges, beside, height, azimuths=AZIMUTHS)
            rows.append(np.append(seen, [rig.plate_radius, rig.reach]) / rig.specimen_size)
            held_out.append(split[row] == "held out")
    if all(held_out):
        raise InputError(f"{root} has no drapes to train on; complete more of its shards")
    return np.array(rows), np.array(held_out)


def _read(
    outlines: np.ndarray, rng: np.random.Generator
) -> tuple[list[torch.Tensor], torch.Tensor]:
    """Inputs of the network, of outlines that are misread, and the errors of their radii."""
    radius = np.array([np.roll(one, rng.integers(AZIMUTHS))[::rng.choice([-1, 1])]
                       for one in outlines[:, :AZIMUTHS]])
    plate, reach = outlines[:, AZIMUTHS:].T
    found = np.array([misread(one, edge, rng) for one, edge in zip(radius, plate, strict=True)])
    *inputs, off = (torch.tensor(part, dtype=torch.float32)
                    for part in (found, plate, reach, found - radius))
    return inputs, off


def _unlikely(log_error: torch.Tensor, off: torch.Tensor) -> torch.Tensor:
    """Mean negative log likelihood of errors, of which none counts as beyond 20 deviations."""
    return (log_error + (off / USUAL / log_error.exp()).clamp(-20, 20).square() / 2).mean()


def train(outlines: np.ndarray, config: HemConfig) -> HemNetwork:
    """A network trained on misread outlines."""
    network, rng = HemNetwork(), np.random.default_rng(config.seed)
    optimiser = torch.optim.AdamW(network.parameters())
    rates = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, _RATE, total_steps=config.steps + 1, pct_start=0.05, cycle_momentum=False)
    for _ in progress_bar(range(config.steps), desc="training", unit="step", leave=False):
        inputs, off = _read(rng.choice(outlines, _BATCH), rng)
        loss = _unlikely(network(*inputs), off)
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimiser.step()
        rates.step()
    return network


@torch.inference_mode()
def agreement(network: HemNetwork, outlines: np.ndarray, config: HemConfig) -> str:
    """The correlation of the logarithms of errors found and true, of outlines held out."""
    inputs, off = _read(outlines, np.random.default_rng(config.seed))
    found, true = network(*inputs), (off.abs() + 0.2 * _MM).log()
    together = torch.corrcoef(torch.stack([found.flatten(), true.flatten()]))[0, 1]
    return f"{len(outlines)} outlines held out: correlation of log errors {together:.2f}"


if __name__ == "__main__":
    main()
