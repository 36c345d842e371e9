"""Checkpoints: weights in NAME.safetensors, metadata in NAME.json.

Nothing is unpickled. The state of a training run, for an exact resume, is one safetensors file
with a JSON record in its metadata, so that it is replaced atomically.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Field, PlainValidator, model_validator

from common.documents import (
    Excerpt,
    Schema,
    differences,
    parse_json,
    read_bytes,
    read_json,
    require_regular,
)
from common.errors import InputError, one_line
from common.files import remove_partial, replace_file
from data.captures import Capture, require_one_fabric
from data.fabrics import THETA_NAMES
from drapenet.convention import SWAPPED
from sim.scene import Rig

if TYPE_CHECKING:
    import torch

    from data.setups import Setups
    from drapenet.network import MapNet
    from drapenet.targets import TargetScale

SCHEMA = "drapenet-checkpoint"
SCHEMA_VERSION = 2

MAX_WEIGHTS_BYTES = 2 << 30  # bytes
_SIX = Field(min_length=len(THETA_NAMES), max_length=len(THETA_NAMES))
_Theta = Annotated[list[float], _SIX]
_Positive = Annotated[float, Field(gt=0)]


class _Model(Schema):
    width: int = Field(ge=1, le=512)
    components: int = Field(ge=1, le=32)
    targets: Literal[6, 8]
    distance: _Positive
    spread: _Positive


class _Targets(Schema):
    mean: list[float]
    std: list[_Positive]


class _Fabrics(Schema):
    low: _Theta
    high: _Theta
    deviation: Annotated[list[_Positive], _SIX]


class _Dataset(Excerpt):
    sha256: str
    generation: dict[str, Any]


class _Weights(Excerpt):
    sha256: str


class _Config(Excerpt):
    setup: dict[str, Any]


def _rig(name: object) -> Rig:
    with suppress(InputError):
        return Rig.from_name(name if isinstance(name, str) else "")
    raise ValueError("is not the name of a tester")


class Header(Excerpt):
    """The keys that are read of a checkpoint's JSON file, made by
    :func:`drapenet.training.describe`; ``path`` is the file of the weights.
    """

    remedy = "copy both files again"
    kind: Literal[SCHEMA] = Field(alias="schema")
    schema_version: Literal[SCHEMA_VERSION] = Field(
        description="use the program version that wrote it")
    rig: Annotated[Rig, PlainValidator(_rig)]
    model: _Model
    targets: _Targets
    fabrics: _Fabrics
    dataset: _Dataset
    weights: _Weights
    validation: dict[str, Any]
    config: _Config
    path: Path = Path()

    @model_validator(mode="after")
    def _alike(self) -> Header:
        if not len(self.targets.mean) == len(self.targets.std) == self.model.targets:
            raise ValueError("targets.mean and targets.std must have model.targets="
                             f"{self.model.targets} numbers each")
        return self

    def __hash__(self) -> int:
        return hash(self.weights.sha256)

    @property
    def scale(self) -> TargetScale:
        """Standardisation of the targets."""
        from drapenet.targets import TargetScale

        return TargetScale(np.array(self.targets.mean), np.array(self.targets.std))

    @property
    def spread(self) -> np.ndarray:
        """(6,) standard deviation of theta over the training fabrics, averaged over both orders of
        the yarns, because the first yarns of an estimate need not be the dataset's warp.
        """
        spread = np.array(self.fabrics.deviation)
        return (spread + spread[SWAPPED]) / 2

    @property
    def setups(self) -> Setups:
        """The set-ups of the captures trained on."""
        from data.setups import Setups

        return Setups.from_config(self.config.setup)

    @property
    def identity(self) -> dict[str, str]:
        """File name, hash of the weights and hash of the dataset."""
        return {"file": self.path.name, "sha256": self.weights.sha256,
                "dataset_sha256": self.dataset.sha256}


class Record(Schema):
    """Record in a training state: settings of the run, finished epochs, lowest validation loss."""

    run: dict[str, Any]
    epochs_done: int = Field(ge=0, le=10**9)
    best_loss: float | None


def bundled(rig: Rig) -> Path:
    """The bundled checkpoint of a rig; InputError if there is none."""
    folder = Path(__file__).parent / "weights"
    path = folder / f"{rig.name}.safetensors"
    if not path.exists():
        known = " and ".join(sorted(file.stem for file in folder.glob("*.safetensors")))
        raise InputError(f"no network is bundled for the tester {rig.name}; the bundled networks "
                         f"know {known}: give checkpoint=FILE of a network of this tester "
                         "(python train.py trains one)")
    return path


def read_header(path: str | Path) -> Header:
    """Read and check the JSON file of the checkpoint ``path`` (either file's name, or the stem).

    No weights are read and torch is not imported.

    Raises:
        InputError: a missing or unreadable file, another schema, or incomplete content.
    """
    stem = str(path).removesuffix(".json").removesuffix(".safetensors")
    weights = Path(f"{stem}.safetensors")
    description = weights.with_suffix(".json")
    for file in (weights, description):
        if not os.path.exists(file):
            raise InputError(f"no checkpoint file {file}; give checkpoint=NAME.safetensors with "
                             "NAME.json beside it, or train one with 'make train'")
    content = read_json(description, remedy=Header.remedy)
    return Header.of(content, description).model_copy(update={"path": weights})


def header_for(captures: Sequence[Capture], checkpoint: str = "") -> Header:
    """Header of the checkpoint for captures of one fabric; of the bundled one if none is given.

    Raises:
        InputError: different testers or densities, captures with and without a marked warp, or a
            checkpoint of another tester.
    """
    require_one_fabric([one.rig for one in captures],
                  [one.warp_direction is not None for one in captures],
                  [one.density for one in captures])
    header = read_header(checkpoint or bundled(captures[0].rig))
    if header.rig != captures[0].rig:
        raise InputError(f"the capture is of the tester {captures[0].rig.name} but the checkpoint "
                         f"of {header.rig.name}; choose a checkpoint trained for this tester")
    return header


def load_model(header: Header) -> MapNet:
    """The network of a checkpoint, in float32 on the CPU, in evaluation mode.

    Raises:
        InputError: the weights do not match the JSON file.
    """
    import torch
    from safetensors import SafetensorError
    from safetensors.torch import load

    from drapenet.network import MapNet

    data = read_bytes(header.path, MAX_WEIGHTS_BYTES, "checkpoint")
    if hashlib.sha256(data).hexdigest() != header.weights.sha256:
        raise InputError(f"{header.path} and its JSON do not belong together (checksum); copy "
                         "both again")
    try:
        model = MapNet(**header.model.model_dump())
        tensors = {name: value.to(torch.float32) if value.is_floating_point() else value
                   for name, value in load(data).items()}
        model.load_state_dict(tensors, strict=True)
    except (SafetensorError, RuntimeError, TypeError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(f"{header.path} does not fit the network: {reason}; copy it again"
                         ) from None
    return model.eval()


def save_checkpoint(
    path: Path, *, model: torch.nn.Module, description: dict[str, Any], half: bool
) -> None:
    """Write ``path`` (.safetensors) and its JSON file.

    Args:
        description: content of the JSON file, without schema and weights.
        half: store all but running statistics in half precision.
    """
    import torch
    from safetensors.torch import save

    tensors = {}
    for name, value in model.state_dict().items():
        # Running statistics span many orders of magnitude and are small: full precision.
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
    """Write the state of a training run for an exact resume."""
    from safetensors.torch import save

    tensors = {f"model.{name}": value for name, value in model.state_dict().items()}
    for index, moments in optimizer.state_dict()["state"].items():
        tensors |= {f"optimizer.{index}.{name}": value for name, value in moments.items()}
    tensors = {name: value.detach().cpu().contiguous() for name, value in tensors.items()}
    remove_partial(path.parent, "*.safetensors")  # of runs killed during a write
    replace_file(path, save(tensors, metadata={"record": json.dumps(record)}))


def load_state(
    path: Path, *, run: dict[str, Any], model: torch.nn.Module, optimizer: torch.optim.Optimizer
) -> dict[str, Any]:
    """Load the state of :func:`save_state` into ``model`` and ``optimizer``; return its record.

    Raises:
        InputError: the file is damaged, of another network, or of a run other than ``run``.
    """
    from safetensors import safe_open

    require_regular(path, MAX_WEIGHTS_BYTES, "training's state")
    with _damage_as_input_error(path), safe_open(path, framework="pt") as file:
        record = Record.of(parse_json((file.metadata() or {}).get("record", ""), "record"), "")
        tensors = {name: file.get_tensor(name) for name in file.keys()}
    if changed := differences(record.run, run):
        names = ", ".join(name.removeprefix("settings.") for name in changed)
        raise InputError(f"{path.parent} contains a training with other settings ({names}); choose "
                         "another out=, or remove it (epochs must be the same, because the "
                         "learning rate depends on them)")
    with _damage_as_input_error(path):
        model.load_state_dict({name.removeprefix("model."): value
                               for name, value in tensors.items() if name.startswith("model.")})
        moments: dict[int, dict[str, torch.Tensor]] = {}
        for name, value in tensors.items():
            if name.startswith("optimizer."):
                _, index, key = name.split(".")
                moments.setdefault(int(index), {})[key] = value
        for index, parameter in enumerate(optimizer.param_groups[0]["params"] if moments else ()):
            shapes = {name: value.shape for name, value in moments[index].items()}
            if shapes != {"step": (), "exp_avg": parameter.shape, "exp_avg_sq": parameter.shape}:
                raise ValueError(f"moments of parameter {index} are missing or of another shape")
    groups = optimizer.state_dict()["param_groups"]
    optimizer.load_state_dict({"state": moments, "param_groups": groups})
    return record.model_dump()


@contextmanager
def _damage_as_input_error(path: Path) -> Iterator[None]:
    """Raise InputError for a damaged training state ``path``."""
    from safetensors import SafetensorError

    try:
        yield
    except (SafetensorError, RuntimeError, KeyError, TypeError, ValueError, OSError) as error:
        raise InputError(f"{path} cannot be resumed ({one_line(error)}); remove it to start again"
                         ) from None
