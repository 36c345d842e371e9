"""Trained networks without PyTorch, run by ONNX Runtime.

A network NAME is two files: ``NAME.onnx``, what is computed, and ``NAME.safetensors``, the weights,
which PyTorch reads, too. Neither can hold code: external data and operators that ONNX does not
define are refused by ONNX Runtime, which reads the graph from memory.
"""

from collections.abc import Mapping
from functools import cache
from pathlib import Path

import numpy as np

from common.documents import read_bytes
from common.errors import InputError, one_line

SUFFIX = ".onnx"
IDENTITY = "identity"
"""Key of the graph's metadata, whose text states which network's it is."""
MAX_GRAPH_BYTES = 4 << 20
MAX_WEIGHTS_BYTES = 2 << 30
_OF_TRAINING = ".num_batches_tracked"  # counts of PyTorch that no graph reads


class Graph:
    """A network as a function of named arrays, on one thread, in single precision."""

    def __init__(self, file: Path, weights: Mapping[str, np.ndarray], identity: str) -> None:
        """Of a ``file`` whose metadata state this ``identity``; InputError if it does not fit."""
        import onnxruntime  # takes 0.1 s

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 4
        # The session reads these arrays, which it does not own, as long as it lives.
        self._weights = {name: np.ascontiguousarray(one) for name, one in weights.items()}
        options.add_external_initializers(list(weights), [
            onnxruntime.OrtValue.ortvalue_from_numpy(one) for one in self._weights.values()])
        content = read_bytes(file, MAX_GRAPH_BYTES, "graph of a network")
        try:
            self._session = onnxruntime.InferenceSession(content, options,
                                                         providers=["CPUExecutionProvider"])
        except Exception as error:  # of a C++ library: any
            raise InputError(f"is not the graph of these weights ({one_line(error)}); copy both "
                             "files again", source=file, joint=" ") from None
        stated = self._session.get_modelmeta().custom_metadata_map.get(IDENTITY)
        if stated != identity:
            raise InputError("is the graph of another network; copy it and its weights again",
                             source=file, joint=" ")
        self.inputs = [one.name for one in self._session.get_inputs()]

    def __call__(self, **values: np.ndarray) -> list[np.ndarray]:
        """The outputs for inputs (N, ...) by their names; those that are not read are left out."""
        return self._session.run(None, {
            name: values[name] if values[name].dtype.kind == "i" else
            np.ascontiguousarray(values[name], np.float32) for name in self.inputs})


def read_weights(file: Path) -> dict[str, np.ndarray]:
    """Arrays (...) of a safetensors file by name, in single precision; InputError if it is none."""
    from safetensors import SafetensorError
    from safetensors.numpy import load

    content = read_bytes(file, MAX_WEIGHTS_BYTES, "checkpoint")
    try:
        return {name: np.ascontiguousarray(value, np.float32)
                for name, value in load(content).items() if not name.endswith(_OF_TRAINING)}
    except (SafetensorError, KeyError, TypeError, ValueError) as error:
        raise InputError(f"is not a safetensors file ({one_line(error)}); copy it again",
                         source=file, joint=" ") from None


@cache
def bundled_graph(weights: Path) -> Graph:
    """A network that ships with the project."""
    return Graph(weights.with_suffix(SUFFIX), read_weights(weights), weights.stem)
