"""Files are replaced whole or stay as they were."""

import json
import os
import tempfile
from pathlib import Path

import numpy as np
import pytest

from common.errors import InputError, one_line
from common.files import replace_file, replace_json, replacing, require_file, require_folder


def test_a_file_is_made_with_its_folder_and_replaced(tmp_path):
    path = tmp_path / "deep" / "er" / "a.json"
    for data in (b"first", b"second"):
        replace_file(path, data)
        assert path.read_bytes() == data
    assert [entry.name for entry in path.parent.iterdir()] == ["a.json"]


def test_an_interrupted_write_changes_nothing(tmp_path):
    path = tmp_path / "a.json"
    replace_file(path, b"first")
    with pytest.raises(KeyboardInterrupt), replacing(path) as file:
        file.write(b"half of the sec")
        assert path.read_bytes() == b"first"
        raise KeyboardInterrupt
    assert path.read_bytes() == b"first"
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.json"]


def test_what_is_no_finite_number_becomes_null(tmp_path):
    """JSON knows neither infinity nor NaN, and a strict reader would refuse the file."""
    path = tmp_path / "made" / "figures.json"
    numbers = [1.5, float("inf"), np.float64("nan"), 2]
    replace_json(path, {"deep": [{"a": (float("-inf"), "text")}, numbers], "none": None})

    def refuse(name: str) -> None:
        raise AssertionError(f"{name} is no JSON")

    found = json.loads(path.read_text(), parse_constant=refuse)
    assert found == {"deep": [{"a": [None, "text"]}, [1.5, None, None, 2]], "none": None}
    with pytest.raises(TypeError):
        replace_json(path, {"array": np.zeros(2)})
    assert json.loads(path.read_text()) == found


def test_what_cannot_be_written_is_an_input_error(tmp_path):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(InputError, match=r"cannot write .*below") as refusal:
        replace_file(tmp_path / "file" / "below", b"")
    assert "\n" not in str(refusal.value)
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match=r"cannot write .*folder"):
        replace_file(tmp_path / "folder", b"")
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["file", "folder"]


def test_places_that_cannot_be_written_to_are_told_beforehand(tmp_path):
    (tmp_path / "file").write_text("mine")
    (tmp_path / "gone").symlink_to(tmp_path / "nowhere")
    for place, reason in ((tmp_path / "file", "in the way"), (tmp_path / "file" / "in", "in the"),
                          (tmp_path / "gone", "in the way"), (Path("/proc/drapes"), "No such")):
        with pytest.raises(InputError, match=f"folder {place}: .*{reason}"):
            require_folder(place)
        with pytest.raises(InputError, match=f"cannot write {place}/a.json: .*{reason}"):
            require_file(place / "a.json")
    with pytest.raises(InputError, match="it is a folder"):
        require_file(tmp_path)


def test_a_place_that_is_looked_at_stays_as_it_was(tmp_path):
    (tmp_path / "old.json").write_text("mine")
    for place in (tmp_path, tmp_path / "deep" / "er"):
        require_folder(place)
        require_file(place / "new.json")
    require_file(tmp_path / "old.json")
    require_file(Path("a.json"))
    assert [entry.name for entry in tmp_path.iterdir()] == ["old.json"]


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
