"""Hostile and broken descriptions end in one short line."""

import pytest

from common.errors import InputError
from data.reading import finite_number, read_mapping

HOSTILE = {
    "huge number": "density: " + "9" * 400,
    "tag without value": "density: !!int ''",
    "tag of another kind": "density: !!timestamp soon",
    "truth that is none": "density: !!bool perhaps",
    "lines in text": 'density: "a\\nb\\nc"',
    "long text": "density: " + "x" * 10_000,
    "multiplying aliases": "a: &a [x,x,x,x,x,x,x,x,x]\n"
    + "".join(f"{b}: &{b} [{','.join(['*' + a] * 9)}]\n" for a, b in zip("abcdefg", "bcdefgh",
                                                                       strict=True))
    + "density: *h",
}


@pytest.mark.parametrize("case", HOSTILE)
def test_hostile_numbers_are_refused_in_one_short_line(tmp_path, case):
    file = tmp_path / "capture.yaml"
    file.write_text(HOSTILE[case])
    with pytest.raises(InputError) as refusal:
        finite_number(read_mapping(file).get("density"), "density")
    assert "\n" not in str(refusal.value) and len(str(refusal.value)) < 400


def test_numbers_are_taken_as_they_are():
    assert finite_number(150, "density") == 150.0
    assert isinstance(finite_number(150, "density"), float)
    assert finite_number(-0.5, "shift") == -0.5
