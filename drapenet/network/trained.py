"""Trained networks as an estimate needs them, run by ONNX Runtime or, in
:mod:`drapenet.network.weights`, by PyTorch."""

import json
from abc import ABC, abstractmethod
from dataclasses import replace
from pathlib import Path

import numpy as np

from common.graphs import SUFFIX, Graph, read_weights
from drapenet.network.checkpoint import Header
from drapenet.network.expected import REPLICATES, Likeness, likeness
from drapenet.network.inputs import FACTS, Batch, columns_of
from drapenet.network.posterior import Posterior, Samples

EXPECTED = "expected"
"""Attribute of a network that holds the distribution of shapes, and suffix of its graph's name."""


class Trained(ABC):
    """A network in single precision."""

    @abstractmethod
    def posterior(self, batch: Batch) -> Posterior:
        """The posterior of each set."""

    @abstractmethod
    def shapes(self, targets: np.ndarray, facts: np.ndarray, face: np.ndarray
               ) -> list[np.ndarray] | None:
        """Distributions of shapes, see :func:`drapenet.network.expected.likeness`, given targets
        (S, N, TARGETS), circumstances (S, N, F) and faces (S, N); None if it knows none."""

    def likeness(self, batch: Batch, samples: Samples) -> list[Likeness]:
        """How each capture compares with drapes of the standardised ``samples`` (S, M, TARGETS) of
        its set; none of a network that does not know it."""
        drawn = samples[:: max(1, len(samples) // REPLICATES), batch.group].astype(np.float32)
        facts, face = (np.broadcast_to(one, (len(drawn), *one.shape))
                       for one in (batch.circumstances, batch.face))
        expected = self.shapes(drawn, facts, face)
        return likeness(batch.shape, *expected) if expected else []


class OfGraphs(Trained):
    """A network run by ONNX Runtime."""

    def __init__(self, header: Header) -> None:
        weights = read_weights(header.path)
        mine = {name: one for name, one in weights.items() if not name.startswith(f"{EXPECTED}.")}
        identity = graph_identity(header)
        self._posterior = Graph(graph_of(header.path), mine, identity)
        self._shapes, self._columns = None, columns_of(FACTS, True)
        if header.model.expected:
            others = {name.partition(".")[2]: one for name, one in weights.items()
                      if name not in mine}
            self._shapes = Graph(graph_of(header.path, EXPECTED), others, identity)

    def posterior(self, batch: Batch) -> Posterior:
        read = replace(batch, facts=batch.facts[:, self._columns])
        return Posterior(*self._posterior(**{name: getattr(read, name)
                                             for name in self._posterior.inputs}))

    def shapes(self, targets: np.ndarray, facts: np.ndarray, face: np.ndarray
               ) -> list[np.ndarray] | None:
        if self._shapes is None:
            return None
        return self._shapes(targets=targets, facts=facts, face=face)


def graph_of(checkpoint: Path, part: str = "") -> Path:
    """The file of the graph of a checkpoint, or of a ``part`` of it."""
    return checkpoint.with_suffix(f".{part}{SUFFIX}" if part else SUFFIX)


def graph_identity(header: Header) -> str:
    """What a graph beside the checkpoint must state: the network without its weights."""
    return json.dumps(header.model.model_dump(), sort_keys=True)
