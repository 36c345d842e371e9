"""``dataset.json``, the manifest of a dataset: its settings and shards, with their digests."""

import hashlib
import json
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from common.documents import Excerpt, read_json, shown
from common.errors import InputError
from common.files import replace_json
from sim.rig import Rig

SCHEMA_VERSION = 7  # of manifests and shards
MANIFEST = "dataset.json"
REMEDY = ("remove it and run the command that made the dataset again, which keeps complete shards")


class _Begun(Excerpt):
    """Required content of a manifest."""

    remedy = REMEDY
    identity: str
    drapes: int = Field(ge=1, le=10**9)
    config: dict[str, Any] = Field(min_length=1)
    complete: bool
    provenance: list[Any] = Field(default_factory=list)


class _Sampling(Excerpt):
    testers: list[str]
    random_testers: float


class _Config(Excerpt):
    sampling: _Sampling
    prior: dict[str, Any]


class _Finished(_Begun):
    """Required content of the manifest of a complete dataset."""

    config: _Config
    hash: str
    shards: dict[Annotated[str, Field(pattern=r"^shard_[0-9]{5,9}\.h5$")], str] = Field(
        min_length=1)


def write_manifest(root: Path, content: dict) -> None:
    """Write the dataset's ``dataset.json`` in one step."""
    replace_json(root / MANIFEST, content)


def read_manifest(root: Path) -> dict | None:
    """Read ``dataset.json``; None if it does not exist.

    Raises:
        InputError: it cannot be read, is damaged, or belongs to another schema version.
    """
    path = Path(root) / MANIFEST
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError:
        pass  # read_json reports the reason
    content = read_json(path, remedy=REMEDY)
    if not isinstance(content, dict):
        raise InputError(f"{path} is damaged; {REMEDY}")
    if content.get("schema_version") != SCHEMA_VERSION:
        raise InputError(f"{path} has the schema version {shown(content.get('schema_version'))}; "
                         f"this program reads version {SCHEMA_VERSION}: generate the dataset "
                         "again, in another folder")
    (_Finished if content.get("complete") else _Begun).of(content, f"{path} is damaged")
    return content


def finished_manifest(root: str | Path) -> dict:
    """Read ``dataset.json`` of a complete dataset.

    Raises:
        InputError: it is missing, incomplete, damaged or inconsistent with its digests.
    """
    manifest = read_manifest(Path(root))
    if manifest is None:
        raise InputError(f"{root} is not a dataset: dataset.json is missing; check the path")
    if not manifest["complete"]:
        raise InputError(f"{root} is unfinished; complete it with python -m data.dataset.generate "
                         f"out={root} and its original settings")
    require_digest(root, manifest["config"], manifest["identity"])
    return manifest


def only_tester(root: str | Path, manifest: dict) -> Rig:
    """The tester of all drapes of a dataset; InputError if it has several."""
    sampling = manifest["config"]["sampling"]
    if sampling["random_testers"] or len(sampling["testers"]) != 1:
        raise InputError(f"{root} has drapes of several testers; a network is trained on those of "
                         "a single tester: generate them with dataset.testers=[NAME]")
    return Rig.from_name(sampling["testers"][0])


def require_digest(root: str | Path, content: dict, digest: str) -> None:
    """InputError unless ``content``, part of the ``dataset.json`` in ``root``, has ``digest``."""
    if json_digest(content) != digest:
        raise InputError(f"{Path(root) / MANIFEST}: its digests do not match its content; "
                         f"{REMEDY}")


def json_text(content: object) -> str:
    """The canonical text of a JSON value."""
    return json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False)


def json_digest(content: object) -> str:
    """SHA-256 of a JSON value, hexadecimal."""
    return hashlib.sha256(json_text(content).encode()).hexdigest()
