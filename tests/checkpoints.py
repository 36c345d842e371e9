"""Descriptions in checkpoints, read and replaced by tests."""

import json
from pathlib import Path

from safetensors import safe_open
from safetensors.torch import load, save_file

from drapenet.network.checkpoint import SCHEMA


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
