"""Runs that are killed, share a folder or fill the disk end in the same bytes as one in peace."""

import json
import os
import shutil
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import fake_drapes
import numpy as np
import pytest
from test_generate import ROOT, files, generate, small_config

from common.errors import InputError
from data.dataset.config import BORROWED
from data.dataset.plan import choose_lender
from data.dataset.shards import LENGTH_UNIT, Shard
from data.dataset.simulate import make_record

SHAPES = ("sine", "fold")
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


def start(out, *, shards=6, workers=1, pause=0.03):
    """A process, in a new session, that makes the dataset with workers."""
    script = Path(out).with_name("run.py")
    script.write_text(SCRIPT.format(tests=str(Path(__file__).parent)))
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path]),
                                "DRAPE_TEST_PAUSE": str(pause)}
    return subprocess.Popen([sys.executable, str(script), str(out), str(shards), str(workers)],
                            env=environment, stderr=subprocess.PIPE, text=True,
                            start_new_session=True)


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


def test_killed_and_continued_is_as_if_uninterrupted(peaceful, tmp_path):
    out = tmp_path / "set"
    process = start(out)
    assert wait_for_another_shard(out, process)
    process.kill()
    process.communicate()
    assert not json.loads((out / "dataset.json").read_text())["complete"]
    assert 0 < whole_shards(out) < 6
    make(out)
    assert files(out) == files(peaceful)


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
