"""What is remembered of the last points is what would be found there."""

import numpy as np

from sim.energies.remember import Remembered


def test_the_last_two_points_are_remembered_by_their_value():
    asked, remembered = [], Remembered()

    def square(q):
        asked.append(q.copy())
        return q**2

    here, there, far = np.array([1.0, 2.0]), np.array([1.0, 3.0]), np.array([5.0, 6.0])
    for q in (here, there, here, there.copy(), here):
        assert np.array_equal(remembered.at(q, square), q**2)
    assert len(asked) == 2
    here += 1.0  # the caller's own array: what was found belongs to the old values
    assert np.array_equal(remembered.at(here, square), [4.0, 9.0])
    assert np.array_equal(remembered.at(np.array([1.0, 2.0]), square), [1.0, 4.0])
    assert np.array_equal(remembered.at(far, square), [25.0, 36.0])
    assert len(asked) == 5


def test_what_is_no_number_is_found_anew():
    asked, remembered = [], Remembered()
    nothing = np.array([np.nan])
    for _ in range(2):
        remembered.at(nothing, lambda q: asked.append(1))
    assert len(asked) == 2
