"""Tables of every program are read alike."""

import pytest

from common.errors import InputError
from common.tables import read_rows, read_table

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


@pytest.mark.parametrize(("data", "words"), [
    ("fabric\nKöper;1".encode("cp1252"), r"UTF-8 \(line 2 has 'Köper;1' if it is in Windows"),
    (b"\xff\xfe\x00", "not text in UTF-16"), ("x,y".encode("utf-16-le"), "zero bytes, as UTF-16"),
    (b'x,y\n"1,2\n', "cannot be read")])
def test_other_encodings_and_open_quotes_are_refused_in_one_line(tmp_path, data, words):
    file = tmp_path / "table.csv"
    file.write_bytes(data)
    with pytest.raises(InputError, match=words) as refusal:
        read_rows(file, "table")
    assert str(refusal.value).isprintable()
