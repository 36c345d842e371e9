"""Checkpoints: a safetensors file with the weights, and their description in its metadata."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

import numpy as np
from pydantic import Field

from common.documents import Excerpt, Schema, parse_json, read_bytes
from common.errors import InputError, one_line
from common.graphs import MAX_WEIGHTS_BYTES
from common.types import Theta
from data.fabrics.fabrics import THETA_NAMES
from data.fabrics.nuisances import NuisanceConfig
from data.rigs import DIAMETERS
from drapenet.config import Backbone, Input, Output
from sim.material import SWAPPED
from sim.rig import Rig

if TYPE_CHECKING:
    from data.render.setups import Setups
    from drapenet.network.calibration import Calibration
    from drapenet.network.targets import TargetScale

SCHEMA = "drapenet-checkpoint"
"""Key of the description in the metadata of a checkpoint."""
SCHEMA_VERSION = 8
BUNDLED = Path(__file__).parents[1] / "weights" / "drapenet.safetensors"

_SIX = Field(min_length=len(THETA_NAMES), max_length=len(THETA_NAMES))
_TEN = Field(min_length=10, max_length=10)
_Pair = Annotated[list[float], Field(min_length=2, max_length=2)]
_Positive = Annotated[float, Field(gt=0)]


class _Model(Schema):
    """Arguments of :func:`drapenet.network.model.make_network`."""

    backbone: Backbone | None = None
    output: Output = "posterior"
    width: int = Field(ge=1, le=512)
    components: int = Field(ge=1, le=32)
    dropout: float = Field(ge=0, lt=1)
    distance: float
    spread: _Positive
    rectangles: bool = False
    expected: bool = False


class _Targets(Schema):
    mean: Annotated[list[float], _TEN]
    std: Annotated[list[_Positive], _TEN]


class _Fabrics(Schema):
    low: Annotated[list[float], _SIX]
    high: Annotated[list[float], _SIX]
    deviation: Annotated[list[_Positive], _SIX]
    ratio: _Positive


class _Prior(Schema):
    """The fabrics and their nuisances that a network answers for, before it has seen anything."""

    fabrics: dict[str, Any]
    even_share: float
    anisotropy: _Pair
    anisotropy_varied: _Pair
    nuisances: dict[str, Any]


class _Calibration(Schema):
    """Fields of :class:`drapenet.network.calibration.Calibration`, as lists."""

    mean: list[float]
    spread: list[_Positive]
    slopes: list[list[float]]


class _Dataset(Excerpt):
    """What a network was trained on, the newest last."""

    sha256: list[str]
    generation: list[dict[str, Any]]


class _Config(Excerpt):
    setup: dict[str, Any]
    inputs: list[Input] = Field(default_factory=lambda: list(get_args(Input)))


class Header(Excerpt):
    """The keys read of a checkpoint's description; ``path`` and ``sha256``: of the file."""

    remedy = "copy it again"
    schema_version: Literal[SCHEMA_VERSION] = Field(  # type: ignore[valid-type]
        description="use the program version that wrote it")
    model: _Model
    targets: _Targets
    fabrics: _Fabrics
    prior: _Prior
    dataset: _Dataset
    validation: dict[str, Any]
    calibrated: _Calibration | None = None
    config: _Config
    path: Path = Path()
    sha256: str = ""

    def __hash__(self) -> int:
        return hash(self.sha256)

    @property
    def scale(self) -> TargetScale:
        from drapenet.network.targets import TargetScale

        return TargetScale(np.array(self.targets.mean), np.array(self.targets.std))

    @property
    def calibration(self) -> Calibration | None:
        """Of its deviations; None of a training that was stopped before its end."""
        from drapenet.network.calibration import Calibration

        if self.calibrated is None:
            return None
        return Calibration(**{name: np.array(one) for name, one in vars(self.calibrated).items()})

    @property
    def spread(self) -> Theta:
        """Standard deviation of theta over the prior's fabrics, mean of both orders of yarns: the
        first yarns of an estimate need not be the dataset's warp."""
        spread = np.array(self.fabrics.deviation)
        return (spread + spread[SWAPPED]) / 2

    @property
    def nuisances(self) -> NuisanceConfig:
        """Distribution of the other properties of the specimens that it answers for."""
        return NuisanceConfig.of_json(self.prior.nuisances)

    @property
    def setups(self) -> Setups:
        from data.render.setups import Setups

        return Setups.from_config(self.config.setup)

    def require_learned(self, rig: Rig) -> None:
        """InputError for a tester unlike those that the network was trained on."""
        small = round(1e3 * min(rig.sides), 6) < DIAMETERS[0]
        if not self.model.rectangles and (rig.specimen == "rectangle" or small):
            raise InputError(
                f"tester {rig.name}: the network {self.path.name} has learned squares and discs of "
                f"{DIAMETERS[0]:g} mm and more, no rectangles; give a specimen that it knows, or "
                "the checkpoint of a network that was trained on rectangles")
        drawn = [one["sampling"] for one in self.dataset.generation]
        named = {Rig.from_name(name) for one in drawn for name in one["testers"]}
        if rig not in named and not any(one["random_testers"] + one["rectangles"] for one in drawn):
            raise InputError(
                f"tester {rig.name}: the network {self.path.name} has learned drapes on "
                f"{', '.join(sorted(one.name for one in named))} alone; give a specimen that it "
                "knows, or the checkpoint of a network that was trained with dataset=testers")

    def require_input(self, kind: Input) -> None:
        """InputError for a capture of a kind that the network was not trained on."""
        if kind not in self.config.inputs:
            raise InputError(f"the network {self.path.name} was trained to read "
                             f"{', '.join(self.config.inputs)}, not {kind} alone; give a capture "
                             "that it reads, or the checkpoint of a network that was trained with "
                             f"inputs=[{kind}]")

    @property
    def identity(self) -> dict[str, str]:
        """Name and hash of the file, and hash of its newest dataset."""
        return {"file": self.path.name, "sha256": self.sha256,
                "dataset_sha256": self.dataset.sha256[-1]}


def read_header(path: str | Path = "") -> Header:
    """Read and check the description in a checkpoint, without torch; the bundled one if ``path`` is
    empty."""
    path = Path(path or BUNDLED)
    if not path.exists():
        raise InputError(f"no checkpoint file {path}; give checkpoint=NAME.safetensors, or train a "
                         "network with 'make train'")
    digest = hashlib.sha256(read_bytes(path, MAX_WEIGHTS_BYTES, "checkpoint")).hexdigest()
    header = Header.of(read_description(path), path)
    return header.model_copy(update={"path": path, "sha256": digest})


def read_description(path: Path) -> Any:
    """What a checkpoint's metadata state, not checked."""
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(path, framework="numpy") as file:
            text = (file.metadata() or {}).get(SCHEMA)
    except SafetensorError as error:
        raise InputError(f"{path} is not a safetensors file ({one_line(error)}); {Header.remedy}"
                         ) from None
    if text is None:
        raise InputError(f"{path} does not describe its network; give a file that train.py of this "
                         "version has written")
    return parse_json(text, path, Header.remedy)
