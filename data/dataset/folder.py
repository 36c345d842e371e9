"""The folder of a dataset: its shards, and ``dataset.json``, the manifest of settings and shards.

Any number of processes may work in a folder without a lock: files are renamed to their final names
when they are complete, and all processes on machines of one kind write the same bytes of a shard.
The manifest reveals different settings, among them the device and the code that makes the drapes.
"""

import hashlib
from bisect import bisect_right
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field
from tqdm import tqdm

from common.cases import progress_bar
from common.documents import Excerpt, differences, read_json
from common.errors import InputError, shown
from common.files import PARTIAL_SUFFIX, remove_partial, replace_json
from common.provenance import digest, environment, json_text
from data.dataset.batches import device_name
from data.dataset.config import DatasetConfig
from data.dataset.shards import SCHEMA_VERSION, SHARDS, Shard, shard_name, write_shard
from data.dataset.simulate import Record, Solver, make_record
from data.fabrics.prior import prior_content

MANIFEST = "dataset.json"
REMEDY = "remove it and run the command that made the dataset again, which keeps complete shards"
DELAY = 2.0  # s; shorter tasks show no bar


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

    config: _Config  # type: ignore[assignment]
    hash: str
    shards: dict[Annotated[str, Field(pattern=r"^shard_[0-9]{5,9}\.h5$")], str] = Field(
        min_length=1)


def read_manifest(root: Path) -> dict | None:
    """Read ``dataset.json``; None if it does not exist."""
    path = root / MANIFEST
    if not path.exists():
        return None
    content = read_json(path, remedy=REMEDY)
    if not isinstance(content, dict):
        raise InputError(f"{path} is damaged; {REMEDY}")
    if content.get("schema_version") != SCHEMA_VERSION:
        raise InputError(f"{path} has the schema version {shown(content.get('schema_version'))}; "
                         f"this program reads version {SCHEMA_VERSION}: generate the dataset "
                         "again, in another folder")
    (_Finished if content.get("complete") else _Begun).of(content, f"{path} is damaged")
    return content


def require_dataset(data: str) -> Path:
    """The folder ``data`` of a dataset, finished or not; InputError if it is none."""
    if not data or read_manifest(Path(data)) is None:
        raise InputError(f"data={data}: dataset.json is missing; give the folder of a dataset of "
                         "python -m data.dataset.generate")
    return Path(data)


def finished_manifest(root: Path) -> dict:
    """The manifest of a complete dataset; InputError if there is none."""
    manifest = read_manifest(root)
    if manifest is None:
        raise InputError(f"{root} is not a dataset: dataset.json is missing; check the path")
    if not manifest["complete"]:
        raise InputError(f"{root} is unfinished; complete it with python -m data.dataset.generate "
                         f"out={root} and its original settings")
    if (digest(manifest["config"]) != manifest["identity"]
            or digest(manifest["shards"]) != manifest["hash"]):
        raise InputError(f"{root / MANIFEST}: its digests do not match its content; {REMEDY}")
    return manifest


@dataclass(frozen=True)
class DatasetFolder:
    """The folder ``root`` of the dataset ``config``."""

    root: Path
    config: DatasetConfig

    @cached_property
    def identity(self) -> str:
        """SHA-256 of the configuration."""
        return digest(self.config.as_dict())

    @cached_property
    def _prior(self) -> dict:
        prior = self.config.prior
        return {"kind": prior.kind, "sha256": digest(prior_content(prior))}

    @cached_property
    def _settings(self) -> dict:
        """The configuration as stored in shards, with the digest of the prior, which is large."""
        return self.config.as_dict() | {"prior": self._prior}

    def claim(self) -> dict:
        """Create the folder, or check that it holds only this dataset; return its manifest or {}.
        """
        try:
            self.root.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"cannot create the folder {self.root}: {error.strerror}") from None
        manifest = read_manifest(self.root)
        if manifest is None:
            for path in sorted(self.root.iterdir()):
                # Hidden files belong to the system, partial files to another job.
                if not (path.suffix == PARTIAL_SUFFIX or path.name[0] == "." or self._owns(path)):
                    raise InputError(f"{self.root} holds {path.name} and no {MANIFEST} of this "
                                     "dataset; choose a new or empty folder")
            return {}
        if manifest["identity"] != self.identity:
            settings = manifest["config"] | {"prior": manifest.get("prior")}
            changed = differences(settings, self._settings)
            if changed == ["version"]:
                raise InputError(f"{self.root} was begun by another version of the simulator, "
                                 "whose drapes may differ; finish it with that version (provenance "
                                 f"in {MANIFEST}), or choose another folder")
            raise InputError(f"{self.root} holds a dataset with other settings "
                             f"({', '.join(changed) or 'unknown settings'}); choose another "
                             "folder, or remove it")
        if manifest["drapes"] > self.config.drapes:
            raise InputError(f"{self.root} contains {manifest['drapes']} drapes; drapes="
                             f"{self.config.drapes} must be {manifest['drapes']} or more")
        return manifest

    def _owns(self, path: Path) -> bool:
        """Whether a file is a shard of this dataset."""
        try:
            return Shard(path).attributes.get("identity") == self.identity
        except InputError:
            return False

    def shard(self, number: int) -> Shard | None:
        """A complete shard; None if it is missing or damaged, or has less drapes than it will."""
        try:
            shard = Shard(self.root / shard_name(number))
        except InputError:
            return None
        complete = (shard.attributes.get("identity") == self.identity
                    and shard.column("index").tolist() == list(self.config.rows(number)))
        return shard if complete else None

    def write(self, number: int, records: list[Record]) -> None:
        """Write a shard, unless the folder holds another dataset by now."""
        self.claim()
        name = shard_name(number)
        try:
            remove_partial(self.root, name)
            write_shard(self.root / name, records, attributes={
                "schema_version": SCHEMA_VERSION,
                "identity": self.identity,
                "config": json_text(self._settings),
            })
        except InputError as error:
            raise InputError(f"{error}; free disk space or choose another folder, and run the same "
                             "command again: finished shards are kept") from None

    def make(self, number: int, counts: str, place: int, solver: Solver | None) -> None:
        """Make a shard, unless another run has done so.

        ``counts`` is a file shared by all processes, (shards, 2): drapes made and failed in the
        shard at each index (``place``).
        """
        done = np.memmap(counts, np.int64, "r+").reshape(-1, 2)
        rows = self.config.rows(number)
        if self.shard(number) is None:
            records: list[Record] = []
            for index in rows:
                records.append(make_record(index, self.config, earlier=records, solver=solver))
                done[place] += 1, records[-1]["status"] != b"converged"
            self.write(number, records)
        done[place, 0] = len(rows)

    def begin(self) -> None:
        """Mark the dataset as incomplete in the manifest, made in the present environment."""
        manifest = self.claim()
        provenance, here = manifest.get("provenance", []), environment()
        if self.config.device:
            here = here | {"device": device_name(self.config.device)}
        if here not in provenance:
            provenance = [*provenance, here]
        self._update(manifest, {"complete": False}, provenance)

    def finish(self) -> dict:
        """Write the manifest if all shards are complete; return it, complete or not."""
        manifest = self.claim()  # another process may have extended the dataset meanwhile
        names = [shard_name(number) for number in range(self.config.shards)]
        # Existence first: reading is wasted while other parts are unfinished.
        exist = all((self.root / name).exists() for name in names)
        summary = self._summary(names) if exist else {"complete": False}
        if not summary["complete"]:
            return self._described | summary
        manifest = self._update(manifest, summary, manifest.get("provenance", []))
        self.remove_partial()
        return manifest

    @property
    def _described(self) -> dict:
        return {
            "schema_version": SCHEMA_VERSION,
            "identity": self.identity,
            "drapes": self.config.drapes,
            "config": self.config.as_dict(),
            "prior": self._prior,
        }

    def _update(self, old: dict, summary: dict, provenance: list[dict]) -> dict:
        """Write the manifest unless it is the same as the ``old`` one; return it."""
        manifest = self._described | summary | {"provenance": provenance}
        if manifest != old:
            replace_json(self.root / MANIFEST, manifest)
        return manifest

    def _summary(self, names: list[str]) -> dict:
        """Counts over all shards, and the digest that identifies the dataset's content."""
        outcomes: Counter[str] = Counter()
        starts: Counter[str] = Counter()
        rejected: dict[int, int] = {}
        digests = {}
        for number, name in enumerate(over_shards(names, "checking")):
            shard = self.shard(number)
            if shard is None:
                return {"complete": False}
            outcomes.update(shard.column("status").tolist())
            starts.update(shard.column("start").tolist())
            rejected.update(zip(shard.column("fabric").tolist(), shard.column("rejected").tolist(),
                                strict=True))
            digests[name] = shard.digest
        samples = len(rejected) + sum(rejected.values())
        return {
            "complete": True,
            "fabrics": len(rejected),
            "outcomes": dict(sorted(outcomes.items())),
            "starts": dict(sorted(starts.items())),
            "rejection_rate": sum(rejected.values()) / samples,
            "hash": digest(digests),
            "shards": digests,
        }

    def remove_partial(self) -> None:
        """Remove temporary files of interrupted writers."""
        for pattern in (SHARDS, MANIFEST):
            remove_partial(self.root, pattern)


def over_shards(shards: Iterable, doing: str) -> tqdm:
    """Iterate over ``shards`` with a bar labelled ``doing``."""
    return progress_bar(shards, desc=doing, unit="shard", leave=False, delay=DELAY)


def split_by_fabric(fabrics: np.ndarray, *, fractions: Mapping[str, float]) -> np.ndarray:
    """Name of the split of each drape, from the ids ``fabrics`` (N,) of their fabrics alone, so
    that extending a dataset changes no split; ``fractions`` add up to 1.
    """
    bounds, names = np.cumsum(list(fractions.values()))[:-1].tolist(), list(fractions)
    ids, position = np.unique(np.asarray(fabrics), return_inverse=True)
    digests = [hashlib.sha256(f"0:{fabric}".encode()).digest() for fabric in ids]
    uniform = [int.from_bytes(digest[:6], "big") / 2**48 for digest in digests]
    return np.array([names[bisect_right(bounds, number)] for number in uniform])[position]
