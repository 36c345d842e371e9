"""The network of a checkpoint: run by ONNX Runtime where its graphs lie beside it, else by PyTorch.
"""

from functools import lru_cache

from common.errors import InputError
from drapenet.network.checkpoint import Header
from drapenet.network.trained import OfGraphs, Trained, graph_of


@lru_cache(maxsize=2)
def network_of(header: Header) -> Trained:
    """The network of a checkpoint; InputError if it does not fit its description, or needs PyTorch
    where that is not installed."""
    if graph_of(header.path).exists():
        return OfGraphs(header)
    try:
        from drapenet.network.weights import Loaded, load_model
    except ModuleNotFoundError as error:
        raise InputError(f"{graph_of(header.path).name} is not beside it, and {error.name} is not "
                         "installed; copy the file that train.py has written, or install "
                         "drapenet[train]", source=header.path) from None
    return Loaded(load_model(header))
