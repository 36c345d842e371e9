"""Datasets made in many jobs of Hydra."""

import json
import subprocess
import sys
from pathlib import Path

import fake_drapes
import pytest
from test_generate import ROOT, files

from common.errors import InputError
from data.dataset.generate import main

SMALL = ["drapes=4", "edge_mm=20", "dataset.drapes_per_shard=1", "dataset.starts=[sine]"]


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
