"""Train the network that says where an outline is not one that cloth has (data/captures/hem.py).

    python -m data.dataset.hem data=FOLDER [out=FILE]

FOLDER is a dataset of drapes, finished or not. Each is seen from above or beside, half of them
misread: shadows, paper and feet are taken for cloth, borders and stripes for ground. Half an hour
on one core for 8000 drapes. Prints how the errors found agree with the true ones on fabrics held
out. All lengths are over the specimen's size.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from scipy.ndimage import gaussian_filter1d
from torch.nn.functional import conv1d, pad

from common.command import command
from data.captures.hem import USUAL
from data.captures.off_axis import AZIMUTH, AZIMUTHS
from data.dataset.learning import Around, LearningConfig, first_drapes, fit, save
from data.dataset.off_axis import HELD_OUT, silhouette
from sim.mesh import Mesh

_SMOOTH = ((3.0, 100.0), (10.0, 20.0))  # azimuths, and factors of what is finer
_BATCH, _RATE = 32, 3e-3  # largest learning rate
HEIGHTS, LEAN = (0.4, 1.5), 0.3  # m, of cameras above the plate; farthest place beside over height
FAULTS = (0, 0, 0, 1, 1, 2)  # of an outline, one as often as another
_MM = 1 / 300  # of a usual specimen
_BLUR, _NOISE, _EVEN = (0.3, 2.0), (0.15, 0.5), (2.0, 6.0)  # mm, of all that is read
_WIDE, _SIDES, _RAGGED = (1.0, 150.0), (0.3, 10.0), (0.5, 8.0)  # mm, along the hem, of faults
_DEEP, _PERIOD = 15.0, (8.0, 40.0)  # mm


class HemNetwork(Around):
    """Errors of radii from their course around an outline, by two azimuths in a column."""

    def __init__(self) -> None:
        super().__init__(8, (1, 2, 4, 8, 16, 1))

    def forward(self, radius: torch.Tensor, plate: torch.Tensor, reach: torch.Tensor
                ) -> torch.Tensor:
        """Logarithm (N, AZIMUTHS) of the errors, in units of :data:`USUAL`, of radii (N, AZIMUTHS),
        of plates and of the flat specimens' reaches (N,)."""
        about = radius - radius.mean(dim=1, keepdim=True)  # rounding errors count a hundredfold
        parts = [8 * radius - 3, *(factor * (about - _smoothed(about, width))
                                   for width, factor in _SMOOTH)]
        columns = [part[:, first::2] for part in parts for first in (0, 1)]
        same = [value[:, None].expand_as(columns[0]) for value in (4 * plate - 1, 4 * reach - 2)]
        return self.outputs(columns + same).transpose(1, 2).flatten(1)


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
class HemConfig(LearningConfig):
    """``configs/hem.yaml``."""


@command("hem", HemConfig)
def main(config: HemConfig) -> None:
    """Train and write the network; print how its errors agree with the true ones."""
    outlines, held_out = see(config.begin(), config)
    network = train(outlines[~held_out], config)
    half, turn = torch.full((2,), 0.5), torch.tensor(AZIMUTH, dtype=torch.float32)
    folded = 0.4 + torch.tensor([[0.0], [0.03]]) * torch.cos(8 * turn)
    save(network, Path(config.out), {"radius": folded, "plate": 0.6 * half, "reach": half},
         "log_error")
    print(f"{agreement(network, outlines[held_out], config)}\nwritten to {config.out}")


def see(root: Path, config: HemConfig) -> tuple[np.ndarray, np.ndarray]:
    """Radii as seen, plate's radius and reach of each drape (N, AZIMUTHS + 2), in sizes; which of
    them are held out (N,)."""
    rows: list[np.ndarray] = []
    held_out: list[bool] = []
    for shard, row, index, unseen in first_drapes(root, config.drapes, HELD_OUT):
        positions, rest, faces = shard.mesh(row)
        rig, rng = shard.rig(row), np.random.default_rng([config.seed, index])
        height, turn = rng.uniform(*HEIGHTS), rng.uniform(0, 2 * np.pi)
        beside = height * rng.uniform(0, LEAN) * np.array([np.cos(turn), np.sin(turn)])
        seen = silhouette(positions, Mesh(rest, faces).edges, beside, height, azimuths=AZIMUTHS)
        rows.append(np.append(seen, [rig.plate_radius, rig.reach]) / rig.specimen_size)
        held_out.append(unseen)
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
    """A network trained on misread outlines (N, ...)."""
    network, rng = HemNetwork(), np.random.default_rng(config.seed)

    def losses() -> Iterator[torch.Tensor]:
        while True:
            inputs, off = _read(rng.choice(outlines, _BATCH), rng)
            yield _unlikely(network(*inputs), off)

    fit(network, losses(), config.steps, _RATE)
    return network


@torch.inference_mode()
def agreement(network: HemNetwork, outlines: np.ndarray, config: HemConfig) -> str:
    """The correlation of the logarithms of errors found and true, of outlines (N, A)."""
    inputs, off = _read(outlines, np.random.default_rng(config.seed))
    found, true = network(*inputs), (off.abs() + 0.2 * _MM).log()
    together = torch.corrcoef(torch.stack([found.flatten(), true.flatten()]))[0, 1]
    return f"{len(outlines)} outlines held out: correlation of log errors {together:.2f}"


if __name__ == "__main__":
    main()
