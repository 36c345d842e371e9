"""Runs that are killed, share a folder or fill the disk end in the same bytes as one in peace."""

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import fake_drapes
import numpy as np
import pytest
from cloths import write_dataset
from test_generate import ROOT, files, generate, small_config

from common.errors import InputError
from data.dataset.config import BORROWED
from data.dataset.generate import main
from data.dataset.plan import choose_lender
from data.dataset.shards import LENGTH_UNIT, Shard
from data.dataset.simulate import make_record

SHAPES = ("sine", "fold")
SMALL = ["drapes=4", "edge_mm=20", "dataset.drapes_per_shard=1", "dataset.starts=[sine]"]
STORED = (".h5", ".json", ".safetensors")
SCRIPT = """
import sys
sys.path.insert(0, {tests!r})
if __name__ == "__main__":
    import fake_drapes, test_interrupted
    from common.command import run_command
    run_command(lambda words: test_interrupted.make(
        words[0], shards=int(words[1]), workers=int(words[2]),
        solver=fake_drapes.slow_lending_cone))
"""


def config(shards=6):
    """Three drapes of each fabric, some of them borrowed, in shards of six."""
    small = small_config(6 * shards, starts_per_fabric=3, starts=(*SHAPES, BORROWED))
    return replace(small, drapes_per_shard=6)


def make(out, *, shards=6, solver=fake_drapes.lending_cone, **options):
    return generate(out, config(shards), solver=solver, **options)


def begun(*words: object, folder: Path, pause: float = 0.0) -> subprocess.Popen:
    """A Python process in a session of its own, as of a terminal."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path]),
                                "DRAPE_TEST_PAUSE": str(pause)}
    return subprocess.Popen([sys.executable, *map(str, words)], cwd=folder, env=environment,
                            stderr=subprocess.PIPE, text=True, start_new_session=True,
                            preexec_fn=lambda: signal.signal(signal.SIGINT,
                                                             signal.default_int_handler))


def start(out: Path, *, shards: int = 6, workers: int = 1, pause: float = 0.03
          ) -> subprocess.Popen:
    """A process that makes the dataset with workers."""
    script = out.with_name("run.py")
    script.write_text(SCRIPT.format(tests=str(Path(__file__).parent)))
    return begun(script, out, shards, workers, folder=out.parent, pause=pause)


def whole_shards(out):
    return len(list(Path(out).glob("shard_*.h5")))


def wait_for_another_shard(out, process):
    """Until there is one more; False if the process has ended before."""
    before, deadline = whole_shards(out), time.monotonic() + 120
    while whole_shards(out) == before and time.monotonic() < deadline:
        if process.poll() is not None:
            return False
        time.sleep(0.005)
    return whole_shards(out) > before


@pytest.fixture(scope="module")
def peaceful(tmp_path_factory):
    """A folder made without interruption."""
    folder = tmp_path_factory.mktemp("peaceful") / "set"
    make(folder)
    return folder


def test_borrowed_starts_are_earlier_drapes_of_other_fabrics_of_the_shard(peaceful):
    borrowed = 0
    for path in sorted(peaceful.glob("shard_*.h5")):
        shard = Shard(path)
        names = ("index", "fabric", "status", "start", "planned", "lender")
        rows = [dict(zip(names, row, strict=True))
                for row in zip(*(shard.column(name).tolist() for name in names), strict=True)]
        for i, row in enumerate(rows):
            able = [r["index"] for r in rows[:i]
                    if r["status"] == "converged" and r["fabric"] != row["fabric"]]
            if row["planned"] == BORROWED and able:
                assert row["start"] == BORROWED
                assert row["lender"] == choose_lender(row["index"], seed=0, candidates=able)
                borrowed += 1
            else:
                assert row["start"] in (SHAPES if row["planned"] == BORROWED
                                        else (row["planned"],))
                assert row["lender"] == -1
    assert borrowed > 3  # else this dataset tests nothing


def test_a_borrowed_drape_is_handed_to_the_solver_as_stored():
    records = []
    for index in range(6):
        records.append(make_record(index, config(), earlier=records,
                                   solver=fake_drapes.lending_cone))
    row = next(record for record in records if record["lender"] >= 0)
    own = make_record(row["index"], config(), solver=fake_drapes.lending_cone)
    assert own["start"] in (b"sine", b"fold") and own["lender"] == -1
    lent = records[row["lender"]]["positions"] * LENGTH_UNIT
    expected = own["positions"][:, 2] * (1 - 0.1 * lent[:, 2].min() / 0.3)
    assert np.abs(row["positions"][:, 2] - expected).max() <= 1.1


def ended(process: subprocess.Popen, folder: Path, rng: random.Random) -> bool:
    """End a run with all its processes some changes of the names in its folder later, by a kill or
    Ctrl-C; False if it is over before."""
    def names() -> set[str]:
        return {path.name for path in folder.rglob("*")}

    changes, seen = rng.randrange(6), names()
    while changes and process.poll() is None:
        time.sleep(0.005)
        if names() != seen:
            changes, seen = changes - 1, names()
    time.sleep(rng.uniform(0, 0.3))
    over = process.poll() is not None
    if not over:
        os.killpg(process.pid, rng.choice([signal.SIGKILL, signal.SIGINT]))
    process.communicate(timeout=60)
    return not over


def dataset(folder: Path, out: str) -> subprocess.Popen:
    return start(folder / out, pause=0.03)


def dataset_of_two_workers(folder: Path, out: str) -> subprocess.Popen:
    return start(folder / out, shards=40, workers=2, pause=0.1)


def training(folder: Path, out: str) -> subprocess.Popen:
    if not (folder / "cloths").exists():
        write_dataset(folder / "cloths", drapes=40, seed=8)
    return begun(ROOT / "train.py", "data=cloths", "maps=maps", f"out={out}", "model.width=4",
                 "optim.batch_size=16", "threads=1", "workers=1", "device=cpu", "captures=2",
                 "neighbours=false", "validation_fraction=0.2", "epochs=6", folder=folder)


@pytest.mark.parametrize(("begin", "times"), [
    (dataset, 2), pytest.param(dataset_of_two_workers, 12, marks=pytest.mark.slow),
    pytest.param(training, 12, marks=pytest.mark.slow)])
def test_a_run_that_is_ended_at_any_moment_and_begun_again_gives_the_same_bytes(
    tmp_path, begin: Callable[[Path, str], subprocess.Popen], times
):
    rng = random.Random(1)
    count = sum(ended(begin(tmp_path, "broken"), tmp_path, rng) for _ in range(times))
    for out in ("broken", "peaceful"):
        process = begin(tmp_path, out)
        assert process.communicate(timeout=600) and process.returncode == 0
    made = [{path.name: path.read_bytes() for path in (tmp_path / out).iterdir()
             if path.suffix in STORED} for out in ("broken", "peaceful")]
    assert count and made[0] and made[0] == made[1]


def test_two_runs_in_one_folder_do_no_harm(peaceful, tmp_path):
    out = tmp_path / "set"
    process = start(out, workers=2, pause=0.01)
    assert wait_for_another_shard(out, process)
    make(out)
    assert process.wait(timeout=60) == 0
    process.communicate()
    assert files(out) == files(peaceful)


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 1 MB."""
    disk = tmp_path / "disk"
    disk.mkdir()
    if os.geteuid() or not shutil.which("mount"):
        pytest.skip("mounting a small tmpfs needs root")
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=1m", "drapes", str(disk)],
                             capture_output=True, text=True)
    if mounted.returncode:
        pytest.skip(f"cannot mount a tmpfs: {mounted.stderr.strip()}")
    yield disk
    subprocess.run(["umount", str(disk)], check=True)


def test_a_full_disk_ends_in_one_line_and_loses_nothing(peaceful, small_disk):
    out, ballast = small_disk / "set", small_disk / "ballast"
    script_and_manifest = 16_000
    free = os.statvfs(small_disk).f_bavail * os.statvfs(small_disk).f_frsize
    ballast.write_bytes(b"x" * free)
    with pytest.raises(InputError, match="No space left on device"):
        make(out)
    shard = (peaceful / "shard_00000.h5").stat().st_size
    os.truncate(ballast, free - script_and_manifest - int(2.5 * shard))
    process = start(out, pause=0)
    _, error = process.communicate(timeout=60)
    assert process.returncode == 2
    message, = [line for line in error.splitlines() if line and "drape/s" not in line]
    assert message.startswith("error: cannot write")
    assert "No space left on device" in error and "finished shards are kept" in error
    assert not list(out.glob("*.part"))
    kept = {path.name: path.read_bytes() for path in out.glob("shard_*.h5")}
    assert kept and all(files(peaceful)[name] == content for name, content in kept.items())
    ballast.unlink()
    make(out)
    assert files(out) == files(peaceful)


@pytest.fixture
def cheap(monkeypatch):
    """Drapes that cost nothing."""
    monkeypatch.setattr("data.dataset.simulate.load_solver", lambda: fake_drapes.cone)


@pytest.fixture
def whole(cheap, tmp_path) -> Path:
    """A folder made by one job."""
    main([f"out={tmp_path / 'whole'}", "workers=1", *SMALL])
    return tmp_path / "whole"


def test_jobs_make_a_part_each_and_the_last_one_finishes(whole, tmp_path, capsys):
    out, logs = tmp_path / "set", tmp_path / "logs"
    main(["--multirun", f"out={out}", f"hydra.sweep.dir={logs}", "parts=2",
          "workers=1", *SMALL])
    said = capsys.readouterr().out
    assert f"part 0 of 2 of {out} is done, other parts are not" in said
    assert "4 drapes of 4 fabrics" in said
    assert files(out) == files(whole)


def test_one_part_can_be_asked_for(cheap, tmp_path):
    out = tmp_path / "set"
    main(["-m", f"out={out}", f"hydra.sweep.dir={tmp_path / 'logs'}", "parts=3", "part=1",
          "workers=1", *SMALL])
    assert [path.name for path in out.glob("shard*")] == ["shard_00001.h5"]
    assert not json.loads((out / "dataset.json").read_text())["complete"]


@pytest.mark.slow
def test_jobs_of_joblib(tmp_path):
    main([f"out={tmp_path / 'whole'}", "workers=2", *SMALL])
    subprocess.run([sys.executable, "-m", "data.dataset.generate", "launcher=joblib", "parts=3",
                    f"out={tmp_path / 'set'}", f"hydra.sweep.dir={tmp_path / 'logs'}", *SMALL],
                   cwd=ROOT, check=True)
    assert files(tmp_path / "set") == files(tmp_path / "whole")


def test_a_jobs_mistake_is_reported_in_one_line(whole, tmp_path):
    with pytest.raises(InputError, match="other settings") as refusal:
        main(["--multirun", f"out={whole}", f"hydra.sweep.dir={tmp_path}", *SMALL, "parts=2",
              "seed=3"])
    assert "\n" not in str(refusal.value)
