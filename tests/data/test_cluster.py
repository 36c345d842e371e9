"""Datasets made in many jobs of Hydra."""

import json

import pytest

from common.errors import InputError
from data.dataset.generate import main

SMALL = ["drapes=4", "edge_mm=20", "dataset.drapes_per_shard=1", "workers=1"]


def files(folder):
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A folder made by one job."""
    folder = tmp_path_factory.mktemp("whole") / "set"
    main([f"out={folder}", *SMALL])
    return folder


def test_jobs_make_a_part_each_and_the_last_one_finishes(whole, tmp_path, capsys):
    out, logs = tmp_path / "set", tmp_path / "logs"
    main(["--multirun", f"out={out}", f"hydra.sweep.dir={logs}", "parts=2", *SMALL])
    said = capsys.readouterr().out
    assert f"part 0 of 2 of {out} is done, other parts are not" in said
    assert "4 drapes of 4 fabrics" in said
    assert files(out) == files(whole)


def test_one_part_can_be_asked_for(tmp_path):
    out = tmp_path / "set"
    main(["-m", f"out={out}", f"hydra.sweep.dir={tmp_path / 'logs'}", "parts=3", "part=1", *SMALL])
    assert [path.name for path in out.glob("shard*")] == ["shard_00001.h5"]
    assert not json.loads((out / "dataset.json").read_text())["complete"]


@pytest.mark.slow
def test_jobs_of_joblib(whole, tmp_path):
    main(["launcher=joblib", f"out={tmp_path / 'set'}", "parts=3",
          f"hydra.sweep.dir={tmp_path / 'logs'}", *SMALL])
    assert files(tmp_path / "set") == files(whole)


def test_a_jobs_mistake_is_reported_in_one_line(whole, tmp_path):
    with pytest.raises(InputError, match="other settings") as refusal:
        main(["--multirun", f"out={whole}", f"hydra.sweep.dir={tmp_path}", *SMALL, "parts=2",
              "seed=3"])
    assert "\n" not in str(refusal.value)
