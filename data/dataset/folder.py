"""The folder of a dataset: identity, complete shards and their content.

There is no lock, as locks are unreliable on the shared file systems of clusters. Any number of
processes may work in a folder: a file is renamed to its final name when it is complete, and all
processes write the same bytes of a shard; the manifest reveals different settings.
"""

from collections import Counter
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from common.documents import differences, parse_json
from common.errors import InputError
from common.files import PARTIAL_SUFFIX, remove_partial
from common.provenance import environment
from data.dataset.manifest import (
    MANIFEST,
    SCHEMA_VERSION,
    json_digest,
    json_text,
    read_manifest,
    write_manifest,
)
from data.dataset.progress import over_shards
from data.dataset.shards import SHARDS, Shard, shard_name, write_shard
from data.dataset.simulate import DatasetConfig, Record
from data.fabrics.prior import prior_content


@dataclass(frozen=True)
class Content:
    """Content of a shard: SHA-256 of the file, and columns of its drapes."""

    digest: str
    statuses: list[str]
    starts: list[str]
    fabrics: list[int]
    rejected: list[int]


@dataclass(frozen=True)
class DatasetFolder:
    """The folder ``root`` of the dataset ``config``."""

    root: Path
    config: DatasetConfig

    @cached_property
    def identity(self) -> str:
        """SHA-256 of the configuration."""
        return json_digest(self.config.as_dict())

    @property
    def _described(self) -> dict:
        return {
            "schema_version": SCHEMA_VERSION,
            "identity": self.identity,
            "drapes": self.config.drapes,
            "config": self.config.as_dict(),
            "prior": self._prior,
        }

    @cached_property
    def _prior(self) -> dict:
        prior = self.config.prior
        return {"kind": prior.kind, "sha256": json_digest(prior_content(prior))}

    @cached_property
    def _settings(self) -> dict:
        """The configuration as stored in shards: with the digest of the prior, which may be large.
        """
        return self.config.as_dict() | {"prior": self._prior}

    def claim(self) -> None:
        """Create the folder, or check that it holds this dataset or part of it.

        Raises:
            InputError: the folder cannot be created, or holds another dataset, more drapes, or
                other files without a dataset.
        """
        try:
            self.root.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"cannot create the folder {self.root}: {error.strerror}") from None
        manifest = read_manifest(self.root)
        if manifest is not None:
            settings = manifest["config"] | {"prior": manifest.get("prior")}
            self._require_same(manifest["identity"], settings)
            if manifest["drapes"] > self.config.drapes:
                raise InputError(f"{self.root} contains {manifest['drapes']} drapes; drapes="
                                 f"{self.config.drapes} must be {manifest['drapes']} or more")
        else:
            shards = set(self.root.glob(SHARDS))
            for path in sorted(shards):
                self._adopt(path)
            for path in sorted(self.root.iterdir()):
                # Hidden files belong to the system, partial files to another job.
                if path not in shards and path.suffix != PARTIAL_SUFFIX and path.name[0] != ".":
                    raise InputError(f"{self.root} holds {path.name} and no {MANIFEST}: it is not "
                                     "a dataset's; choose a new or empty folder")

    def _adopt(self, path: Path) -> None:
        """InputError unless a shard, found without a manifest, belongs to this dataset."""
        try:
            attributes = Shard(path).attributes
        except InputError:
            raise InputError(f"{self.root} has no {MANIFEST}, and {path.name} in it is damaged or "
                             "not a shard; remove it, or choose another folder") from None
        self._require_same(attributes.get("identity"),
                           parse_json(attributes.get("config", ""), path))

    def _require_same(self, identity: object, settings: dict) -> None:
        if identity != self.identity:
            changed = ", ".join(differences(settings, self._settings)) or "unknown settings"
            raise InputError(f"{self.root} holds a dataset with other settings ({changed}); choose "
                             "another folder, or remove it")

    def content(self, shard: int) -> Content | None:
        """Content of a shard; None if it is missing, damaged or has other drapes than required.

        The last shard grows when a dataset is extended.
        """
        path = self.root / shard_name(shard)
        if not path.exists():
            return None
        try:
            found = Shard(path)
        except InputError:
            return None
        if (found.attributes.get("identity") != self.identity
                or found.column("index").tolist() != list(self.config.rows(shard))):
            return None
        return Content(found.digest, *(found.column(name).tolist() for name in
                                       ("status", "start", "fabric", "rejected")))

    def write(self, shard: int, records: list[Record]) -> None:
        """Write a shard.

        Raises:
            InputError: the file cannot be written; the folder holds another dataset or more drapes
                by now.
        """
        self.claim()
        name = shard_name(shard)
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

    def begin(self) -> None:
        """Mark the dataset as incomplete in the manifest."""
        found = read_manifest(self.root) or {}
        begun = self._described | {"complete": False, "provenance": _provenance(found, made=True)}
        if found != begun:
            write_manifest(self.root, begun)

    def finish(self, *, made: bool = True) -> dict:
        """Write the manifest if all shards are complete; return it, complete or not.

        ``made``: whether this process has made shards.
        """
        self.claim()  # another process may have extended the dataset meanwhile
        names = [shard_name(shard) for shard in range(self.config.shards)]
        contents: dict[str, Content | None] = {}
        # Existence first: reading is wasted while other parts are unfinished.
        if all((self.root / name).exists() for name in names):
            contents = {name: self.content(shard)
                        for shard, name in enumerate(over_shards(names, "checking"))}
        if not contents or None in contents.values():
            return self._described | {"complete": False}
        found = read_manifest(self.root) or {}
        manifest = (self._described | {"complete": True} | _summary(contents)
                    | {"provenance": _provenance(found, made=made)})
        if found != manifest:
            write_manifest(self.root, manifest)
        self.remove_partial()
        return manifest

    def remove_partial(self) -> None:
        """Remove temporary files of interrupted writers (:func:`remove_partial`)."""
        for pattern in (SHARDS, MANIFEST):
            remove_partial(self.root, pattern)


def _provenance(found: dict, *, made: bool) -> list[dict]:
    """Environments in which shards were made: those in the manifest, and the present one if new.

    Stored only in the manifest, outside its digests.
    """
    earlier = found.get("provenance", [])
    if not made:
        return earlier
    here = environment()
    return earlier if here in earlier else [*earlier, here]


def _summary(contents: dict[str, Content]) -> dict:
    """Counts over all shards, and the digest that identifies the dataset's content."""
    outcomes: Counter[str] = Counter()
    starts: Counter[str] = Counter()
    rejected: dict[int, int] = {}
    for content in contents.values():
        outcomes.update(content.statuses)
        starts.update(content.starts)
        rejected.update(zip(content.fabrics, content.rejected, strict=True))
    samples = len(rejected) + sum(rejected.values())
    digests = {name: content.digest for name, content in contents.items()}
    return {
        "fabrics": len(rejected),
        "outcomes": dict(sorted(outcomes.items())),
        "starts": dict(sorted(starts.items())),
        "rejection_rate": sum(rejected.values()) / samples,
        "hash": json_digest(digests),
        "shards": digests,
    }
