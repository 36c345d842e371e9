"""Checkpoints of an untrained network, and their descriptions."""

import json
from pathlib import Path

import cloths
import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load, save_file

import drapenet.network.evaluate
from common.configs import read_option
from data.dataset.folder import finished_manifest
from data.fabrics.fabrics import ClothProperties
from data.fabrics.prior import load_prior, prior_content
from drapenet.network.checkpoint import SCHEMA
from drapenet.network.evaluate import CELLS
from drapenet.network.model import make_network
from drapenet.network.targets import targets_of
from drapenet.network.weights import save_checkpoint


def description(checkpoint: Path) -> dict:
    """The description of a checkpoint."""
    with safe_open(checkpoint, framework="pt") as file:
        return json.loads(file.metadata()[SCHEMA])


def describe_again(checkpoint: Path, text: str) -> None:
    """Replace the description of a checkpoint by ``text``."""
    save_file(load(checkpoint.read_bytes()), checkpoint, metadata={SCHEMA: text})


def change_description(checkpoint: Path, **changes: object) -> None:
    """Replace keys of the description of a checkpoint."""
    describe_again(checkpoint, json.dumps(description(checkpoint) | changes))


def save_untrained(path: Path, width: int = 8, **model: object) -> Path:
    """A checkpoint with a plausible description and random weights; of captures without noise,
    which cost less to make."""
    torch.manual_seed(0)
    mean, std = [-10.8, -11.0, -10.8, -0.0026, -0.0026, -0.0026], [0.9, 0.8, 0.9, *[0.0014] * 3]
    model |= {"width": width, "components": 2, "dropout": 0.1, "distance": 0.25, "spread": 0.06}
    # Of specimens of 300 mm.
    targets = targets_of(ClothProperties(np.array(mean), np.zeros(2), np.array(600.0),
                                         np.array(0.2)), np.array(0.3))
    deviations = [*std[:3], *np.array(std[3:]) / 0.3, 2.0, 2.0, 0.6, 0.1]
    prior = {"fabrics": prior_content(load_prior("gaussian")), "even_share": 0.0,
             "anisotropy": [1.0, 1.0], "anisotropy_varied": [0.0, 0.0], "nuisances": {
                 "cloth": {"woven": {"membrane": [200.0, 2000.0], "shear": [170.0, 175.0],
                                     "curl": 5.0}},
                 "hysteresis": [5.0, 60.0], "curl_specimen": 1.0}}
    generation = {"sampling": {"seed": 999, "starts": ["sine", "fold"],
                               "testers": [], "random_testers": 1.0, "rectangles": 0.0},
                  "prior": prior["fabrics"], "solver": {"edge_mm": 8.0}}
    save_checkpoint(path, model=make_network(**model), half=False, description={
        "model": model, "targets": {"mean": targets.tolist(), "std": deviations},
        "fabrics": {"low": [m - 2 * s for m, s in zip(mean, std, strict=True)],
                    "high": [m + 2 * s for m, s in zip(mean, std, strict=True)],
                    "deviation": std, "ratio": 0.5},
        "prior": prior,
        "dataset": {"sha256": ["0" * 64], "generation": [generation]}, "validation": {},
        "config": {"setup": {**read_option("setup", "real"), "sensors": {"none": 1.0}}}})
    return path


def use_skirts(monkeypatch: pytest.MonkeyPatch, *names: str) -> None:
    """Evaluate the cells of these ``names`` by cloth that costs nothing."""
    def make(config: object, out: Path, *, workers: int) -> dict:
        if not out.exists():
            cloths.write_dataset(out, drapes=3, seed=config.sampling.seed)
        return finished_manifest(out)

    monkeypatch.setattr(drapenet.network.evaluate, "generate_dataset", make)
    monkeypatch.setattr(drapenet.network.evaluate, "CELLS", {name: CELLS[name] for name in names})
