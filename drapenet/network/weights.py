"""Checkpoints of networks of PyTorch: written, read, and exported for ONNX Runtime."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError
from safetensors.torch import load_file

from common.errors import InputError
from common.graph_export import save_graph, save_weights
from drapenet.network.checkpoint import SCHEMA, SCHEMA_VERSION, Header
from drapenet.network.inputs import CIRCUMSTANCES, FACTS, Batch, columns_of
from drapenet.network.model import Network, make_network
from drapenet.network.posterior import Posterior
from drapenet.network.targets import TARGETS
from drapenet.network.trained import EXPECTED, Trained, graph_identity, graph_of
from drapenet.views.directions import AZIMUTHS, ELEVATIONS
from drapenet.views.pictures import PICTURES, SIDE

_EXAMPLES = 6, 3  # captures and sets


class Loaded(Trained):
    """A network of PyTorch."""

    def __init__(self, network: Network) -> None:
        self.network = network.eval()

    @torch.inference_mode()
    def posterior(self, batch: Batch) -> Posterior:
        return self.network.answer(batch).posterior

    @torch.inference_mode()
    def shapes(self, targets: np.ndarray, facts: np.ndarray, face: np.ndarray
               ) -> list[np.ndarray] | None:
        if self.network.expected is None:
            return None
        device = next(self.network.parameters()).device
        inputs = (torch.tensor(one, device=device) for one in (targets, facts, face))
        return [part.cpu().numpy() for part in self.network.expected(*inputs)]


def load_model(header: Header) -> Network:
    """The network of a checkpoint, in float32 on the CPU, in evaluation mode."""
    try:
        model = make_network(**header.model.model_dump())
        model.load_state_dict(load_file(header.path))  # converts to float32
    except (SafetensorError, RuntimeError, TypeError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(f"{header.path} does not fit the network: {reason}; copy it again"
                         ) from None
    return model.eval()


def save_checkpoint(
    path: Path, *, model: torch.nn.Module, description: dict[str, Any], half: bool
) -> None:
    """Write the checkpoint ``path``; ``half``: in half precision."""
    content = {"schema_version": SCHEMA_VERSION} | description
    save_weights(path, model, half=half, metadata={SCHEMA: json.dumps(content)})


def save_graphs(header: Header) -> None:
    """Write the graphs of a checkpoint beside it."""
    network, captures, sets = load_model(header), *_EXAMPLES
    generator = torch.Generator().manual_seed(0)

    def drawn(*shape: int) -> torch.Tensor:
        return torch.rand(shape, generator=generator)

    of_all: Sequence[tuple[str, str, torch.Tensor]] = (
        ("face", "n", drawn(captures).sign()),
        ("facts", "n", drawn(captures, len(columns_of(FACTS, True)))),
        ("members", "mn", torch.eye(sets).repeat(1, captures // sets)))
    read = {"distance": drawn(captures, AZIMUTHS, ELEVATIONS),
            "weight": 4 * drawn(captures, AZIMUTHS, ELEVATIONS),
            "outline": 0.6 + 0.4 * drawn(captures, AZIMUTHS), "error": drawn(captures, AZIMUTHS),
            "pictures": drawn(captures, PICTURES, SIDE, SIDE), "angle": drawn(captures)}
    save_graph(graph_of(header.path), network, [*of_all, *((name, "n", read[name])
                                                           for name in network.reads)],
               ["logits", "means", "factors"], identity=graph_identity(header))
    if network.expected is not None:
        save_graph(graph_of(header.path, EXPECTED), network.expected, [
            ("targets", "sn", drawn(sets, captures, TARGETS)),
            ("facts", "sn", drawn(sets, captures, CIRCUMSTANCES)),
            ("face", "sn", drawn(sets, captures).sign())], ["weights", "means", "deviations"],
            identity=graph_identity(header))
