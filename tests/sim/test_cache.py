"""What is kept of the latest states is what would be found there."""

import numpy as np

from sim.energies.base import StateCache


def test_the_latest_two_states_are_kept_by_their_value():
    asked, cache = [], StateCache()

    def square(q):
        asked.append(q.copy())
        return q**2

    here, there, far = np.array([1.0, 2.0]), np.array([1.0, 3.0]), np.array([5.0, 6.0])
    for q in (here, there, here, there.copy(), here):
        assert np.array_equal(cache.at(q, square), q**2)
    assert len(asked) == 2
    here += 1.0  # the caller's own array: what was found belongs to the old values
    assert np.array_equal(cache.at(here, square), [4.0, 9.0])
    assert np.array_equal(cache.at(np.array([1.0, 2.0]), square), [1.0, 4.0])
    assert np.array_equal(cache.at(far, square), [25.0, 36.0])
    assert len(asked) == 5


def test_what_is_no_number_is_found_anew():
    asked, cache = [], StateCache()
    nothing = np.array([np.nan])
    for _ in range(2):
        cache.at(nothing, lambda q: asked.append(1))
    assert len(asked) == 2
