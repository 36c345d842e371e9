"""Generate datasets of simulated drapes.

    python -m data.dataset.generate out=outputs/dataset drapes=1500 workers=2
    python -m data.dataset.generate out=outputs/small drapes=16 edge_mm=5

Writes OUT/shard_*.h5 and OUT/dataset.json (docs/data_format.md). A drape takes about 1 s on one
core, and 8 kB, with edge_mm=5. ``python -m data.dataset.inspect data=OUT`` summarises a dataset.

    prior -> plan of a drape -> equilibrium -> record -> shard

A shard depends only on the dataset's configuration and its number, so any number of processes, on
any number of machines of one kind, write the same files; ``device=cuda`` makes another dataset,
whose drapes may differ from those of the CPU. After an interruption the same command resumes, and
replaces damaged shards; with a larger drapes= it extends the dataset.

``launcher=slurm parts=40 workers=8`` runs 40 jobs on a cluster, ``device=cuda`` batches on an
accelerator: docs/cluster.md.
"""

import common.interrupt  # noqa: F401

# isort: split
import tempfile
from concurrent.futures import FIRST_COMPLETED, Future, wait
from pathlib import Path

import numpy as np
from tqdm import tqdm

from common.cases import progress_bar
from common.command import command
from common.errors import InputError, one_line
from common.files import folder_named
from common.workers import worker_pool
from data.dataset.batches import check_device, ready_drapes, windows
from data.dataset.config import DatasetConfig, Options, config_from_options
from data.dataset.folder import DatasetFolder, over_shards
from data.dataset.simulate import Solver

POLL_INTERVAL = 0.3  # s, at which the progress of workers is reported


def generate_dataset(
    config: DatasetConfig, out: Path, *, workers: int = 1, part: int = 0, parts: int = 1,
    solver: Solver | None = None,
) -> dict:
    """Generate, complete or extend the dataset in the folder ``out``; return ``dataset.json``.

    Only every ``parts``-th shard is made, from the ``part``-th on, counted from 0. Parts can be
    made at the same time on any machines; the last one finishes the dataset, the result of others
    has ``complete: False`` and no counts. ``solver`` replaces :func:`sim.draping.drape` and must be
    importable.
    """
    if part >= parts:
        raise InputError(f"part={part} of parts={parts}: parts are counted from 0 to parts - 1")
    check_device(config)
    folder = DatasetFolder(Path(out), config)
    try:
        folder.claim()
        shards = range(part, config.shards, parts)
        missing = [shard for shard in over_shards(shards, "checking")
                   if folder.shard(shard) is None]
        if missing:
            folder.begin()
            total, left = (sum(len(config.rows(shard)) for shard in group)
                           for group in (shards, missing))
            with progress_bar(total=total, initial=total - left, unit="drape",
                              smoothing=0.05) as bar:
                make_shards(folder, missing, workers=workers, solver=solver, bar=bar)
        manifest = folder.finish()
    except OSError as error:
        raise InputError(f"cannot write the dataset {out}: {one_line(error)}") from None
    if parts == 1 and not manifest["complete"]:
        raise InputError(f"shards of {out} were removed or damaged during the run; run the same "
                         "command again")
    return manifest


def make_shards(
    folder: DatasetFolder, shards: list[int], *, workers: int, solver: Solver | None, bar: tqdm
) -> None:
    """Make ``shards`` in ``workers`` processes, which in jobs of a launcher cannot import functions
    of this module, ``__main__``."""
    present = bar.n
    try:
        with tempfile.NamedTemporaryFile() as file, worker_pool(min(workers, len(shards))) as pool:
            counts = np.memmap(file, np.int64, "w+", shape=(len(shards), 2))
            running: set[Future] = set()
            left = windows(folder.config, len(shards))
            while running or left:
                if left:
                    places = left.pop(0)
                    solvers = (ready_drapes(folder.config, [shards[k] for k in places], pool)
                               if folder.config.device else [solver] * len(places))
                    running |= {pool.submit(folder.make, shards[place], file.name, place, one)
                                for place, one in zip(places, solvers, strict=True)}
                done, running = wait(running, timeout=POLL_INTERVAL, return_when=FIRST_COMPLETED)
                drapes, failed = counts.sum(axis=0).tolist()
                bar.set_postfix_str(f"{failed} failed", refresh=False)
                bar.update(present + drapes - bar.n)
                for future in done:
                    future.result()
    except BaseException:
        folder.remove_partial()  # processes may have been killed while writing
        raise


@command("generate", Options)
def main(options: Options) -> None:
    """Generate the dataset, or part of it, and print a summary."""
    out = folder_named(options.out)
    manifest = generate_dataset(config_from_options(options), out, workers=options.workers,
                                part=options.part, parts=options.parts)
    if not manifest["complete"]:
        print(f"part {options.part} of {options.parts} of {out} is done, other parts are not; the "
              "last one writes dataset.json")
        return
    size = sum((out / name).stat().st_size for name in manifest["shards"])
    outcomes, starts = (", ".join(f"{count} {name}" for name, count in manifest[key].items())
                        for key in ("outcomes", "starts"))
    print(f"{manifest['drapes']} drapes of {manifest['fabrics']} fabrics in {out} "
          f"({size / 1e6:.1f} MB, {size / 1e3 / manifest['drapes']:.1f} kB a drape): {outcomes}")
    print(f"starts: {starts}; impossible fabrics drawn and rejected: "
          f"{manifest['rejection_rate']:.2%}")


if __name__ == "__main__":
    main()
