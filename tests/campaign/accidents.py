"""Kills, full disks, closed folders, jumping clocks and two runs in one folder: the same bytes."""

import contextlib
import errno
import hashlib
import os
import random
import resource
import shutil
import signal
import time
from collections.abc import Callable
from pathlib import Path

import cloths
import fake_drapes
import torch
from here import here
from readers import small_config

import data.dataset.folder
import data.dataset.generate
import train
from common.command import compose_config
from common.errors import InputError
from data.dataset.generate import generate_dataset
from drapenet.config import TrainConfig
from drapenet.network.training import open_captures

Kill = Callable[[Path, random.Random], dict]
DRAPES, PER_SHARD = 36, 3
MOST_ATTEMPTS = 400
TRAINING = ["model.width=4", "optim.batch_size=16", "threads=1", "workers=1", "device=cpu",
            "seed=3", "captures=2", "neighbours=false", "validation_fraction=0.2", "epochs=4"]


def make_dataset(out: Path, *, part: int = 0, parts: int = 1, workers: int | None = None) -> dict:
    """A small dataset of drapes that cost little; ``workers`` None for none but this process."""
    if workers is None:
        data.dataset.generate.worker_pool = here
    return generate_dataset(small_config(DRAPES, PER_SHARD), out, part=part, parts=parts,
                            workers=workers or 1, solver=fake_drapes.cone)


def digest(folder: Path, names: str = "*") -> str:
    """SHA-256 of the files of a folder, their names and bytes."""
    found = hashlib.sha256()
    for file in sorted(folder.glob(names)):
        if file.is_file():
            found.update(file.name.encode() + b"\0" + file.read_bytes())
    return found.hexdigest()


def forked(work: Callable[[], object]) -> int:
    """The id of a new process, a session of its own, that does ``work``: exit code 0, or 2 for an
    InputError, or 1.
    """
    child = os.fork()
    if child:
        return child
    code = 1
    try:
        os.setsid()
        quiet = os.open(os.devnull, os.O_RDWR)
        for descriptor in (0, 1, 2):
            os.dup2(quiet, descriptor)
        work()
        code = 0
    except InputError:
        code = 2
    finally:
        os._exit(code)


def ended(child: int) -> int:
    """Exit code of a process, its signal as a negative number."""
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def killed(works: list[Callable[[], object]], seconds: float) -> tuple[int, list[int]]:
    """Begin ``works`` in a process each and kill all after ``seconds``; how many were killed, and
    the exit codes of the others.
    """
    children = [forked(work) for work in works]
    time.sleep(seconds)
    for child in children:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)
    codes = [ended(child) for child in children]
    return codes.count(-signal.SIGKILL), [code for code in codes if code != -signal.SIGKILL]


def kill_dataset(work: Path, rng: random.Random, *, workers: int | None = None) -> dict:
    """One dataset by one to four processes, killed again and again until it is finished."""
    out, peaceful = work / "set", work / "peaceful"
    shutil.rmtree(out, ignore_errors=True)
    if not (peaceful / "dataset.json").exists():
        begun = time.monotonic()
        if ended(forked(lambda: make_dataset(peaceful))):
            raise RuntimeError("the dataset that nobody kills failed")
        (work / "seconds").write_text(str(time.monotonic() - begun))
    whole = float((work / "seconds").read_text())
    kills, wrong = 0, []
    for _ in range(MOST_ATTEMPTS):
        parts = rng.randint(1, 4)
        count, codes = killed(
            [lambda k=k, n=parts: make_dataset(out, part=k, parts=n, workers=workers)
             for k in range(parts)], rng.uniform(0, 0.6 * whole + 2.0 * (workers or 0)))
        kills += count
        wrong += [code for code in codes if code]
        if codes and (out / "dataset.json").exists() and ended(
                forked(lambda: _require_complete(out))) == 0:
            break
    last = ended(forked(lambda: make_dataset(out)))
    same = digest(out) == digest(peaceful)
    return {"kills": kills, "same": same and last == 0, "failed": wrong}


def kill_dataset_with_workers(work: Path, rng: random.Random) -> dict:
    """As :func:`kill_dataset`, each process with two workers."""
    return kill_dataset(work, rng, workers=2)


def _require_complete(out: Path) -> None:
    from data.dataset.folder import finished_manifest

    finished_manifest(out)


def training_words(work: Path, out: Path) -> list[str]:
    """The command line of a small training; dataset and maps are made once."""
    root = work / "cloths"
    if not (root / "dataset.json").exists():
        shutil.rmtree(root, ignore_errors=True)
        cloths.write_dataset(root, drapes=40, seed=8)
    return [f"data={root}", f"maps={work / 'maps'}", f"out={out}", *TRAINING]


def run_training(words: list[str]) -> None:
    """Train as ``train.py`` does."""
    torch.set_num_threads(1)
    train.train(compose_config("train", words, schema=TrainConfig))


def kill_training(work: Path, rng: random.Random) -> dict:
    """One training, killed again and again until it is finished."""
    peaceful, out = work / "whole", work / "broken"
    shutil.rmtree(out, ignore_errors=True)
    if not (work / "training_seconds").exists():
        words = training_words(work, peaceful)
        open_captures(compose_config("train", words, schema=TrainConfig))
        shutil.rmtree(peaceful, ignore_errors=True)
        begun = time.monotonic()
        if ended(forked(lambda: run_training(words))):
            raise RuntimeError("the training that nobody kills failed")
        (work / "training_seconds").write_text(str(time.monotonic() - begun))
    whole = float((work / "training_seconds").read_text())
    words = training_words(work, out)
    kills, wrong, last = 0, [], 1
    for _ in range(MOST_ATTEMPTS):
        count, codes = killed([lambda: run_training(words)], rng.uniform(0, 0.9 * whole))
        kills += count
        wrong += [code for code in codes if code]
        if codes == [0]:
            last = 0
            break
    same = digest(out, "drapenet.safetensors") == digest(peaceful, "drapenet.safetensors")
    return {"kills": kills, "same": same and last == 0, "failed": wrong}


def _limited(work: Path, size: int) -> None:
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
    make_dataset(work)


def _full(work: Path, room: int) -> None:
    """A disk that is full after ``room`` bytes of what the dataset's files have."""
    import common.files

    real, left = os.fsync, [room]

    def fsync(descriptor: int) -> None:
        left[0] -= os.fstat(descriptor).st_size
        if left[0] < 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        real(descriptor)

    common.files.os.fsync = fsync
    make_dataset(work)


def _as_nobody(work: Callable[[], object]) -> None:
    os.setgid(65534)
    os.setuid(65534)
    work()


def _jumping(out: Path, rng: random.Random) -> None:
    """Clocks that jump by years between two looks at them."""
    real = time.time
    time.time = lambda: real() + rng.uniform(-1e8, 1e8)
    make_dataset(out)
    for file in out.iterdir():
        os.utime(file, (0, rng.randrange(2**31)))
    make_dataset(out)


def accident(kind: str, work: Path, rng: random.Random) -> str:
    """One accident to a dataset, the run after it, and what is wrong; empty where nothing is."""
    out, peaceful = work / "hurt", work / "calm"
    shutil.rmtree(out, ignore_errors=True)
    if not (peaceful / "dataset.json").exists():
        ended(forked(lambda: make_dataset(peaceful)))
    size = max(file.stat().st_size for file in peaceful.iterdir())
    all_bytes = sum(file.stat().st_size for file in peaceful.iterdir())
    expected = 2
    if kind == "files cut off by RLIMIT_FSIZE":
        first = ended(forked(lambda: _limited(out, rng.randrange(1, size))))
    elif kind == "disk full":
        first = ended(forked(lambda: _full(out, rng.randrange(all_bytes))))
    elif kind == "folder closed":
        shutil.copytree(peaceful, out)
        for file in rng.sample(sorted(out.glob("shard_*.h5")), 3):
            file.unlink()
        work.chmod(0o755)
        out.chmod(0o555)
        first = ended(forked(lambda: _as_nobody(lambda: make_dataset(out))))
        out.chmod(0o755)
    elif kind == "clock jumps":
        first, expected = ended(forked(lambda: _jumping(out, rng))), 0
    else:
        children = [forked(lambda: make_dataset(out)) for _ in range(rng.randint(2, 4))]
        first, expected = max(ended(child) for child in children), 0
    leftovers = [file.name for file in out.glob("*.part")] if out.exists() else []
    last = ended(forked(lambda: make_dataset(out)))
    wrong = []
    if first != expected:
        wrong.append(f"exit code {first}, not {expected}")
    if leftovers:
        wrong.append(f"{len(leftovers)} unfinished files left")
    if last or digest(out) != digest(peaceful):
        wrong.append("other bytes after the run that followed")
    return "; ".join(wrong)


ACCIDENTS = ("files cut off by RLIMIT_FSIZE", "disk full", "folder closed", "clock jumps",
             "runs in one folder")
