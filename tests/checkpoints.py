"""Checkpoints of an untrained network, and their descriptions."""

import json
from pathlib import Path

import torch
from safetensors import safe_open
from safetensors.torch import load, save_file

from common.configs import read_option
from drapenet.network.checkpoint import SCHEMA, save_checkpoint
from drapenet.network.model import MapNet


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


def save_untrained(path: Path, width: int = 8) -> Path:
    """A checkpoint with a plausible description and random weights; of captures without noise,
    which cost less to make."""
    torch.manual_seed(0)
    mean, std = [-10.8, -11.0, -10.8, -0.0026, -0.0026, -0.0026], [0.9, 0.8, 0.9, *[0.0014] * 3]
    model = {"width": width, "components": 2, "targets": 6, "distance": 0.076, "spread": 0.017}
    generation = {"sampling": {"seed": 999, "starts": ["sine", "fold"]}, "prior": "blobs",
                  "solver": {"edge_mm": 8.0}}
    save_checkpoint(path, model=MapNet(**model), half=False, description={
        "rig": "square300_cylinder100", "model": model, "targets": {"mean": mean, "std": std},
        "fabrics": {"low": [m - 2 * s for m, s in zip(mean, std, strict=True)],
                    "high": [m + 2 * s for m, s in zip(mean, std, strict=True)],
                    "deviation": std},
        "dataset": {"sha256": "0" * 64, "generation": generation}, "validation": {},
        "config": {"setup": {**read_option("setup", "real"), "sensors": {"none": 1.0}}}})
    return path
