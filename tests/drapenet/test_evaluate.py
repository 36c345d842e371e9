import json
from pathlib import Path

import numpy as np
import pytest
from blobs import write_dataset

import drapenet.evaluate
from common.errors import InputError
from data.dataset import DrapeDataset
from data.prior import load_prior, prior_content
from drapenet.checkpoint import read_header
from drapenet.evaluate import evaluate
from drapenet.network_errors import NetworkErrors


def test_the_mean_scores_one_on_its_own_distribution(
    untrained_checkpoint: Path, blob_dataset: Path
) -> None:
    header = read_header(untrained_checkpoint)
    # Standardise as a network trained on blobs would.
    targets = header.content["targets"]
    changed = targets | {"mean": [-9.9, -10.4, -10.9, *[-0.003] * 3],
                         "std": [0.76, 0.9, 0.76, *[0.002] * 3]}
    header.content["targets"] = changed
    result = evaluate(header, DrapeDataset(blob_dataset))
    assert result["training_mean"]["rmse_log_alpha"] == pytest.approx(1, abs=0.15)
    assert result["network"]["samples"] == result["dataset"]["drapes"] == 64
    assert result["network"]["rmse_log_alpha"] != result["training_mean"]["rmse_log_alpha"]


def test_the_mean_error_is_subtracted(untrained_checkpoint: Path, tmp_path: Path) -> None:
    header = read_header(untrained_checkpoint)
    drapes = DrapeDataset(write_dataset(tmp_path / "dataset", drapes=6, seed=5))
    shift = np.array([0.1, 0.2, 0.3, 1e-3, 2e-3, 3e-3])
    squares = []
    for sign in (1, 0, -1):
        errors = NetworkErrors(sign * shift, np.zeros(6), 0.0, np.diag(shift**2), 9)
        header.content["errors"] = errors.as_dict()
        rmse = evaluate(header, drapes)["network_less_mean_error"]["rmse"]
        squares.append(np.square(list(rmse.values())))
    scaled = shift / header.content["targets"]["std"]
    assert squares[0] + squares[2] - 2 * squares[1] == pytest.approx(2 * scaled**2, rel=1e-3)


def test_training_fabrics_are_not_unseen(untrained_checkpoint: Path, tmp_path: Path) -> None:
    header = read_header(untrained_checkpoint)
    write_dataset(tmp_path / "dataset", drapes=4, seed=999)  # the checkpoint's own seed
    with pytest.raises(InputError, match="not unseen"):
        evaluate(header, DrapeDataset(tmp_path / "dataset"))


@pytest.mark.parametrize("seen", ["latest", "earlier"])
def test_what_cannot_be_judged_is_refused_before_it_is_made(
    untrained_checkpoint: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seen: str
) -> None:
    copy = tmp_path / "copy.json"
    content = json.loads(untrained_checkpoint.with_suffix(".json").read_text())
    prior = prior_content(load_prior("vae"))
    generations = [{"sampling": {"seed": seed}, "prior": prior} for seed in (5, 6)]
    latest, earlier = generations if seen == "latest" else reversed(generations)
    content["dataset"] |= {"generation": latest, "earlier": [{"generation": earlier}]}
    copy.write_text(json.dumps(content))
    copy.with_suffix(".safetensors").write_bytes(untrained_checkpoint.read_bytes())
    monkeypatch.setattr(drapenet.evaluate, "generate_dataset", None)
    with pytest.raises(InputError, match="not unseen"):
        drapenet.evaluate.main([f"checkpoint={copy}", f"out={tmp_path}", "seed=5"])


def test_the_command_makes_its_data_and_writes_the_figures(
    untrained_checkpoint: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture,
) -> None:
    asked = []

    def make(config: object, out: Path, *, workers: int) -> None:
        asked.append((config.drapes, config.sampling.seed, config.sampling.starts_per_fabric))
        write_dataset(out, drapes=6, seed=config.sampling.seed)

    monkeypatch.setattr(drapenet.evaluate, "generate_dataset", make)
    drapenet.evaluate.main([f"checkpoint={untrained_checkpoint}", f"out={tmp_path}", "drapes=6",
                            "seed=5", "orientations=2"])
    assert asked == [(6, 5, 1)]
    result = json.loads((tmp_path / "evaluation.json").read_text())
    assert result["network"]["samples"] == 12
    assert result["dataset"]["sha256"] == f"{5:064x}"
    assert f"{result['network']['rmse_log_alpha']:.3f}" in capsys.readouterr().out


def test_a_dataset_without_views_is_rendered(
    untrained_checkpoint: Path, cloth_dataset: Path, tmp_path: Path
) -> None:
    drapenet.evaluate.main([f"checkpoint={untrained_checkpoint}", f"data={cloth_dataset}",
                            f"out={tmp_path / 'out'}", "orientations=2"])
    result = json.loads((tmp_path / "out" / "evaluation.json").read_text())
    assert result["network"]["samples"] == 80
    assert result["dataset"]["sha256"] == f"{8:064x}"
    with pytest.raises(InputError, match="orientations=0"):
        drapenet.evaluate.main([f"data={cloth_dataset}", "orientations=0"])
    with pytest.raises(InputError, match="out= needs the name of a folder"):
        drapenet.evaluate.main([f"data={cloth_dataset}", "out="])
