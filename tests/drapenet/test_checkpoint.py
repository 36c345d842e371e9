import hashlib
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from checkpoints import change_description, describe_again, description

from common.errors import InputError
from drapenet.network.checkpoint import read_header
from drapenet.network.expected import SHAPE
from drapenet.network.inputs import ASPECTS, FACTS, Batch
from drapenet.network.load import network_of
from drapenet.network.model import make_network
from drapenet.network.targets import TARGETS
from drapenet.network.trained import OfGraphs, graph_of
from drapenet.network.weights import Loaded, load_model, save_checkpoint, save_graphs
from drapenet.views.directions import AZIMUTHS, ELEVATIONS


@pytest.fixture
def checkpoint(untrained_checkpoint, tmp_path) -> Path:
    """A copy that a test may spoil."""
    return Path(shutil.copy(untrained_checkpoint, tmp_path / "copy.safetensors"))


def test_a_checkpoint_is_one_file_with_its_hash(checkpoint):
    header = read_header(checkpoint)
    assert list(checkpoint.parent.iterdir()) == [checkpoint] == [header.path]
    assert header.sha256 == hashlib.sha256(checkpoint.read_bytes()).hexdigest()


@pytest.mark.parametrize("half", [False, True])
def test_a_loaded_network_predicts_the_same(checkpoint, half):
    content = description(checkpoint)
    torch.manual_seed(5)
    model = make_network(**content["model"]).eval()
    save_checkpoint(checkpoint, model=model, description=content, half=half)
    first, second = (network.posterior(batch_of_sets([0, 0])).means for network in (
        Loaded(model), network_of(read_header(checkpoint))))
    assert np.abs(first - second).max() <= (2e-2 if half else 0)


def batch_of_sets(group: list[int]) -> Batch:
    """Random captures of sets of these numbers."""
    rng, count = np.random.default_rng(0), len(group)

    def drawn(*shape: int) -> np.ndarray:
        return rng.random((count, *shape), np.float32)

    return Batch(0.3 + 0.1 * drawn(AZIMUTHS, ELEVATIONS), drawn(AZIMUTHS, ELEVATIONS),
                 drawn(AZIMUTHS), drawn(AZIMUTHS), np.ones(count, np.float32),
                 drawn(FACTS + ASPECTS),
                 np.array(group), np.zeros((count, 0, 0, 0), np.float32), drawn(), drawn(SHAPE))


@pytest.mark.parametrize("group", [[0], [0, 1, 1, 2, 2, 2]])
def test_the_bundled_graphs_are_the_bundled_network(group):
    header, batch = read_header(), batch_of_sets(group)
    graphs, network = network_of(header), Loaded(load_model(header))
    assert type(graphs) is OfGraphs
    for mine, exact in zip(vars(graphs.posterior(batch)).values(),
                           vars(network.posterior(batch)).values(), strict=True):
        np.testing.assert_allclose(mine, exact, rtol=0, atol=1e-4 * exact.std())
    samples = np.random.default_rng(1).normal(size=(50, max(group) + 1, TARGETS))
    assert [one.probability for one in graphs.likeness(batch, samples)] == pytest.approx(
        [one.probability for one in network.likeness(batch, samples)], abs=0.03)


def test_a_network_is_exported_with_its_weights_apart(checkpoint):
    header = read_header(checkpoint)
    before = network_of(header).posterior(batch_of_sets([0, 1, 1]))
    save_graphs(header)
    network_of.cache_clear()
    graphs = network_of(header)
    assert type(graphs) is OfGraphs and graph_of(checkpoint).stat().st_size < 200_000
    np.testing.assert_allclose(graphs.posterior(batch_of_sets([0, 1, 1])).means, before.means,
                               atol=1e-4)
    for change in ("distance", "width"):  # of another network, whose weights may fit
        model = header.model.model_dump()
        change_description(checkpoint, model=model | {change: 2 * model[change]})
        with pytest.raises(InputError, match=r"copy\.onnx is the graph of another network; copy"):
            network_of(read_header(checkpoint))
    for content in (b"", b"\x08\x0a" * 9, graph_of(checkpoint).read_bytes()[:-99]):
        graph_of(checkpoint).write_bytes(content)
        with pytest.raises(InputError, match=r"copy\.onnx is not the graph of these weights"):
            network_of(header.model_copy(update={"sha256": "damaged"}))
        network_of.cache_clear()


def test_without_graphs_and_pytorch_a_line_says_what_to_install(checkpoint, monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    monkeypatch.delitem(sys.modules, "drapenet.network.weights", raising=False)
    network_of.cache_clear()
    with pytest.raises(InputError, match=r"copy\.onnx is not beside .* torch is not installed"):
        network_of(read_header(checkpoint))


@pytest.mark.parametrize("text", ["[" * 100_000, "9" * 9999])
def test_a_hostile_description_is_refused_in_one_line(checkpoint, text):
    describe_again(checkpoint, text)
    with pytest.raises(InputError) as caught:
        read_header(checkpoint)
    assert str(caught.value).isprintable() and len(str(caught.value)) < 400


def test_weights_of_another_network_are_refused(checkpoint):
    change_description(checkpoint, model=description(checkpoint)["model"] | {"width": 16})
    with pytest.raises(InputError, match="does not fit the network"):
        network_of(read_header(checkpoint))
