"""Checkpoints: a safetensors file with the weights, and their description in its metadata."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Field, PlainValidator, model_validator

from common.documents import Excerpt, Schema, parse_json, read_bytes
from common.errors import InputError, one_line
from common.files import replace_file
from common.types import Theta
from data.captures.capture import Capture, require_one_fabric
from data.fabrics.fabrics import THETA_NAMES
from sim.material import SWAPPED
from sim.rig import Rig

if TYPE_CHECKING:
    import torch

    from data.render.setups import Setups
    from drapenet.network.model import MapNet
    from drapenet.network.targets import TargetScale

SCHEMA = "drapenet-checkpoint"
"""Key of the description in the metadata of a checkpoint."""
SCHEMA_VERSION = 3

MAX_WEIGHTS_BYTES = 2 << 30
_SIX = Field(min_length=len(THETA_NAMES), max_length=len(THETA_NAMES))
_Positive = Annotated[float, Field(gt=0)]


def _rig(name: object) -> Rig:
    with suppress(InputError):
        return Rig.from_name(name if isinstance(name, str) else "")
    raise ValueError("is not the name of a tester")


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
    low: Annotated[list[float], _SIX]
    high: Annotated[list[float], _SIX]
    deviation: Annotated[list[_Positive], _SIX]


class _Dataset(Excerpt):
    sha256: str
    generation: dict[str, Any]


class _Config(Excerpt):
    setup: dict[str, Any]


class Header(Excerpt):
    """The keys read of a checkpoint's description; ``path`` and ``sha256`` are those of the file.
    """

    remedy = "copy it again"
    schema_version: Literal[SCHEMA_VERSION] = Field(
        description="use the program version that wrote it")
    rig: Annotated[Rig, PlainValidator(_rig)]
    model: _Model
    targets: _Targets
    fabrics: _Fabrics
    dataset: _Dataset
    validation: dict[str, Any]
    config: _Config
    path: Path = Path()
    sha256: str = ""

    @model_validator(mode="after")
    def _alike(self) -> Header:
        if not len(self.targets.mean) == len(self.targets.std) == self.model.targets:
            raise ValueError("targets.mean and targets.std must have model.targets="
                             f"{self.model.targets} numbers each")
        return self

    def __hash__(self) -> int:
        return hash(self.sha256)

    @property
    def scale(self) -> TargetScale:
        from drapenet.network.targets import TargetScale

        return TargetScale(np.array(self.targets.mean), np.array(self.targets.std))

    @property
    def spread(self) -> Theta:
        """Standard deviation of theta over the training fabrics, mean of both orders of yarns."""
        # The first yarns of an estimate need not be the dataset's warp.
        spread = np.array(self.fabrics.deviation)
        return (spread + spread[SWAPPED]) / 2

    @property
    def setups(self) -> Setups:
        from data.render.setups import Setups

        return Setups.from_config(self.config.setup)

    @property
    def identity(self) -> dict[str, str]:
        """Name and hash of the file, and hash of the dataset."""
        return {"file": self.path.name, "sha256": self.sha256,
                "dataset_sha256": self.dataset.sha256}


def bundled(rig: Rig) -> Path:
    """The bundled checkpoint of a rig; InputError if there is none."""
    folder = Path(__file__).parents[1] / "weights"
    path = folder / f"{rig.name}.safetensors"
    if not path.exists():
        testers = " and ".join(sorted(file.stem for file in folder.glob("*.safetensors")))
        raise InputError(f"no network is bundled for the tester {rig.name}; the bundled networks "
                         f"know {testers}: give checkpoint=FILE of a network of this tester "
                         "(python train.py trains one)")
    return path


def read_header(path: str | Path) -> Header:
    """Read and check the description in the checkpoint ``path``, without torch."""
    from safetensors import SafetensorError, safe_open

    path = Path(path)
    if not path.exists():
        raise InputError(f"no checkpoint file {path}; give checkpoint=NAME.safetensors, or train a "
                         "network with 'make train'")
    digest = hashlib.sha256(read_bytes(path, MAX_WEIGHTS_BYTES, "checkpoint")).hexdigest()
    try:
        with safe_open(path, framework="numpy") as file:
            text = (file.metadata() or {}).get(SCHEMA)
    except SafetensorError as error:
        raise InputError(f"{path} is not a safetensors file ({one_line(error)}); {Header.remedy}"
                         ) from None
    if text is None:
        raise InputError(f"{path} does not describe its network; give a file that train.py of this "
                         "version has written")
    header = Header.of(parse_json(text, path, Header.remedy), path)
    return header.model_copy(update={"path": path, "sha256": digest})


def header_for(captures: Sequence[Capture], checkpoint: str = "") -> Header:
    """Header of the checkpoint for captures of one fabric; of the bundled one if none is given."""
    for capture in captures:
        if capture.outline is not None:
            raise InputError(f"{capture.path}: a photograph from above is read and checked, but "
                             "not yet estimated; give depth views")
    require_one_fabric([capture.rig for capture in captures],
                       [capture.warp_direction is not None for capture in captures],
                       [capture.density for capture in captures],
                       [(str(capture.path), capture.digest) for capture in captures])
    header = read_header(checkpoint or bundled(captures[0].rig))
    if header.rig != captures[0].rig:
        raise InputError(f"the capture is of the tester {captures[0].rig.name} but the checkpoint "
                         f"of {header.rig.name}; choose a checkpoint trained for this tester")
    return header


def load_model(header: Header) -> MapNet:
    """The network of a checkpoint, in float32 on the CPU, in evaluation mode."""
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    from drapenet.network.model import MapNet

    try:
        model = MapNet(**header.model.model_dump())
        model.load_state_dict(load_file(header.path))  # converts to float32
    except (SafetensorError, RuntimeError, TypeError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(f"{header.path} does not fit the network: {reason}; copy it again"
                         ) from None
    return model.eval()


def save_checkpoint(
    path: Path, *, model: torch.nn.Module, description: dict[str, Any], half: bool
) -> None:
    """Write the checkpoint ``path``; ``half``: all but running statistics in half precision."""
    from safetensors.torch import save

    tensors = {}
    for name, value in model.state_dict().items():
        # Running statistics span many orders of magnitude and are small: full precision.
        narrow = half and value.is_floating_point() and "running" not in name
        tensors[name] = (value.half() if narrow else value).cpu().contiguous()
    content = {"schema_version": SCHEMA_VERSION} | description
    replace_file(path, save(tensors, metadata={SCHEMA: json.dumps(content)}))
