"""Verification of a dataset's shards against its manifest."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from common.errors import InputError
from data.dataset.manifest import MANIFEST, finished_manifest, require_digest
from data.dataset.progress import over_shards
from data.dataset.shards import SHARDS, Shard


def check_dataset(root: str | Path) -> dict:
    """Verify all shards of the complete dataset in ``root``; return its manifest.

    Raises:
        InputError: no dataset, an incomplete dataset, an inconsistent manifest; a shard that is
            missing, unlisted, damaged, changed or of another dataset; missing or repeated drapes;
            other outcomes.
    """
    root = Path(root)
    manifest = finished_manifest(root)
    require_digest(root, manifest["shards"], manifest["hash"])
    _check_shards(root, manifest)
    return manifest


def _check_shards(root: Path, manifest: dict) -> None:
    """Compare the shards in ``root`` with the manifest."""
    digests = manifest["shards"]
    found = {path.name for path in root.glob(SHARDS)}
    if missing := sorted(digests.keys() - found):
        raise InputError(f"{root} lacks {_listed(missing)}; generate the missing shards with "
                         f"python -m data.dataset.generate out={root} and the dataset's settings")
    if extra := sorted(found - digests.keys()):
        raise InputError(f"{root} holds shards that {MANIFEST} does not list: {_listed(extra)}; "
                         "move them elsewhere")
    changed: list[str] = []
    indices: list[int] = []
    outcomes: Counter[str] = Counter()
    for name, digest in over_shards(digests.items(), "checking"):
        shard = Shard(root / name)
        if shard.digest != digest:
            changed.append(name)
            continue
        identity = shard.attributes.get("identity")
        if identity != manifest["identity"]:
            raise InputError(f"{root / name} belongs to another dataset (identity "
                             f"{str(identity)[:12]} instead of {manifest['identity'][:12]}); "
                             "remove it and generate it again")
        shard.require_valid()
        indices.extend(shard.column("index").tolist())
        outcomes.update(shard.column("status").tolist())
    if changed:
        raise InputError(f"{root}: the content of {_listed(changed)} differs from its digest in "
                         f"{MANIFEST}; remove these files and generate them again")
    if indices != list(range(manifest["drapes"])):
        raise InputError(f"{root} should hold the drapes 0 to {manifest['drapes'] - 1} once each, "
                         f"but its shards hold {len(set(indices))} different ones in "
                         f"{len(indices)} rows")
    if dict(outcomes) != manifest.get("outcomes"):
        raise InputError(f"{root / MANIFEST}: the outcomes counted there differ from those in the "
                         "shards; generate the dataset again, in another folder")


def _listed(names: Sequence[str]) -> str:
    """The first three names, and the number of others."""
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
