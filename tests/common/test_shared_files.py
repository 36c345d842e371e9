"""Files that several processes may write at once."""

import os
import threading

import pytest

from common.errors import InputError
from common.files import remove_file, remove_partial, replace_file


def test_whoever_loses_its_temporary_file_writes_it_again(tmp_path, monkeypatch):
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


def test_writers_at_once_leave_one_whole_file(tmp_path):
    contents = [bytes([65 + i]) * 300_000 for i in range(8)]
    threads = [threading.Thread(target=replace_file, args=(tmp_path / "file", content))
               for content in contents]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert (tmp_path / "file").read_bytes() in contents
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_leftovers_are_those_of_the_pattern(tmp_path):
    for name in ("shard_1.h5.12ab.part", "shard_1.h5.part", "shard_1.h5", "film.part",
                 "shard_1.txt"):
        (tmp_path / name).touch()
    remove_partial(tmp_path, "shard_*.h5")
    assert {path.name for path in tmp_path.iterdir()} == {"shard_1.h5", "film.part", "shard_1.txt"}


def test_a_file_is_removed_with_what_its_writers_left(tmp_path):
    for name in ("report.png", "report.png.0a1b.part", "report.html.0a1b.part"):
        (tmp_path / name).touch()
    remove_file(tmp_path / "report.png")
    assert [path.name for path in tmp_path.iterdir()] == ["report.html.0a1b.part"]


def test_what_the_system_refuses_is_one_line(tmp_path):
    (tmp_path / "file").mkdir()
    (tmp_path / "file" / "inside").touch()
    with pytest.raises(InputError, match="cannot write") as refusal:
        replace_file(tmp_path / "file", b"content")
    assert "\n" not in str(refusal.value)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
