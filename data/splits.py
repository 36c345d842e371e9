"""Finished datasets, and which of their fabrics make a split."""

import hashlib
from bisect import bisect_right
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np

from common.errors import InputError
from data.shards import ANEW, MANIFEST, json_digest, read_manifest

FRACTIONS = MappingProxyType({"train": 0.8, "validation": 0.1, "test": 0.1})


def split_by_fabric(
    fabrics: np.ndarray, *, fractions: Mapping[str, float] = FRACTIONS, seed: int = 0
) -> np.ndarray:
    """Name of the split of each drape, from the ids ``fabrics`` (N,) of their fabrics.

    A fabric's split depends on its id and ``seed`` alone: drapes of a fabric stay together, and
    no fabric changes sides when a dataset grows.

    Raises:
        InputError: the fractions are negative or do not add up to 1.
    """
    shares = list(fractions.values())
    if min(shares) < 0 or abs(sum(shares) - 1) > 1e-9:
        raise InputError(f"the fractions of the splits must add up to 1, not {sum(shares):g}")
    bounds = np.cumsum(shares)[:-1].tolist()
    names = list(fractions)
    ids, position = np.unique(np.asarray(fabrics), return_inverse=True)
    chosen = [names[bisect_right(bounds, _uniform(f"{seed}:{fabric}"))] for fabric in ids]
    return np.array(chosen)[position]


def _uniform(key: str) -> float:
    """A number in [0, 1) that is the same for ``key`` everywhere and always."""
    return int.from_bytes(hashlib.sha256(key.encode()).digest()[:6], "big") / 2**48


def finished_manifest(root: str | Path) -> dict:
    """The content of a dataset's ``dataset.json``.

    Raises:
        InputError: it is missing, unfinished or damaged, or contradicts itself.
    """
    manifest = read_manifest(Path(root))
    if manifest is None:
        raise InputError(f"{root} is not a dataset: dataset.json is missing")
    if not manifest["complete"]:
        raise InputError(f"{root} is unfinished; complete it with python -m data.generate "
                         f"out={root} and the settings it was begun with")
    require_digest(root, manifest["config"], manifest["identity"])
    return manifest


def require_digest(root: str | Path, content: dict, digest: str) -> None:
    """InputError unless a part of the ``dataset.json`` in ``root`` has the digest given there."""
    if json_digest(content) != digest:
        raise InputError(f"{Path(root) / MANIFEST} contradicts itself: its digests are not those "
                         f"of its content; {ANEW}")
