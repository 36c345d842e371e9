"""Wrong arrays are refused while the tests run (``shapes.py``)."""

from contextlib import suppress

import numpy as np
import pytest
from shapes import ShapeError, checked

from common.types import Faces, Points, Turns, VertexMask, Views
from sim.measures import maximum_stretch, projected_area
from sim.mesh import Mesh
from sim.rig import Rig

POINTS, FACES = np.zeros((3, 3)), np.array([[0, 1, 2]])


@pytest.mark.parametrize(("points", "faces", "complaint"), [
    (POINTS[:, :2], FACES, r"projected_area: positions is \(3, 2\) float64, not .*\(N, 3\)"),
    (POINTS[0], FACES, r"positions is \(3,\)"), (POINTS.tolist(), FACES, "positions is a list"),
    (POINTS.astype(int), FACES, "int64"), (POINTS, 1.0 * FACES, "faces is .* float64"),
])
def test_a_wrong_argument_is_refused(points, faces, complaint):
    with pytest.raises(ShapeError, match=complaint):
        projected_area(points, faces=faces)


def test_a_letter_stands_for_one_number():
    with pytest.raises(ShapeError, match=r"held is \(4,\) bool, .* where .*'V': 3"):
        maximum_stretch(POINTS, POINTS[:, :2], FACES, np.zeros(4, dtype=bool))


def test_methods_and_constructors_are_checked():
    with pytest.raises(ShapeError, match=r"Mesh.__init__: rest is \(3, 3\)"):
        Mesh(POINTS, FACES)
    with pytest.raises(ShapeError, match=r"Rig.place: rest"):
        Rig().place(POINTS)


def test_results_tuples_and_unions_are_checked():
    def seen(turns: Turns | None, *, views: Views | str = "") -> tuple[Points, Faces] | None:
        return None if turns is None else (np.zeros((len(turns), 3)), FACES[:, : len(turns)])

    function = checked(seen)
    assert function(None) is None and function(np.zeros(3), views="of a file")
    with pytest.raises(ShapeError, match="return is a tuple"):
        function(np.zeros(2))
    with pytest.raises(ShapeError, match="views is"):
        function(np.zeros(3), views=np.zeros((2, 4, 4)))


def test_faults_of_shapes_are_not_taken_for_those_of_the_input():
    with pytest.raises(ShapeError), suppress(Exception):
        projected_area(POINTS[0], FACES)


def test_a_function_without_shapes_stays_as_it_is():
    def plain(number: float, held: "VertexMask") -> float:
        return number

    assert checked(plain) is plain


def test_wrong_arrays_may_be_given_on_purpose(any_shapes):
    assert projected_area(POINTS.astype(int), FACES) == 0.0
