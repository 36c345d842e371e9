"""Arguments of public functions."""

import numpy as np
import pytest

from common.arguments import number, numbers, require, whole_number
from common.errors import InputError


@pytest.mark.parametrize("value", [2, 2.0, np.float32(2), np.array(2.0)])
def test_numbers_of_any_type_are_taken(value):
    assert number("edge", value, "m") == 2.0
    assert numbers("offset", (value, 0), "two numbers", (2,)).tolist() == [2.0, 0.0]


@pytest.mark.parametrize("value", [
    "2", None, True, np.nan, -np.inf, [2.0], 2j, {}, np.ma.masked_equal(2.0, 2.0)])
def test_what_is_no_finite_number_is_refused(value):
    with pytest.raises(InputError, match=r"^edge=.*: give a finite number, m$"):
        number("edge", value, "m")


def test_arrays_are_shown_by_their_shape_and_must_have_the_one_stated():
    assert numbers("points", np.ones((4, 2)), "points", (None, 2)).shape == (4, 2)
    with pytest.raises(InputError, match=r"^points of the shape \(4, 2\): give \(V, 3\)$"):
        numbers("points", np.ones((4, 2)), "(V, 3)", (None, 3))


def test_whole_numbers_and_classes_are_required():
    assert whole_number("seed", np.int64(3), 0) == 3
    for value in (1.5, "3", -1, None):
        with pytest.raises(InputError, match=r"seed=.*give a whole number, at least 0"):
            whole_number("seed", value, 0)
    with pytest.raises(InputError, match="a=1 is not of the class str; give one such as 'x'"):
        require(b=("x", str), a=(1, str, "'x'"))
