"""The matrix of the evaluation, with an untrained network and cloth that costs nothing."""

import json
import shutil
from pathlib import Path

import cloths
import numpy as np
import pytest
from checkpoints import change_description, description

import drapenet.network.evaluate
from common.errors import InputError
from data.dataset.folder import finished_manifest
from data.fabrics.prior import load_prior, prior_content
from drapenet.network.checkpoint import load_model, read_header
from drapenet.network.dataset import make_maps
from drapenet.network.evaluate import CELLS, datasets, judge, make_config
from sim.rig import Rig


def write_fabrics(file: Path) -> Path:
    """Write a table of a measured fabric."""
    file.write_text("density[kg.m-2],linear warp[SI*1e9],linear weft[SI*1e9],linear diag[SI*1e9],"
                    "nonlinear warp[SI*1e12],nonlinear weft[SI*1e12],nonlinear diag[SI*1e12]\n"
                    "0.3,30000,20000,25000,-60000,-4e4,-5e4\n")
    return file


def test_an_untrained_network_is_no_better_than_the_mean_and_says_how_wide_it_is(
    untrained_checkpoint, cloth_dataset, tmp_path
):
    header = read_header(untrained_checkpoint)
    maps = make_maps(cloth_dataset, finished_manifest(cloth_dataset), tmp_path,
                     setups=header.setups, captures=1, seed=1)
    result = judge(load_model(header), header, maps, known=False)
    figure = result["log_alpha"]
    assert figure["interval_95"][0] < figure["rmse"] < figure["interval_95"][1]
    assert figure["rmse"] > 0.8 * result["prior"]["log_alpha"]
    assert result["inside"]["50%"]["mean"] < result["inside"]["90%"]["mean"]
    assert (result["captures"], result["drapes"]) == (24, 24)


def test_the_matrix_varies_one_thing_at_a_time(untrained_checkpoint):
    header = read_header(untrained_checkpoint)
    base = make_config(header, drapes=50, seed=5)
    made = datasets(base)
    assert {cell.drapes for cell in CELLS.values()} == set(made)
    assert made["as trained"] is base and made["none"].drapes == 10
    assert made["membrane x 3"].sampling.nuisances.membrane == pytest.approx(
        [3 * np.sqrt(4e5)] * 2)
    assert made["finer mesh"].edge < base.edge
    for cell in CELLS.values():  # all are possible
        assert set(cell.setups) <= set(vars(header.setups))


def test_seen_fabrics_are_refused_before_they_are_made(untrained_checkpoint, tmp_path, monkeypatch):
    copy = Path(shutil.copy(untrained_checkpoint, tmp_path / "copy.safetensors"))
    dataset = description(copy)["dataset"]
    dataset["generation"] |= {"sampling": {"seed": 5, "starts": ["sine"]},
                              "prior": prior_content(load_prior("vae"))}
    change_description(copy, dataset=dataset)
    monkeypatch.setattr(drapenet.network.evaluate, "generate_dataset", None)
    words = [f"checkpoint={copy}", f"out={tmp_path}", "seed=5"]
    with pytest.raises(InputError, match="not unseen"):
        drapenet.network.evaluate.main(words)
    measured = write_fabrics(tmp_path / "table.csv")
    with pytest.raises(TypeError, match="not callable"):  # generate_dataset: they are unseen
        drapenet.network.evaluate.main([*words, f"fabrics={measured}"])


@pytest.mark.parametrize("table", [False, True])
def test_the_command_prints_a_line_a_cell(
    untrained_checkpoint, tmp_path, monkeypatch, capsys, table
):
    def make(config: object, out: Path, *, workers: int) -> dict:
        if not out.exists():
            cloths.write_dataset(out, drapes=3, seed=config.sampling.seed)
        return finished_manifest(out)

    monkeypatch.setattr(drapenet.network.evaluate, "generate_dataset", make)
    monkeypatch.setattr(drapenet.network.evaluate, "CELLS", {
        name: CELLS[name] for name in ("as trained", "without nuisances", "views 8")})
    words = [f"checkpoint={untrained_checkpoint}", f"out={tmp_path / 'out'}", "drapes=3",
             "captures=1", "seed=5", "workers=1"]
    if table:
        words.append(f"fabrics={write_fabrics(tmp_path / 'table.csv')}")
    drapenet.network.evaluate.main(words)
    lines = capsys.readouterr().out.splitlines()
    names = ["as trained", "without nuisances", *([] if table else ["views 8"])]
    for name in names:
        line, = (line for line in lines if line.startswith(f"{name}: log alpha "))
        assert line.endswith(", n 3") and "inside 68 %: " in line
    place = tmp_path / "out" / Rig().name / ("table" if table else "")
    assert set(json.loads((place / "evaluation.json").read_text())["cells"]) == set(names)
