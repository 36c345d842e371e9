"""A real Slurm on one node: ``make test-slurm``."""

import subprocess
import sys
import time

import pytest
from test_generate import ROOT, files

from data.dataset.generate import main

TOOL = ROOT / "tools" / "slurm.sh"
PARTS = 4
SMALL = ["drapes=32", "edge_mm=12", "dataset.drapes_per_shard=2",
         "dataset.starts=[sine,fold,borrowed]"]

pytestmark = pytest.mark.slurm


@pytest.fixture(scope="module")
def slurm(tmp_path_factory):
    """A running Slurm, in the environment of all that is started from here."""
    folder = tmp_path_factory.mktemp("slurm")
    started = subprocess.run(["sh", str(TOOL), "start", str(folder)], capture_output=True,
                             text=True)
    if started.returncode == 3:
        pytest.skip(started.stderr.strip().splitlines()[-1])
    assert started.returncode == 0, started.stderr
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SLURM_CONF", str(folder / "slurm.conf"))
        yield folder
    subprocess.run(["sh", str(TOOL), "stop", str(folder)], check=True)


@pytest.fixture(scope="module")
def local(slurm, tmp_path_factory):
    """The same dataset made without Slurm."""
    folder = tmp_path_factory.mktemp("local") / "set"
    main([f"out={folder}", "workers=2", *SMALL])
    assert len(list(folder.glob("shard_*.h5"))) == 16
    return folder


def command(folder):
    return [sys.executable, "-m", "data.dataset.generate", "--multirun", "launcher=slurm",
            f"parts={PARTS}", "workers=1", f"out={folder / 'set'}",
            f"hydra.sweep.dir={folder / 'logs'}", *SMALL]


def queue(*options):
    """Jobs that wait or run, one a line."""
    return subprocess.run(["squeue", "--noheader", "--array", *options], check=True,
                          capture_output=True, text=True).stdout.split()


def wait_for(condition, what):
    deadline = time.monotonic() + 300
    while not condition():
        assert time.monotonic() < deadline, f"in vain: {what}"
        time.sleep(0.05)


def test_jobs_of_slurm_make_the_same_bytes(local, tmp_path):
    subprocess.run(command(tmp_path), cwd=ROOT, check=True, timeout=600)
    assert len(list((tmp_path / "logs" / ".submitit").glob("*_*/*_log.out"))) == PARTS
    assert files(tmp_path / "set") == files(local)


def test_a_cancelled_job_is_made_up_for(local, tmp_path):
    out = tmp_path / "set"
    launcher = subprocess.Popen(command(tmp_path), cwd=ROOT, stderr=subprocess.DEVNULL)
    try:
        # Part 1 holds the shards 1, 5, 9 and 13.
        wait_for((out / "shard_00001.h5").exists, "the first shard of part 1")
        (job,) = [name for name in queue("--format=%i", "--states=RUNNING") if name.endswith("_1")]
        subprocess.run(["scancel", job], check=True)
        wait_for(lambda: not queue(), "the end of all jobs")
    finally:
        # This Slurm keeps no accounts, so that its submitter does not learn of the end.
        launcher.terminate()
        launcher.wait()
    missing = {f"shard_{shard:05d}.h5" for shard in range(16)} - files(out).keys()
    assert missing and missing <= {f"shard_{shard:05d}.h5" for shard in (5, 9, 13)}
    assert {"dataset.json"} < files(out).keys()
    subprocess.run(command(tmp_path), cwd=ROOT, check=True, timeout=600)
    assert files(out) == files(local)
