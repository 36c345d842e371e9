"""What the trainings of small networks on the drapes of a dataset share."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
from pydantic import Field
from torch import nn
from torch.nn.functional import gelu

from common.cases import progress_bar
from common.configs import Seed
from common.errors import InputError
from common.files import require_file
from common.graph_export import save_graph, save_weights
from common.graphs import SUFFIX
from data.dataset.folder import over_shards, require_dataset, split_by_fabric
from data.dataset.shards import SHARDS, Shard

_WIDTH, _KERNEL = 32, 5


@dataclass
class LearningConfig:
    """Keys of a training on outlines of drapes."""

    data: str
    out: str
    drapes: Annotated[int, Field(ge=1)]
    steps: Annotated[int, Field(ge=1)]
    seed: Seed

    def begin(self) -> Path:
        """The folder of the dataset; InputError if it is none, or for an impossible ``out``."""
        root = require_dataset(self.data)
        require_file(Path(self.out))
        torch.set_num_threads(1)
        torch.manual_seed(self.seed)
        return root


class Around(nn.Module):
    """Convolutions around an outline, from columns of so many inputs to two outputs, 0 at first."""

    def __init__(self, inputs: int, dilations: Sequence[int]) -> None:
        super().__init__()
        self.first, *layers = (
            nn.Conv1d(count, _WIDTH, _KERNEL, dilation=step, padding="same",
                      padding_mode="circular")
            for count, step in ((inputs, 1), *((_WIDTH, step) for step in dilations)))
        self.layers = nn.ModuleList(layers)
        self.last = nn.Conv1d(_WIDTH, 2, 1)
        for value in self.last.parameters():
            nn.init.zeros_(value)

    def outputs(self, columns: list[torch.Tensor]) -> torch.Tensor:
        """(N, 2, C) of inputs (N, C)."""
        values = gelu(self.first(torch.stack(columns, dim=1)))
        for layer in self.layers:
            values = values + gelu(layer(values))
        return self.last(values)


def converged(shard: Shard, share: float) -> list[tuple[int, bool]]:
    """Rows of the converged drapes, and whether they are of the ``share`` of fabrics held out."""
    split = split_by_fabric(shard.column("fabric"), fractions={
        "training": 1 - share, "held out": share})
    return [(int(row), split[row] == "held out")
            for row in np.flatnonzero(shard.column("status") == "converged")]


def first_drapes(root: Path, count: int, share: float) -> Iterator[tuple[Shard, int, int, bool]]:
    """Shard, row, number and whether it is held out, of the converged of the first drapes.

    Raises:
        InputError: all are held out.
    """
    learned = False
    for path in over_shards(sorted(root.glob(SHARDS)), "reading"):
        shard = Shard(path)
        index = shard.column("index")
        if index[0] >= count:
            break
        for row, held_out in converged(shard, share):
            if index[row] < count:
                learned |= not held_out
                yield shard, row, int(index[row]), held_out
    if not learned:
        raise InputError(f"{root} has no drapes to train on; complete more of its shards")


def fit(network: nn.Module, losses: Iterable[torch.Tensor], steps: int, rate: float, *,
        rise: float = 0.05, momentum: bool = False, clip: float = 1.0, decay: float = 0.01) -> None:
    """Train a network by so many losses (scalars); the learning rate is at most ``rate``,
    after a share ``rise`` of the steps."""
    optimiser = torch.optim.AdamW(network.parameters(), weight_decay=decay)
    rates = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, rate, total_steps=steps + 1, pct_start=rise, cycle_momentum=momentum)
    for _, loss in zip(progress_bar(range(steps), desc="training", unit="step", leave=False),
                       losses, strict=False):
        optimiser.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), clip)
        optimiser.step()
        rates.step()


def save(network: nn.Module, file: Path, inputs: dict[str, torch.Tensor], output: str) -> None:
    """Write weights and graph, of example ``inputs`` (N, ...) by name."""
    save_weights(file, network, half=True)
    save_graph(file.with_suffix(SUFFIX), network,
               [(name, "n", example) for name, example in inputs.items()], [output],
               identity=file.stem)
