"""Runs that are killed again and again, at any moment, end in the same bytes as one in peace."""

import os
import random
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from cloths import write_dataset
from test_generate import ROOT, files
from test_interrupted import make, start

SEED, KILLS, LONGEST = 1, 12, 8.0  # seconds until a kill


def killed_until_it_ends(begin: Callable[[], subprocess.Popen], rng: random.Random) -> int:
    """Begin a run, kill it with all its processes, and so on, but let the last one end; the number
    of kills."""
    kills = 0
    for number in range(KILLS + 1):
        process = begin()
        try:
            process.communicate(timeout=rng.uniform(0, LONGEST) if number < KILLS else 600)
            assert process.returncode == 0
            break
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
            kills += 1
    return kills


@pytest.mark.slow
def test_a_dataset(tmp_path):
    make(tmp_path / "peaceful", shards=40)
    kills = killed_until_it_ends(lambda: start(tmp_path / "set", shards=40, workers=2,
                                               pause=0.1), random.Random(SEED))
    assert kills and files(tmp_path / "set") == files(tmp_path / "peaceful")


@pytest.mark.slow
def test_a_training(tmp_path):
    write_dataset(tmp_path / "cloths", drapes=40, seed=8)

    def begin(out: str) -> subprocess.Popen:
        return subprocess.Popen(
            [sys.executable, ROOT / "train.py", "data=cloths", "maps=maps", f"out={out}",
             "model.width=4", "optim.batch_size=16", "threads=1", "workers=1", "device=cpu",
             "captures=2", "neighbours=false", "validation_fraction=0.2", "epochs=6"],
            cwd=tmp_path, start_new_session=True, stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL)

    assert begin("peaceful").wait() == 0
    kills = killed_until_it_ends(lambda: begin("broken"), random.Random(SEED))
    peaceful, broken = (Path(tmp_path, out, "drapenet.safetensors").read_bytes()
                        for out in ("peaceful", "broken"))
    assert kills and broken == peaceful
