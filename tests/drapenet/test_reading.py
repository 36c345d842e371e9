"""Outlines with the errors of photographs, as a network learns them."""

import numpy as np
import pytest

from drapenet.network.captures import faults, reading_errors
from drapenet.views.directions import AZIMUTHS


def rms(values: np.ndarray) -> np.ndarray:
    return np.sqrt(np.square(values).mean(axis=-1))


@pytest.fixture(scope="module")
def drawn() -> tuple[np.ndarray, np.ndarray]:
    return reading_errors(4000, np.random.default_rng(0))


def test_errors_are_those_of_pictures_and_their_statement_tells_of_them(drawn):
    off, stated = drawn
    assert off.shape == stated.shape == (4000, AZIMUTHS)
    assert (stated > 0).all()
    # Of half a specimen of 300 mm, 1e-2 is 1.5 mm.
    assert 2e-3 < np.median(rms(off)) < 2e-2
    large = rms(stated) > np.median(rms(stated))
    assert np.median(rms(off[large])) > 1.5 * np.median(rms(off[~large]))


def test_errors_prefer_no_azimuth(drawn):
    off, _ = drawn
    squares = np.square(off).clip(max=1e-3)
    deviation = squares.mean(axis=0) / (squares.std(axis=0) / np.sqrt(len(off)))
    assert np.ptp(squares.mean(axis=0)) / squares.mean() < 12 / deviation.min()


def test_faults_are_bites_and_bulges_of_a_few_degrees():
    off = faults(4000, np.random.default_rng(0))
    some = np.abs(off).max(axis=1) > 0
    assert 0.25 < some.mean() < 0.35
    wide = (off[some] != 0).mean(axis=1) * 360
    assert wide.min() >= 3 and wide.max() <= 45
    assert 0.4 < (off[some].sum(axis=1) > 0).mean() < 0.6


def test_edges_of_faults_are_sharp_or_soft():
    off = np.abs(faults(4000, np.random.default_rng(0)))
    off = off[off.max(axis=1) > 0]
    full = (off > 0.9 * off.max(axis=1, keepdims=True)).sum(axis=1) / (off > 0).sum(axis=1)
    assert (full > 0.7).mean() > 0.1 and (full < 0.5).mean() > 0.3
