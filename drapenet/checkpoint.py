"""Checkpoints: NAME.safetensors with the weights beside NAME.json with all that gives them meaning.

Nothing is ever unpickled. Training's own state, for an exact resume, is one safetensors file
whose metadata carries a JSON record, so that it is replaced in one step.
"""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from common.errors import InputError
from common.files import replace_file
from data.fabrics import THETA_NAMES

if TYPE_CHECKING:
    import torch

    from data.setups import Setups
    from drapenet.network import MapNet
    from drapenet.targets import TargetScale

SCHEMA = "drapenet-checkpoint"
SCHEMA_VERSION = 2

_HEADER_KEYS = {"rig", "model", "targets", "fabrics", "dataset", "weights", "validation", "config"}
_TARGETS = {6, 8}


@dataclass(frozen=True, eq=False)
class Header:
    """A checkpoint's JSON file, validated.

    Attributes:
        path: the weights' file.
        content: the JSON object; :func:`drapenet.training.describe` makes it.
    """

    path: Path
    content: dict[str, Any]

    @property
    def rig(self) -> str:
        """Name of the rig whose drapes the network knows."""
        return self.content["rig"]

    @property
    def scale(self) -> TargetScale:
        """Standardisation of the targets."""
        from drapenet.targets import TargetScale

        targets = self.content["targets"]
        return TargetScale(np.array(targets["mean"]), np.array(targets["std"]))

    def fabrics(self, what: str) -> np.ndarray:
        """(6,) of theta over the fabrics trained on: their ``low`` and ``high``, between which 98 %
        lie, or their standard ``deviation``.
        """
        return np.array(self.content["fabrics"][what])

    @property
    def setups(self) -> Setups:
        """The set-ups of the captures trained on."""
        from data.setups import Setups

        return Setups.from_config(self.content["config"]["setup"])

    def require_rig(self, rig: str) -> None:
        """InputError for captures of another rig than the checkpoint's."""
        if rig != self.rig:
            raise InputError(f"the capture is of the rig '{rig}' but the checkpoint of "
                             f"'{self.rig}'; choose a checkpoint trained for this rig")

    @property
    def identity(self) -> dict[str, str]:
        """What tells this checkpoint from any other: file name, its hash, the dataset's hash."""
        return {
            "file": self.path.name,
            "sha256": self.content["weights"]["sha256"],
            "dataset_sha256": self.content["dataset"]["sha256"],
        }


def bundled(rig: str) -> Path:
    """The checkpoint that comes with the project for a rig; InputError where there is none."""
    path = Path(__file__).parent / "weights" / f"{rig}.safetensors"
    if not path.exists():
        raise InputError(f"no network is bundled for the rig '{rig}'; train one (python train.py) "
                         "and give checkpoint=FILE")
    return path


def read_header(path: str | Path) -> Header:
    """Read and check the JSON file of the checkpoint ``path`` (either file's name, or the stem).

    Light: no weights are read and torch is not imported.

    Raises:
        InputError: a missing or unreadable file, another schema, or incomplete content.
    """
    stem = str(path).removesuffix(".json").removesuffix(".safetensors")
    weights = Path(f"{stem}.safetensors")
    description = weights.with_suffix(".json")
    for file in (weights, description):
        if not file.is_file():
            raise InputError(f"no checkpoint file {file}; give checkpoint=NAME.safetensors with "
                             "NAME.json beside it, or train one with 'make train'")
    try:
        content = json.loads(description.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"cannot read {description}: {error}") from None
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise InputError(f"{description} does not describe a checkpoint of this project")
    if content.get("schema_version") != SCHEMA_VERSION:
        raise InputError(f"{description} has schema version {content.get('schema_version')}, this "
                         f"program reads {SCHEMA_VERSION}; use the program version that wrote it")
    _check_content(content, description)
    return Header(weights, content)


def _check_content(content: dict[str, Any], path: Path) -> None:
    missing = sorted(_HEADER_KEYS - content.keys())
    if missing:
        raise InputError(f"{path} lacks {', '.join(missing)}; it is incomplete, copy it anew")
    try:
        targets = [content["targets"][key] for key in ("mean", "std")]
        fabrics = [content["fabrics"][key] for key in ("low", "high", "deviation")]
        sound = (len(targets[0]) in _TARGETS
                 and all(len(row) == len(targets[0]) for row in targets)
                 and all(len(row) == len(THETA_NAMES) for row in fabrics)
                 and all(math.isfinite(value) for row in (*targets, *fabrics) for value in row)
                 and min(*targets[1], *fabrics[2]) > 0
                 and content["model"]["targets"] == len(targets[0])
                 and isinstance(content["dataset"]["generation"], dict)
                 and isinstance(content["weights"]["sha256"], str)
                 and isinstance(content["dataset"]["sha256"], str))
    except (KeyError, TypeError, ValueError):
        sound = False
    if not sound:
        raise InputError(f"{path}: targets, fabrics, weights or dataset are not described as "
                         "expected; copy it anew")


def load_model(header: Header) -> MapNet:
    """The network of a checkpoint, in float32 on the CPU, ready to predict.

    Raises:
        InputError: the weights are not those that the JSON file describes.
    """
    import torch
    from safetensors import SafetensorError
    from safetensors.torch import load

    from drapenet.network import MapNet

    data = header.path.read_bytes()
    if hashlib.sha256(data).hexdigest() != header.content["weights"]["sha256"]:
        raise InputError(f"{header.path} is not the file that its JSON describes; copy both anew")
    try:
        model = MapNet(**header.content["model"])
        tensors = {name: value.to(torch.float32) if value.is_floating_point() else value
                   for name, value in load(data).items()}
        model.load_state_dict(tensors, strict=True)
    except (SafetensorError, RuntimeError, TypeError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(f"{header.path} does not fit the network: {reason}") from None
    return model.eval()


def save_checkpoint(
    path: Path, *, model: torch.nn.Module, description: dict[str, Any], half: bool
) -> None:
    """Write ``path`` (.safetensors) and its JSON file.

    Args:
        description: content of the JSON file except what this function knows itself.
        half: store convolutions and the last layer in half precision, for shipping.
    """
    import torch
    from safetensors.torch import save

    tensors = {}
    for name, value in model.state_dict().items():
        # Running statistics span many magnitudes and weigh nothing: they stay in full.
        narrow = half and value.is_floating_point() and "running" not in name
        tensors[name] = value.detach().cpu().to(torch.float16 if narrow else value.dtype)
        tensors[name] = tensors[name].contiguous()
    data = save(tensors)
    weights = {"sha256": hashlib.sha256(data).hexdigest(), "half_precision": half}
    content = {"schema": SCHEMA, "schema_version": SCHEMA_VERSION, **description,
               "weights": weights}
    replace_file(path, data)
    replace_file(path.with_suffix(".json"), (json.dumps(content, indent=1) + "\n").encode())


def save_state(
    path: Path,
    *,
    model: torch.nn.Module,
    optimizer: torch.optim.Optimizer,
    record: dict[str, Any],
) -> None:
    """Write all that training needs to go on as if it had never stopped."""
    from safetensors.torch import save

    tensors = {f"model.{name}": value for name, value in model.state_dict().items()}
    for index, moments in optimizer.state_dict()["state"].items():
        tensors |= {f"optimizer.{index}.{name}": value for name, value in moments.items()}
    tensors = {name: value.detach().cpu().contiguous() for name, value in tensors.items()}
    replace_file(path, save(tensors, metadata={"record": json.dumps(record)}))


def load_state(
    path: Path, *, model: torch.nn.Module, optimizer: torch.optim.Optimizer
) -> dict[str, Any]:
    """Put the state of :func:`save_state` into ``model`` and ``optimizer``; return its record.

    Raises:
        InputError: the file is damaged or of another network.
    """
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(path, framework="pt") as file:
            record = json.loads(file.metadata()["record"])
            tensors = {name: file.get_tensor(name) for name in file.keys()}
        model.load_state_dict({name.removeprefix("model."): value
                               for name, value in tensors.items() if name.startswith("model.")})
    except (SafetensorError, RuntimeError, KeyError, TypeError, ValueError, OSError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(f"{path} cannot be resumed ({reason}); remove it to start anew") from None
    moments: dict[int, dict[str, torch.Tensor]] = {}
    for name, value in tensors.items():
        if name.startswith("optimizer."):
            _, index, key = name.split(".")
            moments.setdefault(int(index), {})[key] = value
    groups = optimizer.state_dict()["param_groups"]
    optimizer.load_state_dict({"state": moments, "param_groups": groups})
    return record
