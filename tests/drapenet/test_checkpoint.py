"""Checkpoints and their evaluation."""

import hashlib
import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from checkpoints import change_description, describe_again, description, use_skirts

import drapenet.network.evaluate
from common.command import compose_config
from common.errors import InputError
from data.dataset.folder import finished_manifest
from data.dataset.plan import plan_drape
from data.fabrics.nuisances import KINDS
from data.fabrics.prior import load_prior, prior_content
from drapenet.config import EvaluateConfig
from drapenet.network.checkpoint import Header, read_header
from drapenet.network.dataset import make_maps
from drapenet.network.evaluate import CELLS, CLOTHS, Judged, judge, make_config
from drapenet.network.expected import SHAPE
from drapenet.network.inputs import ASPECTS, FACTS, STATED, Batch
from drapenet.network.model import make_network
from drapenet.network.predict import network_of
from drapenet.network.targets import TARGETS
from drapenet.network.trained import OfGraphs, graph_of
from drapenet.network.weights import Loaded, load_model, save_checkpoint, save_graphs
from drapenet.views.directions import AZIMUTHS, ELEVATIONS
from sim.rig import Rig


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
                 drawn(FACTS + ASPECTS + STATED),
                 np.array(group), np.zeros((count, 0, 0, 0), np.float32), drawn(), drawn(SHAPE))


@pytest.mark.parametrize("group", [[0], [0, 1, 1, 2, 2, 2]])
def test_the_bundled_graphs_are_the_bundled_network(group):
    header, batch = read_header(), batch_of_sets(group)
    graphs = network_of(header)
    network = Loaded(load_model(header))
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


def write_fabrics(file: Path) -> Path:
    """Write a table of a measured fabric."""
    file.write_text("density[kg.m-2],linear warp[SI*1e9],linear weft[SI*1e9],linear diag[SI*1e9],"
                    "nonlinear warp[SI*1e12],nonlinear weft[SI*1e12],nonlinear diag[SI*1e12]\n"
                    "0.3,30000,20000,25000,-60000,-4e4,-5e4\n")
    return file


@pytest.fixture(scope="module")
def header(untrained_checkpoint) -> Header:
    return read_header(untrained_checkpoint)


@pytest.mark.parametrize("name", [
    "depth, warp not stated", "outline, sets of 4", "drape coefficient and nodes"])
def test_an_untrained_network_is_no_better_than_the_mean_and_says_how_wide_it_is(
    header, cloth_dataset, tmp_path_factory, name
):
    maps = make_maps(cloth_dataset, finished_manifest(cloth_dataset),
                     tmp_path_factory.getbasetemp(), setups=header.setups, captures=1, seed=1)
    judged = judge(network_of(header), header, maps, CELLS[name].condition, seed=0)
    result = judged.summary(header.spread)
    figure = result["log_alpha"]
    assert figure["interval_95"][0] < figure["rmse"] < figure["interval_95"][1]
    assert 0.7 < figure["rmse"] < 3.0
    assert result["inside"]["50%"]["mean"] < result["inside"]["90%"]["mean"]
    assert (result["sets"], result["fabrics"]) == (48, 24)
    assert result["alpha"]["median"] < result["alpha"]["ninth_decile"]
    found = Judged.joined([judged, judged]).by_band(header.spread)
    kinds = found.pop("cloth")  # of which a fabric may be several
    assert sum(band["sets"] for name, band in kinds.items() if name in KINDS) == 96
    for bands in found.values():
        assert sum(band["sets"] for band in bands.values()) == 96
        assert sum(band["fabrics"] for band in bands.values()) >= 48


def test_sets_are_in_the_band_of_their_coefficient_and_stiffness():
    """Of four fabrics, two are in a middle and two in the last band of each kind."""
    error = np.zeros((4, 6))
    error[2:, :3] = np.log(1.5)
    judged = Judged(error, np.full((4, 6), 0.5), np.arange(4), 1e-6 * np.array([20, 50, 300, 900]),
                    np.array([0.25, 0.39, 0.85, np.nan]), np.eye(4, len(CLOTHS)) > 0,
                    np.full(4, np.nan))
    bands = judged.by_band(np.ones(6))
    assert {name: band["alpha"]["median"] for name, band in bands["stiffness"].items()} == {
        "16 to 64 µN·m": 0.0, "above 200 µN·m": pytest.approx(0.5)}
    assert {name: band["sets"] for name, band in bands["drape coefficient"].items()} == {
        "20 to 40 %": 2, "above 80 %": 1}  # of one capture too little was seen
    assert {name: band["sets"] for name, band in bands["cloth"].items()} == dict.fromkeys(
        CLOTHS[:4], 1)


def test_cells_of_the_matrix_are_possible(header):
    for name, cell in CELLS.items():
        assert set(cell.setups) <= set(vars(header.setups)), name
        assert sum(cell.condition.sizes) == sum(cell.condition.kinds) == 1, name


def test_new_drapes_are_of_the_tester_asked_for(header):
    words = ["testers=[square250_cylinder60]", "fabrics_per_tester=3", "even_fabrics=9", "seed=5"]
    config = compose_config("evaluate", words, schema=EvaluateConfig)
    base = make_config(header, "square250_cylinder60", config)
    assert base.drapes == 12 and base.edge == pytest.approx(8e-3)
    plans = [plan_drape(index, config=base.sampling, prior=base.prior)
             for index in range(base.drapes)]
    assert {plan.rig.name.partition("_rim")[0] for plan in plans} == {"square250_cylinder60"}
    assert len({plan.fabric for plan in plans}) == 3
    even = make_config(header, "square250_cylinder60", config, even=True)
    assert even.sampling.even_share == 1 and even.sampling.starts_per_fabric == 2
    assert even.sampling.seed != base.sampling.seed


def test_seen_fabrics_are_refused_before_they_are_made(untrained_checkpoint, tmp_path, monkeypatch):
    copy = Path(shutil.copy(untrained_checkpoint, tmp_path / "copy.safetensors"))
    dataset = description(copy)["dataset"]
    sampling = dataset["generation"][0]["sampling"] | {"seed": 5}
    dataset["generation"].insert(0, {"sampling": sampling,
                                     "prior": prior_content(load_prior("vae"))})
    change_description(copy, dataset=dataset)
    monkeypatch.setattr(drapenet.network.evaluate, "generate_dataset", None)
    words = [f"checkpoint={copy}", f"out={tmp_path}", "seed=5", "testers=[disc300_support180]"]
    with pytest.raises(InputError, match="not unseen"):
        drapenet.network.evaluate.main(words)
    measured = write_fabrics(tmp_path / "table.csv")
    with pytest.raises(TypeError, match="not callable"):  # generate_dataset: they are unseen
        drapenet.network.evaluate.main([*words, f"fabrics={measured}"])


def test_the_command_prints_a_line_a_cell(untrained_checkpoint, tmp_path, monkeypatch, capsys):
    names = ("depth, 8 views", "outline, parallel light")
    use_skirts(monkeypatch, *names)
    tester = Rig().name
    words = [f"checkpoint={untrained_checkpoint}", f"out={tmp_path / 'out'}",
             f"testers=[{tester}]", "fabrics_per_tester=1", "even_fabrics=1", "captures=1",
             "seed=7", "workers=1", f"fabrics={write_fabrics(tmp_path / 'table.csv')}"]
    drapenet.network.evaluate.main(words)
    lines = capsys.readouterr().out.splitlines()
    for name in names:
        line, = (line for line in lines if line.startswith(f"{tester}, {name}: alpha off by "))
        assert line.endswith("; 6 sets of 3 fabrics") and ", 68 %: " in line
    assert any(line.startswith("outline, parallel light, stiffness ") for line in lines)
    written = json.loads((tmp_path / "out" / "evaluation.json").read_text())
    assert set(written["cells"][tester]) == set(names)
    assert set(written["bands"]) == set(written["even"][tester]) == set(names[1:])
