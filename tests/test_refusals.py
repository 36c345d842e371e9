"""Bad sources are refused in one line, by each door: the rows of tests/refused. So are arguments of
functions: those of tests/calls.yaml."""

import shutil
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import pytest
import yaml
from fastapi.testclient import TestClient
from services import PoolHere, settings_for
from spoiled import COMMAND, READER, SERVICE, STARTS, spoiled
from words import last

import infer
from common.command import run_command
from common.errors import MAX_LENGTH, InputError
from drapenet.service.app import create_app

TABLES = Path(__file__).with_name("refused")
ROWS = [row | {"of": start, "id": name}
        for file in sorted(TABLES.glob("*.yaml"))
        for start, rows in yaml.safe_load(file.read_text("utf-8")).items()
        for name, row in rows.items()]


class Calls(yaml.SafeLoader):
    """Reads tests/calls.yaml."""


def _of(loader: Calls, node: yaml.Node) -> object:
    if isinstance(node, yaml.ScalarNode):
        return resolve_name(loader.construct_scalar(node))
    name, *arguments = loader.construct_sequence(node, deep=True)
    return resolve_name(name)(*arguments)


Calls.add_constructor("!of", _of)
CALLS = [pytest.param(name, row, id=f"{name}: {row['says']}") for name, rows in yaml.load(
    TABLES.with_name("calls.yaml").read_text("utf-8"), Calls).items() for row in rows]


def of_door(door: str) -> pytest.MarkDecorator:
    """The rows of a door."""
    rows = [row for row in ROWS if door in row.get("doors", STARTS[row["of"]].doors)]
    return pytest.mark.parametrize("row", rows, ids=[f"{row['of']}: {row['id']}" for row in rows])


@pytest.fixture(scope="module")
def sound(tmp_path_factory) -> Path:
    """A folder of sound sources."""
    return tmp_path_factory.mktemp("sound")


@pytest.fixture(scope="module")
def service(tmp_path_factory, untrained_checkpoint) -> Iterator[TestClient]:
    """A service whose worker is this process."""
    settings = settings_for(tmp_path_factory.mktemp("results"), "megabytes=4",
                            f"checkpoint={untrained_checkpoint}")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("drapenet.service.pools.ProcessPool", PoolHere)
        with TestClient(create_app(settings), base_url="http://localhost") as client:
            yield client


def assert_said(row: Mapping[str, Any], line: str) -> None:
    """A line has the words of a row, in their order, and is one."""
    rest = line
    for words in row["says"].split(" ... "):
        assert words in rest, line
        rest = rest.partition(words)[2]
    assert line.isprintable() and len(line) <= MAX_LENGTH + 3


@pytest.mark.parametrize(("name", "row"), CALLS)
def test_a_call_is_refused_in_one_line(name, row, any_shapes, monkeypatch):
    monkeypatch.setattr("sim.draping.find_equilibrium", None)
    with pytest.raises(InputError) as refusal:
        resolve_name(name)(*row.get("of", []), **row.get("with", {}))
    assert_said(row, str(refusal.value))


@of_door(READER)
def test_python_refuses_in_one_line(row, tmp_path, sound):
    source = spoiled(row, tmp_path, sound)
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(InputError) as refusal:
        STARTS[row["of"]].read(source)
    assert_said(row, str(refusal.value))
    assert source.name in str(refusal.value)
    assert sorted(tmp_path.rglob("*")) == before


@of_door(COMMAND)
def test_the_command_refuses_in_one_line_with_exit_code_2_and_no_file(
        row, tmp_path, sound, untrained_checkpoint, monkeypatch, capsys):
    source, start = spoiled(row, tmp_path, sound), STARTS[row["of"]]
    before = sorted(tmp_path.rglob("*"))
    words = [word.replace("{}", str(source)) for word in (*start.words, *row.get("words", []))]
    if start.command is infer.main:
        words = [f"checkpoint={untrained_checkpoint}", *words]
    if not any(word.startswith("out=") for word in words):
        words.append(f"out={tmp_path / 'out'}")
    if "before" in row:
        monkeypatch.setattr(row["before"], None)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["", *last(*words)])
    with pytest.raises(SystemExit) as ending:
        run_command(start.command)
    assert ending.value.code == 2
    printed = capsys.readouterr()
    assert printed.out == "" and printed.err.startswith("error: ") and printed.err[-1:] == "\n"
    assert_said(row, printed.err.removeprefix("error: ").removesuffix("\n"))
    assert sorted(tmp_path.rglob("*")) == before


@of_door(SERVICE)
def test_the_service_refuses_in_one_line(row, tmp_path, sound, service):
    """At once, or in the estimate of a source that only its worker reads."""
    source = spoiled(row, tmp_path, sound)
    if "zip" in row:
        shutil.make_archive(str(tmp_path / "a"), "zip", source)
        source = tmp_path / "a.zip"
    files = [("files", (file.name, file.read_bytes()))
             for file in (sorted(source.iterdir()) if source.is_dir() else [source])]
    fields = {name: (None, str(value)) for name, value in (
        {"name": "twill"} | STARTS[row["of"]].fields | row.get("fields", {})).items()
        if value is not None}
    answer = service.post("/estimates", files=[*files, *fields.items()])
    if answer.status_code == 202 and "status" not in row:
        estimate = service.get(f"/estimates/{answer.json()['id']}").json()
        assert estimate["state"] == "failed"
        line = estimate["error"]
    else:
        assert answer.status_code == row.get("status", 422), answer.text
        line = answer.json()["error"]
    assert_said(row, line)
    assert str(service.app.state.jobs.settings.folder) not in line
