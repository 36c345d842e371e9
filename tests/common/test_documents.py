"""What enters: hostile and broken documents, arguments and tables end in one short line, in little
time; tables of every program are read alike."""

import os
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import Field

from common.arguments import number, numbers, whole_number
from common.documents import (
    Schema,
    parse_json,
    parse_yaml,
    read_bytes,
    read_json,
    read_yaml,
    yaml_text,
)
from common.errors import InputError, shown
from common.tables import read_rows, read_table


class Cloth(Schema):
    density: float = Field(ge=10, le=1000, description="weigh it")
    folds: int = 0
    names: list[str] = Field(default=[], max_length=2)


def merge_bomb(levels: int = 60) -> str:
    """Merge keys that double at every level."""
    lines = ["a0: &a0 {k0: 1}"]
    lines += [f"a{k}: &a{k} {{<<: [*a{k - 1}, *a{k - 1}], k{k}: 1}}" for k in range(1, levels)]
    return "\n".join(lines)


HOSTILE = {
    "merge keys": merge_bomb(),
    "many keys, the last repeated": "\n".join(f"k{k}: 1" for k in range(8000)) + "\nk0: 2",
}


@pytest.mark.parametrize("case", HOSTILE)
def test_hostile_documents_are_refused_in_one_short_line(tmp_path, case):
    file = tmp_path / "capture.yaml"
    file.write_text(HOSTILE[case])
    begun = time.process_time()
    with pytest.raises(InputError) as refusal:
        Cloth.of(read_yaml(file), file)
    assert time.process_time() - begun < 3
    message = str(refusal.value)
    assert message.isprintable() and len(message) < 710 and "capture.yaml" in message


@pytest.mark.parametrize(("text", "number"), [
    ("0150", 150), ("-045", -45), ("+09", 9), ("0150.5", 150.5), ("1_000", 1000), (".5", 0.5),
    ("5.", 5.0), ("1e3", 1000.0), ("1e-05", 1e-5), ("1.5E+3", 1500.0), ("!!int 010", 10),
    ("!!float 010", 10.0)])
def test_numbers_are_decimal(text, number):
    value = parse_yaml(f"density: {text}", "x")["density"]
    assert value == number and type(value) is type(number)


@pytest.mark.parametrize("text", ["1:30", "1:30.5", "0x96", "0o17", "0b11", "2026-11-26", "1__0"])
def test_what_is_no_decimal_number_is_a_text(text):
    """As such, it is refused in place of a number: 1:30 was 90 in YAML 1.1."""
    assert parse_yaml(f"density: {text}", "x") == {"density": text}
    with pytest.raises(InputError, match=f"density='{text}' is not a number; write digits"):
        Cloth.of(parse_yaml(f"density: {text}", "x"), "x")


@settings(max_examples=200, derandomize=True, deadline=None, database=None)
@given(st.dictionaries(st.text("abc", min_size=1), st.integers() | st.booleans() | st.floats(
    allow_nan=False) | st.text(max_size=9) | st.from_regex(
        r"[-+]?[0-9][0-9_:.xoe]{0,6}|20[0-9]{2}-[01][0-9]-[0-3][0-9]", fullmatch=True)))
def test_yaml_that_is_written_is_read_as_it_was(content):
    assert parse_yaml(yaml_text(content), "x") == content


@pytest.mark.parametrize("text", [
    "fabric: Denim  # 3 of 7", "fabric: 'Denim #3'", 'fabric: "#3" #quoted', "fabric: Denim#3",
    "density: 150 #weighed", "outline: #photograph\n  unit: mm"])
def test_comments_and_quoted_texts_are_taken(text):
    assert parse_yaml(text, "x")


def test_byte_order_marks_name_the_encoding(tmp_path):
    for encoding in ("utf-8-sig", "utf-16"):
        (tmp_path / "a.yaml").write_bytes("fabric: Köper".encode(encoding))
        assert read_yaml(tmp_path / "a.yaml") == {"fabric": "Köper"}


def test_sound_documents_are_taken_as_they_are():
    cloth = Cloth.of(parse_yaml("density: 150\nnames: [a, b]", "x"), "x")
    assert cloth.density == 150.0 and isinstance(cloth.density, float) and cloth.names == ["a", "b"]
    assert parse_json('{"a": [1, 2.5, null, "µ"]}', "x") == {"a": [1, 2.5, None, "µ"]}


@pytest.mark.parametrize("text", ["", "{", "[" * 100_000, '{"a":' * 100_000, "NaN",
                                  "\ud800", '"\x00"', "1" * 10_000])
def test_hostile_json_is_refused_in_one_short_line(tmp_path, text):
    (tmp_path / "a.json").write_bytes(text.encode("utf-8", "surrogatepass"))
    with pytest.raises(InputError, match="not a JSON document") as refusal:
        read_json(tmp_path / "a.json")
    assert str(refusal.value).isprintable() and len(str(refusal.value)) < 400


def test_only_regular_files_of_bounded_size_are_read(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "endless").symlink_to("/dev/zero")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    with (tmp_path / "sparse").open("wb") as file:
        file.truncate(1 << 40)
    for name, complaint in (
        ("pipe", "not a regular file; give a table"), ("endless", "not a regular"),
        ("sparse", "has 1099511627776 bytes; a table has at most 100"), (".", "not a regular"),
        ("loop", "cannot be read .*levels of symbolic links"), ("none", "No such file"),
        ("a\0b", "cannot be read"),
    ):
        with pytest.raises(InputError, match=complaint):
            read_bytes(tmp_path / name, 100, "table")
    (tmp_path / "sound").write_bytes(b"x" * 100)
    assert read_bytes(tmp_path / "sound", 100, "table") == b"x" * 100


def test_values_are_shown_in_one_short_line():
    for value in (10**6000, "x\n" * 1000, [[[[[[[["deep"]]]]]]]], {"a": "b" * 100}):
        assert shown(value).isprintable() and len(shown(value)) <= 60


SCALARS = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20)
VALUES = st.recursive(SCALARS, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(
    st.sampled_from(["density", "folds", "names", "a\nb"]) | st.text(max_size=5),
    inner, max_size=4))


@settings(max_examples=300, derandomize=True, deadline=None, database=None)
@given(VALUES)
def test_any_value_is_taken_or_refused_in_one_line(value):
    try:
        cloth = Cloth.of(value, "x")
    except InputError as refusal:
        assert str(refusal).isprintable() and len(str(refusal)) < 710
    else:
        assert 10 <= cloth.density <= 1000


@settings(max_examples=300, derandomize=True, deadline=None, database=None)
@given(st.text(max_size=60) | VALUES.map(repr) | st.lists(st.sampled_from(
    ["a: ", "- ", "? ", "&a ", "*a", "<<: ", "!!int ", "[", "]", "{", "}", "\n", "  ", "'", '"',
     "|", "1", ":", ",", "#", "%", "@", "---", "..."]), max_size=15).map("".join))
def test_any_text_is_a_document_or_refused_in_one_line(text):
    for parse in (parse_yaml, parse_json):
        try:
            parse(text, "x")
        except InputError as refusal:
            assert str(refusal).isprintable() and len(str(refusal)) < 710


@pytest.mark.parametrize("text", [
    "a:\u00a0-1.5\nb:\n\u00a0 c: x y", "a\uff1a -1.5\nb:\n  c: x\u00a0y",
    "a: \u22121.5\nb: {c: x y}",
    "a:\t-1.5\u00a0\nb:\t{c: x\u3000y}"])
def test_marks_of_word_processors_are_read_as_they_are_meant(text):
    assert parse_yaml(text, "x") == {"a": -1.5, "b": {"c": "x y"}}


@pytest.mark.parametrize("value", [2, 2.0, np.float32(2), np.array(2.0)])
def test_numbers_of_any_type_are_taken(value):
    assert number("edge", value, "m") == 2.0
    assert numbers("offset", (value, 0), "two numbers", (2,)).tolist() == [2.0, 0.0]
    assert numbers("points", np.ones((4, 2)), "points", (None, 2)).shape == (4, 2)
    assert whole_number("seed", np.int64(3), 0) == 3


EXPECTED = [["x", "y"], ["1.5", "-2"], ["0", "3"]]


@pytest.mark.parametrize("text", [
    "x,y\n1.5,-2\n0,3\n", "x;y\r\n1.5;-2\r\n0;3\r\n", "x\ty\n1.5\t-2\n0\t3",
    "x y\n1.5  -2\n 0 3 \n",
    '"x","y"\n"1.5","-2"\n"0","3"\n', "x, y\r1.5, -2\r0, 3\r",
    "sep=;\nx;y\n1.5;-2\n0;3\n", "sep=|\r\nx|y\r\n1.5|-2\r\n0|3\r\n", '"sep=,"\nx,y\n1.5,-2\n0,3',
    "x;y;\n1.5;-2;\n0;3;\n", "x;y\n\n1.5;-2\n;\n0;3\n;\n;;\n", ";x;;y\n;1.5;;-2\n;0;;3\n",
], ids=["comma", "semicolon", "tab", "space", "quoted", "old Mac", "Excel", "bar",
        "quoted sep", "trailing", "empty rows", "empty columns"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_every_dialect_gives_the_same_cells(tmp_path, text, encoding):
    file = tmp_path / "table.csv"
    file.write_bytes(text.encode(encoding))
    assert [cells for _, cells in read_rows(file, "table")] == EXPECTED


@pytest.mark.parametrize(("text", "row"), [
    ("x;y\n1,5;-2\n0;3\n", ["1,5", "-2"]), ("1,5;-2,0\n0,0;3,0\n", ["1,5", "-2,0"]),
    ("1,5 -2,0\n0,0 3,0\n", ["1,5", "-2,0"]), ('x,y\n"1,5","-2,0"\n', ["1,5", "-2,0"])])
def test_decimal_commas_do_not_separate(tmp_path, text, row):
    file = tmp_path / "table.csv"
    file.write_text(text)
    assert row in [cells for _, cells in read_rows(file, "table")]


def test_marks_inside_names_do_not_separate(tmp_path):
    file = tmp_path / "table.csv"
    file.write_text('fabric,capture\n"silk; red, fine",a\ntwill; blue,b\n"a ""b""",c\n12,3 4\n')
    header, rows = read_table(file, "table")
    assert header == ["fabric", "capture"]
    assert rows == [(2, ["silk; red, fine", "a"]), (3, ["twill; blue", "b"]), (4, ['a "b"', "c"]),
                    (5, ["12", "3 4"])]


@pytest.mark.parametrize("text", [
    '"","x","y"\n"1",1.5,-2\n"2",0,3\n', '"x","y"\n"1",1.5,-2\n"2",0,3\n',
    '"x" "y"\n"1" 1.5 -2\n"2" 0 3\n'], ids=["write.csv", "write.table", "spaces"])
def test_names_of_rows_that_r_writes_have_a_blank_head(tmp_path, text):
    file = tmp_path / "table.csv"
    file.write_text(text)
    header, rows = read_table(file, "table")
    assert header == ["", "x", "y"] and [cells[1:] for _, cells in rows] == EXPECTED[1:]
