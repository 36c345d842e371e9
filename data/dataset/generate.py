"""Generate datasets of simulated drapes of random fabrics.

    python -m data.dataset.generate out=outputs/dataset drapes=1500 workers=2
    python -m data.dataset.generate out=outputs/small drapes=16 edge_mm=5

Writes OUT/shard_*.h5 and OUT/dataset.json (docs/data_format.md). A drape takes about 2 s on one
core, and 20 kB with edge_mm=3. ``python -m data.dataset.inspect OUT`` summarises a dataset.

    prior -> plan of a drape -> equilibrium -> record -> shard

A shard depends only on the dataset's configuration and its number, so any number of processes, on
any number of machines, write the same files. After an interruption the same command resumes, and
replaces damaged shards; with a larger drapes= it extends the dataset.

On a Slurm cluster, in 40 jobs of 8 processes; on one machine, in 4 jobs at a time
(docs/cluster.md; needs pip install '.[cluster]'):

    python -m data.dataset.generate launcher=slurm parts=40 workers=8 out=... drapes=48000
    python -m data.dataset.generate launcher=joblib parts=4 workers=1 out=... drapes=1500
"""

import common.interrupt  # noqa: F401

# isort: split
import sys
from pathlib import Path

from common.cases import progress_bar
from common.command import command
from common.errors import InputError, one_line
from common.files import folder_named
from data.dataset.folder import DatasetFolder
from data.dataset.options import Options, config_from_options
from data.dataset.progress import over_shards
from data.dataset.simulate import DatasetConfig, Solver
from data.dataset.workers import make_shards


def generate_dataset(
    config: DatasetConfig,
    out: str | Path,
    *,
    workers: int = 1,
    part: int = 0,
    parts: int = 1,
    solver: Solver | None = None,
) -> dict:
    """Generate, complete or extend the dataset in the folder ``out``.

    Progress and a breakdown of the time are printed to standard error.

    Args:
        config: all that determines the files.
        out: folder; created where it is missing.
        workers: single-threaded processes; without influence on the files.
        part, parts: make only every ``parts``-th shard, from the ``part``-th on, counted from 0.
            Parts can be made at the same time on any machines; the one that finds all others done
            finishes the dataset.
        solver: replaces :func:`sim.drape.drape`; must be importable.

    Returns:
        The content of ``dataset.json``: configuration, counts of every outcome, digests. While
        other parts are unfinished it has ``complete: False`` and no counts.

    Raises:
        InputError: ``out`` cannot be written, or holds a dataset of another configuration or with
            more drapes.
    """
    if workers < 1:
        raise InputError(f"workers={workers} must be at least 1")
    if not 0 <= part < parts:
        raise InputError(f"part={part} of parts={parts}: parts are counted from 0 to parts - 1")
    folder = DatasetFolder(Path(out), config)
    try:
        folder.claim()
        mine = range(part, config.shards, parts)
        missing = [shard for shard in over_shards(mine, "checking")
                   if folder.content(shard) is None]
        if missing:
            folder.begin()
        total, missing_drapes = (sum(len(config.rows(shard)) for shard in shards)
                                 for shards in (mine, missing))
        present = total - missing_drapes
        with progress_bar(total=total, initial=present, unit="drape", smoothing=0.05) as bar:
            def report(made: int, failed: int) -> None:
                bar.set_postfix_str(f"{failed} failed", refresh=False)
                bar.update(present + made - bar.n)

            spent = make_shards(folder, missing, workers=workers, solver=solver, report=report)
        if missing:
            print(spent, file=sys.stderr)
        manifest = folder.finish(made=bool(missing))
    except OSError as error:
        raise InputError(f"cannot write the dataset {out}: {one_line(error)}") from None
    if parts == 1 and not manifest["complete"]:
        raise InputError(f"shards of {out} were removed or damaged during the run; run the same "
                         "command again")
    return manifest


@command("generate", Options)
def main(options: Options) -> None:
    """Generate the dataset, or part of it, of ``options`` and print a summary."""
    manifest = generate_dataset(config_from_options(options), folder_named(options.out),
                                workers=options.workers, part=options.part, parts=options.parts)
    if not manifest["complete"]:
        print(f"part {options.part} of {options.parts} of {options.out} is done, other parts are "
              "not; the last one writes dataset.json")
        return
    size = sum((Path(options.out) / name).stat().st_size for name in manifest["shards"])
    outcomes = ", ".join(f"{count} {name}" for name, count in manifest["outcomes"].items())
    starts = ", ".join(f"{count} {name}" for name, count in manifest["starts"].items())
    print(f"{manifest['drapes']} drapes of {manifest['fabrics']} fabrics in {options.out} "
          f"({size / 1e6:.1f} MB, {size / 1e3 / manifest['drapes']:.1f} kB a drape): {outcomes}")
    print(f"starts: {starts}; impossible fabrics drawn and rejected: "
          f"{manifest['rejection_rate']:.2%}")


if __name__ == "__main__":
    main()
