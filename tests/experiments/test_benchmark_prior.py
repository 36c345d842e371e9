"""The yardsticks by which priors are compared."""

import numpy as np
import pytest

from data.fabrics.fabrics import FabricTable, from_theta
from data.fabrics.prior import load_prior
from data.fabrics.prior.coordinates import Coordinates
from experiments.estimation.prior import (
    Split,
    compare,
    coverage,
    distance,
    mean_and_error,
    split_rows,
)


@pytest.fixture(scope="module")
def theta():
    return load_prior("gaussian").sample(60, np.random.default_rng(0))


def test_a_split_takes_every_row_once(theta):
    split = split_rows(theta, 3, Coordinates.fit(theta)[0])
    assert (len(split.fitted), len(split.unseen)) == (48, 12)
    both = np.vstack([split.fitted, split.unseen])
    np.testing.assert_array_equal(np.sort(both, axis=0), np.sort(theta, axis=0))
    assert (split_rows(theta, 4, split.coordinates).unseen != split.unseen).any()


def test_distance_and_coverage_of_a_shifted_copy(theta):
    coordinates = Coordinates.fit(theta)[0]
    split = Split(theta, theta, coordinates)
    inside = split.clipped()[1]
    assert distance(inside, split) == pytest.approx(0, abs=1e-6)
    assert coverage(inside, split) == [1, 1, 1]
    # Every fabric moves by 0.9; no other pairing is shorter than moving them all alike.
    shifted = coordinates.decode(coordinates.encode(inside) + 0.9 * np.eye(6)[0])
    assert distance(shifted, split) == pytest.approx(0.9, rel=1e-6)
    far = coordinates.decode(coordinates.encode(inside) + 20)
    assert coverage(far, split) == [0, 0, 0]


def test_mean_and_standard_error():
    assert mean_and_error([{"a": 1.0}, {"a": 3.0}]) == {"a": [2.0, 1.0]}


def test_rows_leak_and_fabrics_do_not(theta):
    alpha, beta = from_theta(theta)
    table = FabricTable(np.full(60, 0.3), alpha, beta, np.full(60, 5))
    result = compare(table, ["gaussian"], splits=2, samples=50)
    assert (result["fabrics"], result["rows"], result["unseen"]) == (60, 300, 12)
    # A row's four copies are all on its own side once in 600.
    assert all(leaked > 55 for leaked in result["leaked_rows"]["leaked"])
    assert result["leaked_rows"]["of"] == 60
    by_fabric = result["models"]["gaussian"]
    gap = by_fabric["log_likelihood_fitted"][0] - by_fabric["log_likelihood_unseen"][0]
    by_row = result["by_row"]["gaussian"]
    assert by_row["log_likelihood_fitted"][0] - by_row["log_likelihood_unseen"][0] < 0.5 * gap
