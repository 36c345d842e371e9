"""Write a network of PyTorch for :mod:`common.graphs`."""

import logging
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import save

from common.files import replace_file
from common.graphs import IDENTITY, Graph

CHECKED = 1e-5
"""Largest difference from PyTorch, of an output's spread."""


def save_weights(
    file: Path, network: torch.nn.Module, *, half: bool, metadata: dict[str, str] | None = None
) -> None:
    """Write a network's safetensors ``file``; ``half``: in half precision, but for running
    statistics, which span many orders of magnitude."""
    tensors = {}
    for name, value in network.state_dict().items():
        narrow = half and value.is_floating_point() and "running" not in name
        tensors[name] = (value.half() if narrow else value).cpu().contiguous()
    replace_file(file, save(tensors, metadata=metadata))


def save_graph(
    file: Path, network: torch.nn.Module, inputs: Sequence[tuple[str, str, torch.Tensor]],
    outputs: Sequence[str], *, identity: str
) -> None:
    """Write a network's graph, without its weights.

    Its results for the ``inputs`` are those of PyTorch to :data:`CHECKED`, or AssertionError.

    Args:
        inputs: name, dimensions and example (N, ...) of each argument of its ``forward``;
            dimensions are letters of those that may vary, from the first on, such as "mn".
    """
    import onnx

    names, letters, examples = zip(*inputs, strict=True)
    varied = {letter: torch.export.Dim(letter, max=1 << 20) for letter in "".join(letters)}
    dimensions = tuple({k: varied[letter] for k, letter in enumerate(one)} for one in letters)
    network = network.cpu().eval()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        logging.disable(logging.WARNING)
        try:
            program = torch.onnx.export(
                network, examples, dynamo=True, dynamic_shapes=dimensions, input_names=list(names),
                output_names=list(outputs), optimize=False, verbose=False)
        finally:
            logging.disable(logging.NOTSET)
    assert program is not None
    model = program.model_proto
    for one, varying in zip(model.graph.input, letters, strict=True):  # len() of a tensor fixes one
        found = [place.dim_param for place in one.type.tensor_type.shape.dim]
        assert found[:len(varying)] == list(varying), f"{one.name} has dimensions {found}"
    weights = {name: value.float().numpy() for name, value in network.state_dict().items()}
    for one in model.graph.initializer:
        if one.name in weights:  # given to the session
            one.ClearField("raw_data")
            one.data_location = onnx.TensorProto.EXTERNAL
            one.external_data.add(key="location", value="weights")
    for node in model.graph.node:
        del node.metadata_props[:]
        node.ClearField("doc_string")
    del model.graph.value_info[:]
    del model.metadata_props[:]
    model.metadata_props.add(key=IDENTITY, value=identity)
    replace_file(file, model.SerializeToString(deterministic=True))
    used = {one.name for one in model.graph.initializer}
    found = Graph(file, {name: weights[name] for name in weights if name in used}, identity)(
        **{name: value.numpy() for name, value in zip(names, examples, strict=True)})
    with torch.inference_mode():
        answer = network(*examples)
    for mine, exact in zip(found, answer if isinstance(answer, tuple) else (answer,), strict=True):
        spread = max(float(exact.std()), 1e-6)
        np.testing.assert_allclose(mine, exact.numpy(), rtol=0, atol=CHECKED * spread)
