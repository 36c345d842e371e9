"""Train the network that reads outlines from beside the axis (data/captures/off_axis.py).

    python -m data.dataset.off_axis data=FOLDER [out=FILE]

FOLDER is a dataset of drapes, finished or not. Each drape is seen by random cameras beside the axis
and on it, on one core in ten minutes for 8000 drapes. Prints the errors on fabrics held out.
"""

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
from pydantic import Field

from common.cases import progress_bar
from common.command import command
from common.configs import Seed
from common.errors import InputError
from common.files import require_file
from common.graph_export import save_graph, save_weights
from common.graphs import SUFFIX
from common.types import Edges, Metres, Points
from data.captures.off_axis import AZIMUTHS as SAMPLES
from data.captures.off_axis import MAX_LEAN
from data.captures.off_axis_network import AZIMUTHS, OffAxisNetwork, Seen
from data.dataset.folder import over_shards, require_dataset, split_by_fabric
from data.dataset.shards import SHARDS, Shard
from sim.mesh import Mesh
from sim.outlines import farthest

HELD_OUT = 0.1  # of the fabrics
HEIGHTS = (1.0, 7.5)  # of cameras above the plate, in sizes of the specimen
FARTHEST = 0.65  # place beside the axis over height
BANDS = (0.0, MAX_LEAN, 0.2, 0.35, FARTHEST)  # of it, for the errors printed
NOISE = 3e-4  # m, of each radius read
_BATCH, _RATE = 64, 4e-3  # largest learning rate
_LEAST_LEAN, _LEAST_HANG = 0.03, 0.04  # added in the loss's denominators


@dataclass
class OffAxisConfig:
    """``configs/off_axis.yaml``."""

    data: str
    out: str
    drapes: Annotated[int, Field(ge=1)]
    cameras: Annotated[int, Field(ge=1)]
    steps: Annotated[int, Field(ge=1)]
    seed: Seed


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
    root = require_dataset(config.data)
    require_file(Path(config.out))
    torch.set_num_threads(1)
    torch.manual_seed(config.seed)
    pairs = see(root, config)
    network = train(pairs, config)
    save(network, Path(config.out))
    print("\n".join(errors(network, pairs)) + f"\nwritten to {config.out}")


def save(network: OffAxisNetwork, file: Path) -> None:
    """Write weights and graph."""
    save_weights(file, network, half=True)
    one = torch.full((2,), 0.3)
    azimuth = torch.arange(SAMPLES) * (2 * torch.pi / SAMPLES)
    folds = torch.cos(azimuth * torch.tensor([[4], [7]]))
    save_graph(file.with_suffix(SUFFIX), network, [
        ("radius", "n", 0.35 + 0.1 * folds), ("border", "n", 0.5 + 0.1 * folds),
        ("plate", "n", one), ("height", "n", 10 * one), ("lean", "n", 0.1 * torch.rand(2, 2))],
        ["from_axis"],
        identity=file.stem)


def see(root: Path, config: OffAxisConfig) -> Pairs:
    """The first drapes of a dataset, each seen by random cameras."""
    rows: list[tuple] = []
    azimuth = np.arange(AZIMUTHS) * (2 * np.pi / AZIMUTHS)
    for path in over_shards(sorted(root.glob(SHARDS)), "reading"):
        shard = Shard(path)
        index, split = shard.column("index"), split_by_fabric(
            shard.column("fabric"), fractions={"training": 1 - HELD_OUT, "held out": HELD_OUT})
        if index[0] >= config.drapes:
            break
        usable = (shard.column("status") == "converged") & (index < config.drapes)
        for row in np.flatnonzero(usable):
            positions, rest, faces = shard.mesh(row)
            edges, rig = Mesh(rest, faces).edges, shard.rig(row)
            rng, size = np.random.default_rng([config.seed, index[row]]), rig.specimen_size
            for _ in range(config.cameras):
                height = np.exp(rng.uniform(*np.log(HEIGHTS)))
                # Most cameras are near to the axis.
                lean = FARTHEST * rng.uniform() ** 1.5
                turn = rng.uniform(0, 2 * np.pi)
                lean = lean * np.array([np.cos(turn), np.sin(turn)])
                seen, radius = (silhouette(positions, edges, size * height * place, size * height)
                                for place in (lean, np.zeros(2)))
                seen += rng.normal(0, NOISE, AZIMUTHS)
                rows.append((seen / size, rig.border(azimuth) / size, rig.plate_radius / size,
                             height, lean, radius / size, size, split[row] == "held out"))
    if all(row[-1] for row in rows):
        raise InputError(f"{root} has no drapes to train on; complete more of its shards")
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
    optimiser = torch.optim.AdamW(network.parameters())
    rates = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, _RATE, total_steps=config.steps + 1, pct_start=0.05, cycle_momentum=False)
    rows = np.flatnonzero(~pairs.held_out)
    for step in progress_bar(range(config.steps), desc="training", unit="step", leave=False):
        seen, radius = pairs.rows(rng.choice(rows, _BATCH))
        if step % 2:
            seen, radius = mirrored(seen, radius)
        found = network(*seen)
        # An error counts the more, the shorter the part that is seen beyond the plate: of limp
        # cloth, small differences matter.
        unit = ((seen.lean.norm(dim=1) + _LEAST_LEAN)
                * (radius.mean(dim=1) - seen.plate + _LEAST_HANG))
        error = (found - radius) / unit[:, None]
        area = (error * radius).mean(dim=1) / radius.mean(dim=1)
        loss = (error.square().mean(dim=1) + 1e-5).sqrt().mean() + area.abs().mean()
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimiser.step()
        rates.step()
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
