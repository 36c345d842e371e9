"""Lines of Python by room and characters a line keep to the budget of ``pyproject.toml``."""

import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
tomllib = pytest.importorskip("tomllib")  # from Python 3.11 on
BUDGET = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["house"]


def test_the_house_keeps_to_its_budget(capsys):
    listed = subprocess.run(["git", "ls-files", "*.py"], cwd=ROOT, check=True, text=True,
                            capture_output=True).stdout.split()
    texts = {name: (ROOT / name).read_text("utf-8") for name in listed}
    rooms = {room: sum(text.count("\n") for name, text in texts.items()
                       if name.split("/")[0] in room.split()) for room in BUDGET["lines"]}
    total = sum(text.count("\n") for text in texts.values())
    assert sum(rooms.values()) == total, "files outside of all rooms"
    characters = sum(map(len, texts.values())) / total
    with capsys.disabled():
        print(f"\n{total} of {BUDGET['sum']} lines of {characters:.2f} characters")
        print("\n".join(f"{lines:6} of {BUDGET['lines'][room]:6}  {room}"
                        for room, lines in rooms.items()))
    assert not {room: lines for room, lines in rooms.items() if lines > BUDGET["lines"][room]}
    assert total <= BUDGET["sum"] and characters <= BUDGET["characters_a_line"]
