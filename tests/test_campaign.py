"""The campaign of damage, kills and accidents runs, a few cases of each kind."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.slow
def test_a_short_campaign_finds_nothing():
    words = ["corrupted=2", "kills=4", "pool_kills=1", "training_kills=1", "accidents=1"]
    done = subprocess.run([sys.executable, "tests/campaign", *words], cwd=ROOT,
                          capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert len(done.stdout.splitlines()) > 20
