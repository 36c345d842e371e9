"""Files are replaced whole or stay as they were."""

import json
import os
import pickle
import subprocess
import sys
import tempfile
import unicodedata
from pathlib import Path

import numpy as np
import pytest

from common.errors import InputError, of, one_line
from common.files import (
    locked,
    path_named,
    remove_file,
    remove_partial,
    replace_file,
    replace_json,
    replacing,
    require_file,
    require_folder,
)


def test_a_file_is_made_with_its_folder_and_replaced(tmp_path):
    path = tmp_path / "deep" / "er" / "a.json"
    for data in (b"first", b"second"):
        replace_file(path, data)
        assert path.read_bytes() == data
    with pytest.raises(KeyboardInterrupt), replacing(path) as file:
        file.write(b"half of")
        raise KeyboardInterrupt
    assert path.read_bytes() == b"second"
    assert [entry.name for entry in path.parent.iterdir()] == ["a.json"]


def test_numbers_that_are_not_finite_become_null(tmp_path):
    """JSON knows neither infinity nor NaN, and a strict reader would refuse the file."""
    path = tmp_path / "figures.json"
    numbers = [1.5, float("inf"), np.float64("nan"), 2]
    replace_json(path, {"deep": [{"a": (float("-inf"), "text")}, numbers], "none": None})
    content = json.loads(path.read_text(), parse_constant=pytest.fail)
    assert content == {"deep": [{"a": [None, "text"]}, [1.5, None, None, 2]], "none": None}


def test_a_failing_write_is_an_input_error_and_leaves_nothing(tmp_path):
    (tmp_path / "file").write_text("mine")
    (tmp_path / "folder").mkdir()
    (tmp_path / "gone").symlink_to(tmp_path / "nowhere")
    for path in (tmp_path / "file" / "below", tmp_path / "folder"):
        with pytest.raises(InputError, match="cannot write"):
            replace_file(path, b"")
    for place, reason in ((tmp_path / "file", "in the way"), (tmp_path / "file" / "in", "in the"),
                          (tmp_path / "gone", "in the way"), (Path("/proc/drapes"), "No such"),
                          (tmp_path / ("x" * 256), "name too long")):
        with pytest.raises(InputError, match=f"folder {place}: .*{reason}"):
            require_folder(place)
        with pytest.raises(InputError, match=f"cannot write .*{reason}"):
            require_file(place / "a.json")
    with pytest.raises(InputError, match="it is a folder"):
        require_file(tmp_path)
    for place in (tmp_path, tmp_path / "deep" / "er"):
        require_folder(place)
        require_file(place / "new.json")
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["file", "folder", "gone"]


@pytest.mark.skipif(os.geteuid() != 0, reason="needs another user's rights")
def test_rights_of_another_user_are_seen():
    """Of folders that may not be written to and of those that may not be looked into."""
    nobody = 65534
    with tempfile.TemporaryDirectory() as root:  # pytest's own are closed to others
        closed, hidden, free = (Path(root) / name for name in ("closed", "hidden", "free"))
        for folder, mode in ((Path(root), 0o755), (closed, 0o555), (hidden, 0o700), (free, 0o777)):
            folder.mkdir(exist_ok=True)
            folder.chmod(mode)
        os.seteuid(nobody)
        try:
            require_folder(free / "new")
            for folder in (closed, closed / "new", hidden, hidden / "new"):
                with pytest.raises(InputError, match="Permission denied"):
                    require_folder(folder)
                with pytest.raises(InputError, match="Permission denied"):
                    require_file(folder / "new" / "a.json")
        finally:
            os.seteuid(0)


def test_errors_become_one_line():
    assert one_line(ValueError("two\n  lines")) == "two lines"
    assert one_line(KeyError()) == "KeyError"
    assert len(one_line(ValueError("x" * 1000))) == 200


def test_an_error_states_the_nearest_source():
    with pytest.raises(InputError) as refused, of("capture"), of("capture/view_0.png"):
        raise InputError("two sizes; take it again")
    error = refused.value
    assert str(error) == "capture/view_0.png: two sizes; take it again"
    assert (error.source, error.message) == ("capture/view_0.png", "two sizes; take it again")


@pytest.mark.parametrize(("error", "told"), [
    (InputError("has no views", source=Path("/srv/in/a.png"), joint=" "), "a.png has no views"),
    (InputError("no views", source="/srv/in"), "capture 1: no views"),
    (InputError("/srv/in: no views; see /srv/in/a"), "capture 1: no views; see a"),
    (InputError("no views", source="b.png"), "b.png: no views"), (InputError("none"), "none")])
def test_an_error_is_told_without_the_paths_of_its_machine(error, told):
    again = pickle.loads(pickle.dumps(error))  # as from another process
    assert str(again) == str(error) and str(again.within(Path("/srv/in"), "capture 1")) == told


def test_links_that_wait_where_a_file_will_be_written_are_not_followed(tmp_path):
    (tmp_path / "mine").write_text("mine")
    for name in ("estimate.json", "estimate.json.part"):
        (tmp_path / name).symlink_to(tmp_path / "mine")
    replace_file(tmp_path / "estimate.json", b"{}")
    assert (tmp_path / "mine").read_text() == "mine"
    assert (tmp_path / "estimate.json").read_bytes() == b"{}"
    assert not (tmp_path / "estimate.json").is_symlink()


def test_messages_are_one_short_line_of_text_whatever_names_they_repeat():
    name = os.fsdecode(b"two\nlines \xff \x1b[2J")
    message = str(InputError(f"capture '{name}' " + "x" * 5000 + "; check the path"))
    assert message.isprintable() and message.encode() and len(message) < 750
    assert message.startswith(r"capture 'two\nlines \udcff \x1b[2J' xx")
    assert message.endswith("xx; check the path")


def test_a_writer_that_loses_its_temporary_file_writes_it_again(tmp_path, monkeypatch):
    path, lost = tmp_path / "deep" / "file", []

    def replace(source, target, real=os.replace):
        if len(lost) < 3:
            lost.append(source)
            remove_partial(path.parent, "file")
        real(source, target)

    monkeypatch.setattr(os, "replace", replace)
    replace_file(path, b"content")
    assert path.read_bytes() == b"content" and len({str(name) for name in lost}) == 3
    assert list(path.parent.iterdir()) == [path]


def test_leftovers_of_killed_writers_are_removed(tmp_path):
    for name in ("shard_1.h5.12ab.part", "shard_1.h5", "film.part", "report.png",
                 "report.png.0a1b.part"):
        (tmp_path / name).touch()
    remove_partial(tmp_path, "shard_*.h5")
    remove_file(tmp_path / "report.png")
    assert {path.name for path in tmp_path.iterdir()} == {"shard_1.h5", "film.part"}


@pytest.mark.parametrize("text", ["Köper/first", "Köper\\first", "K\u006f\u0308per\\first",
                                  "./K\u006f\u0308per/first", "Köper/../Köper/first"])
@pytest.mark.parametrize("form", ["NFC", "NFD"])
def test_a_path_is_found_however_it_is_written(tmp_path, text, form):
    folder = tmp_path / unicodedata.normalize(form, "Köper") / "first"
    folder.mkdir(parents=True)
    assert path_named(tmp_path, text).samefile(folder)


@pytest.mark.parametrize("text", ["gone", "gone\\first", "x" * 5000, "a\0b"])
def test_a_path_that_is_absent_stays_as_written(tmp_path, text):
    assert path_named(tmp_path, text) == tmp_path / text


def test_a_folder_is_of_one_run_and_free_after_its_end(tmp_path):
    out = tmp_path / "out"
    with locked(out), pytest.raises(InputError, match=r"another run .*another out="):
        with locked(out):
            pytest.fail("two runs")
    assert not out.exists()  # nothing was written
    with locked(out):
        replace_file(out / "estimate.json", b"{}")
    assert [file.name for file in out.iterdir()] == ["estimate.json"]


def test_a_killed_run_locks_nothing(tmp_path):
    """Neither the lock of its process, nor the file that it leaves."""
    held = subprocess.Popen([sys.executable, "-c", (
        "import sys, time; from pathlib import Path; from common.files import locked\n"
        "with locked(Path(sys.argv[1])): print('locked', flush=True); time.sleep(60)"),
        str(tmp_path)], stdout=subprocess.PIPE)
    assert held.stdout.readline() == b"locked\n"
    with pytest.raises(InputError, match="another run"), locked(tmp_path):
        pass
    held.kill()
    held.wait()
    assert list(tmp_path.iterdir())
    with locked(tmp_path):
        pass
    assert not list(tmp_path.iterdir())
