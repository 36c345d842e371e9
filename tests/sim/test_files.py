"""Files are replaced whole or stay as they were."""

import pytest

from sim.errors import InputError, one_line
from sim.files import replace_file, replacing


def test_a_file_is_made_with_its_folder_and_replaced(tmp_path):
    path = tmp_path / "deep" / "er" / "a.json"
    for data in (b"first", b"second"):
        replace_file(path, data)
        assert path.read_bytes() == data
    assert [entry.name for entry in path.parent.iterdir()] == ["a.json"]


def test_an_interrupted_write_changes_nothing(tmp_path):
    path = tmp_path / "a.json"
    replace_file(path, b"first")
    with pytest.raises(KeyboardInterrupt), replacing(path) as temporary:
        temporary.write_bytes(b"half of the sec")
        assert path.read_bytes() == b"first"
        raise KeyboardInterrupt
    assert path.read_bytes() == b"first"
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.json"]


def test_what_cannot_be_written_is_an_input_error(tmp_path):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(InputError, match=r"cannot write .*below") as refusal:
        replace_file(tmp_path / "file" / "below", b"")
    assert "\n" not in str(refusal.value)
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match=r"cannot write .*folder"):
        replace_file(tmp_path / "folder", b"")
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["file", "folder"]


def test_errors_become_one_line():
    assert one_line(ValueError("two\n  lines")) == "two lines"
    assert one_line(KeyError()) == "KeyError"
    assert len(one_line(ValueError("x" * 1000))) == 200
