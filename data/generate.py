"""Makes datasets of simulated drapes: ``python -m data.generate --help``.

    prior -> plan of a drape -> equilibrium -> views -> record -> shard

A drape depends on the dataset's configuration and its index only, so any number of processes
write the same files, and an interrupted dataset is completed as if nothing had happened.
"""

import fcntl
import os
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NoReturn

from tqdm import tqdm

from data.options import Options, config_from_options
from data.records import DatasetConfig, Renderer, Solver
from data.shards import (
    SCHEMA_VERSION,
    Shard,
    file_digest,
    json_digest,
    json_text,
    read_manifest,
    shard_name,
    write_manifest,
    write_shard,
)
from data.workers import make_records
from sim.cli import run_command
from sim.errors import InputError, one_line
from sim.files import PARTIAL_SUFFIX


def generate_dataset(
    config: DatasetConfig,
    out: str | Path,
    *,
    workers: int = 1,
    progress: bool = True,
    solver: Solver | None = None,
    renderer: Renderer | None = None,
) -> dict:
    """Make, complete or extend the dataset in the folder ``out``.

    Args:
        config: all that determines the files.
        out: folder; created where it is missing.
        workers: processes of one thread each; without influence on the files.
        progress: show a progress bar on standard error.
        solver, renderer: in place of :func:`sim.drape.drape` and
            :class:`data.render.DepthRenderer`; of an importable module.

    Returns:
        The content of ``dataset.json``: configuration, counts of every outcome, digests.

    Raises:
        InputError: ``out`` cannot be written, holds a dataset of another configuration or with
            more drapes, or is being written by another process.
    """
    if workers < 1:
        raise InputError(f"workers={workers} must be at least 1")
    root = Path(out)
    try:
        root.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot create the folder {root}: {error.strerror}") from None
    try:
        with _sole_writer(root):
            identity = _identify(root, config)
            described = {
                "schema_version": SCHEMA_VERSION,
                "identity": identity,
                "drapes": config.drapes,
                "config": config.as_dict(),
            }
            for leftover in root.glob("shard_*.h5" + PARTIAL_SUFFIX):
                leftover.unlink()
            missing = [shard for shard in range(config.shards)
                       if not _is_complete(root, shard, config, identity)]
            if missing:
                write_manifest(root, described | {"complete": False})
            _fill(root, missing, config, identity, workers=workers, progress=progress,
                  solver=solver, renderer=renderer)
            manifest = described | {"complete": True} | _summarise(root, config)
            write_manifest(root, manifest)
    except OSError as error:
        raise InputError(f"cannot write the dataset {root}: {one_line(error)}") from None
    return manifest


@contextmanager
def _sole_writer(root: Path) -> Iterator[None]:
    """Hold a lock on the folder, which ends with the process however it ends."""
    handle = os.open(root, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(f"another process is generating {root}; wait for it") from None
        yield
    finally:
        os.close(handle)


def _identify(root: Path, config: DatasetConfig) -> str:
    """The configuration's digest; InputError where the folder is another configuration's."""
    content = config.as_dict()
    identity = json_digest(content)
    found = read_manifest(root)
    if found is None:
        if any(root.glob("shard_*.h5")):
            raise InputError(f"{root} holds shards without dataset.json; choose another folder")
    elif found.get("identity") != identity:
        changed = ", ".join(_differences(found.get("config", {}), content)) or "unknown settings"
        raise InputError(f"{root} holds a dataset with other settings ({changed}); choose another "
                         "folder, or remove it")
    elif found["drapes"] > config.drapes:
        raise InputError(f"{root} holds {found['drapes']} drapes already; ask for as many or more")
    return identity


def _differences(old: object, new: object, prefix: str = "") -> list[str]:
    """Dotted names of the settings that differ."""
    if not (isinstance(old, dict) and isinstance(new, dict)):
        return [] if old == new else [prefix]
    names = sorted(old.keys() | new.keys())
    return [difference for name in names for difference in
            _differences(old.get(name), new.get(name), f"{prefix}.{name}" if prefix else name)]


def _is_complete(root: Path, shard: int, config: DatasetConfig, identity: str) -> bool:
    """Whether a shard holds all its drapes; the last one grows when a dataset is extended."""
    path = root / shard_name(shard)
    if not path.exists():
        return False
    try:
        with Shard(path) as file:
            return (file.attribute("identity") == identity
                    and file.column("index").tolist() == list(config.rows(shard)))
    except (InputError, KeyError, OSError):
        return False


def _fill(
    root: Path,
    shards: list[int],
    config: DatasetConfig,
    identity: str,
    *,
    workers: int,
    progress: bool,
    solver: Solver | None,
    renderer: Renderer | None,
) -> None:
    """Make the drapes of ``shards`` and write each shard as soon as it is full."""
    indices = [index for shard in shards for index in config.rows(shard)]
    attributes = {
        "schema_version": SCHEMA_VERSION,
        "identity": identity,
        "config": json_text(config.as_dict()),
    }
    started: dict[int, list[dict]] = {}
    failed = 0
    bar = tqdm(total=config.drapes, initial=config.drapes - len(indices), unit="drape",
               disable=not progress, smoothing=0.05)
    with bar:
        for record in make_records(indices, config, workers=workers, solver=solver,
                                   renderer=renderer):
            failed += record["status"] != b"converged"
            bar.set_postfix_str(f"{failed} failed", refresh=False)
            bar.update()
            shard = int(record["index"]) // config.drapes_per_shard
            rows = started.setdefault(shard, [])
            rows.append(record)
            if len(rows) == len(config.rows(shard)):
                rows.sort(key=lambda row: int(row["index"]))
                write_shard(root / shard_name(shard), rows, layout=config.layout,
                            attributes=attributes)
                del started[shard]


def _summarise(root: Path, config: DatasetConfig) -> dict:
    """Counts over all shards, and the digest that identifies the dataset's content."""
    outcomes: Counter[str] = Counter()
    rejected: dict[int, int] = {}
    digests = {}
    for shard in range(config.shards):
        path = root / shard_name(shard)
        with Shard(path) as file:
            outcomes.update(file.column("status").tolist())
            rejected.update(zip(file.column("fabric").tolist(), file.column("rejected").tolist(),
                                strict=True))
        digests[path.name] = file_digest(path)
    samples = len(rejected) + sum(rejected.values())
    return {
        "fabrics": len(rejected),
        "outcomes": dict(sorted(outcomes.items())),
        "rejection_rate": sum(rejected.values()) / samples,
        "hash": json_digest(digests),
        "shards": digests,
    }


HELP = """\
usage: python -m data.generate [KEY=VALUE ...]

Simulates drapes of random fabrics and renders four depth views of each in several random
orientations, or, with dataset=fresh, leaves the views to training. Writes OUT/shard_*.h5 and
OUT/dataset.json (docs/data_format.md). Run again after an interruption, it continues; asked for
more drapes, it extends the dataset. The files depend on neither the number of workers nor
interruptions.

    python -m data.generate out=outputs/dataset drapes=1500 workers=2
    python -m data.generate out=outputs/small drapes=16 resolution=31 dataset.orientations=2

Keys and their defaults (groups are exchanged as in dataset=paper):
"""


def main(argv: list[str]) -> None:
    """The command line: Hydra overrides of ``configs/generate.yaml``."""
    from omegaconf import OmegaConf

    from data.configs import compose_config, group_options

    if any(word in ("-h", "--help") for word in argv):
        defaults = compose_config("generate", [])
        print(HELP)
        print(OmegaConf.to_yaml(defaults))
        for group in ("dataset", "prior", "solver", "rig"):
            print(f"{group}: {', '.join(group_options(group))}")
        return
    options = compose_config("generate", argv, schema=Options)
    manifest = generate_dataset(config_from_options(options), options.out, workers=options.workers)
    size = sum((Path(options.out) / name).stat().st_size for name in manifest["shards"])
    outcomes = ", ".join(f"{count} {name}" for name, count in manifest["outcomes"].items())
    print(f"{manifest['drapes']} drapes of {manifest['fabrics']} fabrics in {options.out} "
          f"({size / 1e6:.1f} MB, {size / 1e3 / manifest['drapes']:.1f} kB a drape): {outcomes}")
    print(f"impossible fabrics drawn and rejected: {manifest['rejection_rate']:.2%}")


def entry() -> NoReturn:
    """Console script."""
    run_command(main)


if __name__ == "__main__":
    entry()
