"""The second stage: intervals hold what they say whatever is seen, and means stay."""

import numpy as np

from drapenet.network.calibration import Calibration
from drapenet.network.posterior import LEVELS, covered, ranks
from drapenet.network.targets import TARGETS

_SETS, _DRAWS = 1500, 400


def _posteriors(rng):
    """Samples of normal posteriors, the truth, whose deviation is 0.6 to 2.4 times what they state
    by the first of two numbers seen, and these numbers."""
    seen = np.column_stack([rng.uniform(-1, 1, _SETS), np.ones(_SETS)])
    middle = rng.normal(size=(_SETS, TARGETS))
    stated = rng.uniform(0.1, 0.3, (_SETS, 1))
    samples = middle + stated * rng.standard_normal((_DRAWS, _SETS, TARGETS))
    times = 1.2 * 2 ** seen[:, :1]
    return samples, middle + times * stated * rng.standard_normal((_SETS, TARGETS)), seen


def test_intervals_of_others_hold_what_they_say_in_every_band():
    rng = np.random.default_rng(0)
    calibration = Calibration.fit(*_posteriors(rng))
    samples, truth, seen = _posteriors(rng)
    scaled = calibration.applied(samples, seen)
    for band in (seen[:, 0] < -0.5, np.abs(seen[:, 0]) < 0.5, seen[:, 0] > 0.5):
        before, after = (covered(ranks(one[:, band, :6], truth[band, :6])).mean(axis=(1, 2))
                         for one in (samples, scaled))
        assert np.abs(after - LEVELS).max() < 0.03
        assert np.abs(after - LEVELS).max() < np.abs(before - LEVELS).max()


def test_means_and_what_is_no_modulus_stay():
    samples, truth, seen = _posteriors(np.random.default_rng(1))
    scaled = Calibration.fit(samples, truth, seen).applied(samples, seen)
    np.testing.assert_allclose(scaled.mean(axis=0), samples.mean(axis=0), atol=1e-9)
    np.testing.assert_array_equal(scaled[..., 6:], samples[..., 6:])


def test_what_lies_beyond_all_that_was_seen_is_scaled_as_their_limit():
    samples, truth, seen = _posteriors(np.random.default_rng(2))
    calibration = Calibration.fit(samples, truth, seen)
    near, far = calibration.scales(np.array([[3.0, 1.0], [1e6, 1e6]]))
    np.testing.assert_allclose(near, far)
    assert (far < 8).all()
